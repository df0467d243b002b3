"""What a conversion found in a log and did with it, as text and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.engine.faults import FoundFault
from ekf_companion.engine.health import DECIMATED, Aid, Arrival, Health, Verdict
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import UNDAMAGED, Damage, counted
from ekf_companion.nav.arrays import median
from ekf_companion.nav.measurements import (
    GNSS_FLAGS,
    Events,
    GnssFlag,
    Kind,
    is_derived,
    is_reboot,
    of_receiver,
)
from ekf_companion.nav.reason import (
    NONE,
    Seconds,
    add_seconds,
    seconds_by_reason,
    to_names,
    to_words,
)
from ekf_companion.nav.state import Status, Table, Trajectory, join
from ekf_companion.nav.wind import MeanWind
from ekf_companion.review.extent import Extent
from ekf_companion.review.left_out import LeftOut
from ekf_companion.review.stamps import NO_SAMPLES, StampCount
from ekf_companion.review.track import Track

SLOW = 20.0
"""Inertial samples per second below which the motion between them is guesswork, Hz."""
_WITHOUT_NORTH = {Status.INIT, Status.ALIGNING}


@dataclass(slots=True, kw_only=True)
class Report:
    """What a conversion found and did."""

    log: str
    family: str = "unknown"
    notes: list[str] = field(default_factory=list)
    counts: Counter[Kind] = field(default_factory=Counter)
    derived: int = 0
    """Positions of the autopilot's own, used only if no fix of its receiver comes."""
    rates: dict[Kind, float] = field(default_factory=dict)
    """Hz, the median over all blocks: a stream may begin at another rate."""
    steps: dict[Kind, list[float]] = field(default_factory=dict)
    """From one event to the next, ns: the median of each block."""
    seconds: dict[Status, float] = field(default_factory=dict)
    reasons: Seconds = field(default_factory=dict)
    """The same by the foremost reason of each; without those of a status that has none."""
    newest: Table | None = None
    """The last estimate, from which on the next block's time counts."""
    estimates: int = 0
    reboots: int = 0
    """How often the autopilot's clock began anew."""
    other_resets: int = 0
    """Resets that ``health`` does not count: of autopilots that were followed before the last."""
    last_reset: str = ""
    """Why the last of them was made that was no reboot; empty: as ``health`` says."""
    health: Health | None = None
    refused: dict[str, int] = field(default_factory=dict)
    damage: Damage = UNDAMAGED
    """What of the file could not be read."""
    elsewhere: str = ""
    """Whose inertial samples the log holds that were not asked for, in words."""
    lost_share: float = 0.0
    """Of the telemetry's frames: lost on the link, by their numbers."""
    is_contradictory: bool = False
    """Whether a note says that units, signs, order or axes of a table cannot be meant."""
    faults: list[FoundFault] = field(default_factory=list)
    """What was wrong beyond doubt, where ``weigh_faults`` asks for it."""
    stamps: StampCount = NO_SAMPLES
    """Of the inertial samples, and how many of them cannot be right."""
    flagged: int = 0
    """Fixes that the receiver itself reports as jammed or spoofed."""
    left_out: list[LeftOut] = field(default_factory=list)
    """Measurements that are none."""
    extent: Extent = field(default_factory=Extent)
    """From when to when the log's sensors spoke."""
    track: Track = field(default_factory=Track)
    """The positions, to compare with those below."""
    wind: MeanWind = field(default_factory=MeanWind)
    fix_delay: float = 0.0
    """By which a fix's position is older than its stamp: configured or declared, and found, s."""
    own: Trajectory | None = None
    """The autopilot's own estimate of the longest stretch without a reboot."""
    truth: Trajectory | None = None
    """From a simulator, an optical system, or a file beside the log."""

    @property
    def resets(self) -> int:
        """How often the estimate was reset: each step of ``reset_count`` that is no reboot."""
        return (self.health.resets if self.health else 0) - self.reboots + self.other_resets

    @property
    def reset_reason(self) -> str:
        """Why the last reset was made that was no reboot; empty: there was none."""
        if self.resets <= 0 or self.health is None:
            return ""
        return self.last_reset or self.health.reset_reason

    def to_dict(self) -> dict[str, Any]:
        """Return everything for JSON, names in lower case."""
        health = self.health
        return {
            "log": self.log,
            "family": self.family,
            "notes": list(self.notes),
            "rates_hz": {kind.name.lower(): rate for kind, rate in self.rates.items()},
            "events": {kind.name.lower(): count for kind, count in self.counts.items()},
            "derived_positions": self.derived,
            "estimates": self.estimates,
            "reboots": self.reboots,
            "damage": self.damage.words,
            "seconds": {status.name.lower(): spent for status, spent in self.seconds.items()},
            "seconds_by_reason": {
                status.name.lower(): to_names(by_reason)
                for status, by_reason in self.reasons.items()
            },
            "faults": [one.to_dict(self.extent.first_ns) for one in self.faults],
            "wind": self.wind.words,
            "resets": self.resets,
            "gaps": health.gaps if health else 0,
            "late": health.reruns if health else 0,
            "aids": _by_name(health.verdicts) if health else {},
            "headings": {
                sensor: {why.name.lower(): count for why, count in row.items() if count}
                for sensor, row in (health.headings if health else {}).items()
            },
            "arrivals": _by_name(health.arrivals) if health else {},
            "refused_by_decoder": self.refused,
        }


def _by_name(table: Mapping[Any, Mapping[Any, int]]) -> dict[str, dict[str, int]]:
    return {
        key.name.lower(): {why.name.lower(): count for why, count in row.items() if count}
        for key, row in table.items()
    }


def add_block(report: Report, events: Events, table: Table) -> None:
    """Add a block of events and their estimates to the report."""
    report.reboots += int(np.count_nonzero(is_reboot(events)))
    is_fix = of_receiver(events)
    for kind in Kind:
        chosen = is_fix if kind == Kind.GNSS else events.kind == kind
        t_ns = events.t_ns[chosen]
        report.counts[kind] += len(t_ns)
        steps = np.diff(t_ns)
        if not (steps > 0).all():
            steps = np.diff(np.unique(t_ns))
        if len(steps):
            medians = report.steps.setdefault(kind, [])
            medians.append(median(steps))
            report.rates[kind] = 1e9 / median(medians)
    flags = np.nan_to_num(events.values[is_fix, GNSS_FLAGS]).astype(np.int64)
    report.flagged += int(np.count_nonzero(flags & GnssFlag.SUSPECT))
    report.derived += int(np.count_nonzero(is_derived(events)))
    report.estimates += len(table)
    report.track.add(events, table)
    report.wind.add(table)
    report.extent.add(events)
    if len(table):
        spans = table if report.newest is None else join([report.newest, table])
        report.newest = Table(stamp_ns=table.stamp_ns[-1:], values=table.values[-1:])
        for status, by_reason in seconds_by_reason(spans).items():
            spent = sum(by_reason.values())
            report.seconds[status] = report.seconds.get(status, 0.0) + spent
            if by_reason.keys() != {NONE}:
                add_seconds(report.reasons, {status: by_reason})


def note_shortcomings(report: Report, path: Path) -> None:
    """Add a sentence for each thing that was lacking, and what can be estimated without it.

    Raises:
        LogError: Nothing could be estimated.
    """
    counts = report.counts
    if counts[Kind.IMU] == 0:
        raise LogError(
            f"{path}: holds no inertial samples (HIGHRES_IMU, RAW_IMU, SCALED_IMU, IMU or "
            "sensor_combined), so nothing can be estimated; ask the autopilot to log or stream them"
            + (f" ({report.damage.words})" if report.damage.words else "")
            + (f"; {report.elsewhere}" if report.elsewhere else "")
        )
    if report.reboots:
        times = "once" if report.reboots == 1 else f"{report.reboots} times"
        report.notes.append(
            f"the autopilot rebooted {times}: its clock began anew, and the estimate with it"
        )
    if report.health and (strays := report.health.arrivals[Kind.IMU][Arrival.STRAY]):
        report.notes.append(
            f"{counted(strays, 'inertial sample')} not used: stamped ahead of those after"
        )
    if report.health:
        report.notes += report.health.oddities
    rate = report.rates.get(Kind.IMU, 0.0)
    if report.stamps.note:
        report.notes.append(report.stamps.note)
    if report.stamps.is_most:  # what is lacking besides follows from that
        _check_estimated(report, path)
        return
    if rate < SLOW:
        report.notes.append(
            f"inertial samples come at {rate:.1f} Hz, below the {SLOW:.0f} Hz that motion can be "
            "integrated from: position and velocity follow GNSS, attitude is a guess; "
            "ask for a faster stream"
        )
    elif rate < DECIMATED:
        report.notes.append(
            f"inertial samples come at {rate:.0f} Hz: fast motion is missed, so the noise is taken "
            f"for larger; {DECIMATED:.0f} Hz or more would do"
        )
    if counts[Kind.GNSS] + report.derived == 0:
        report.notes.append(
            "no GNSS fix: attitude is estimated, and height over the start where there is a "
            "barometer; no position and no velocity"
        )
    if counts[Kind.HEADING] + counts[Kind.MAG] == 0:
        found = bool(set(report.seconds) - {*_WITHOUT_NORTH, Status.ATTITUDE})
        report.notes.append(
            "no heading (magnetometer, GNSS yaw or the autopilot's): "
            + (
                "it was found from the GNSS velocity in the first manoeuvre"
                if found
                else "roll and pitch are estimated; position and velocity need one, or GNSS "
                "velocity and a manoeuvre that changes it by more than 1 m/s"
            )
        )
    elif counts[Kind.GNSS] and set(report.seconds) <= {*_WITHOUT_NORTH, Status.ATTITUDE}:
        report.notes.append(
            "no heading was accepted, so GNSS could not be used: roll and pitch are estimated. "
            "A magnetic field that is not the Earth's is refused (heading.field_strength, "
            "heading.field_dip); heading.source says who is asked"
        )
    _check_estimated(report, path)


LEAST = 1.0
"""s of samples, as align.time: in less neither down nor north can be found."""


def _check_estimated(report: Report, path: Path) -> None:
    """Refuse a log from which nothing could be estimated.

    Raises:
        LogError: It is refused.
    """
    if report.estimates == 0 or set(report.seconds) <= _WITHOUT_NORTH:
        span = sum(report.seconds.values())
        what = "; ".join(report.notes) or "the log is too short to find down and north in it"
        if report.estimates and span < LEAST and not report.stamps.words:
            what = (
                f"its inertial samples last {span:.2f} s; a second of rest, or some seconds of "
                "motion with fixes, is the least to find down and north from"
            )
        raise LogError(f"{path}: nothing could be estimated: {what}")


def _in_words(verdicts: Mapping[Verdict, int]) -> str:
    """Return verdicts with their counts in words; empty: there is none."""
    return ", ".join(
        f"{count} {why.name.lower().replace('_', ' ')}" for why, count in verdicts.items() if count
    )


def summary(report: Report) -> list[str]:
    """Return the report as lines to read."""
    lines = [f"{report.log}: {report.family} autopilot, {report.estimates} estimates"]
    rates = ", ".join(
        f"{kind.name.lower()} {rate:.4g} Hz ({report.counts[kind]})"
        for kind, rate in report.rates.items()
    )
    if report.derived:
        rates += f", {report.derived} positions of the autopilot's own"
    lines.append(f"  found: {rates}")
    if report.health is not None:
        for aid in Aid:
            if words := _in_words(report.health.verdicts[aid]):
                lines.append(f"  {aid.name.lower()}: {words}")
            sensors = {one: _in_words(row) for one, row in report.health.headings.items()}
            sensors = {one: words for one, words in sensors.items() if words}
            if aid is Aid.HEADING and len(sensors) > 1:
                lines += [f"    {one}: {words}" for one, words in sensors.items()]
        late = report.health.reruns
        lines.append(
            f"  resets: {report.resets}"
            + (f" (last: {report.reset_reason})" if report.resets else "")
            + (f"; reboots: {report.reboots}" if report.reboots else "")
            + f"; gaps: {report.health.gaps}; late measurements: {late}"
        )
    if report.wind.words:
        lines.append(f"  wind: {report.wind.words}, in the mean")
    spent = ", ".join(f"{each.name.lower()} {s:.1f} s" for each, s in report.seconds.items())
    lines.append(f"  status: {spent}")
    for status, by_reason in sorted(report.reasons.items()):
        if words := to_words(by_reason):
            lines.append(f"  {status.words}: {words}")
    link = {why: count for why, count in report.refused.items() if ": " not in why}
    left = {why.split(": ", 1)[1]: n for why, n in report.refused.items() if ": " in why}
    for title, table in (("link", link), ("left out or mended", left)):
        if table:
            words = ", ".join(f"{count} {why}" for why, count in table.items())
            lines.append(f"  {title}: {words}")
    lines += [f"  note: {note}" for note in report.notes]
    return lines
