"""Everything that a report on a flight shows: estimates, references, innovations, spectra."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis.flight_numbers import Numbers, numbers
from ekf_companion.analysis.status_bands import Band, bands
from ekf_companion.config.config import Config
from ekf_companion.config.keys import KEYS, value_of
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.faults import NO_EVIDENCE, FaultEvidence
from ekf_companion.logs.estimate import of_table
from ekf_companion.logs.onboard import Onboard
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.arrays import Array, Stamps, known_rows
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind, merge, of_receiver
from ekf_companion.nav.state import SIGMA, VELOCITY, Status, Table, Trajectory, join
from ekf_companion.replay.log_source import onboard
from ekf_companion.replay.pose_aid import PoseFile
from ekf_companion.replay.run import Progress
from ekf_companion.replay.watched import Look, WatchedPipeline
from ekf_companion.replay.worker import Block
from ekf_companion.review.evidence import take_truth
from ekf_companion.review.report import Report
from ekf_companion.review.review import Review
from ekf_companion.review.stretches import Stretches, of_events
from ekf_companion.review.verdict import Judgement, judge_log

SEGMENT = 1024
"""Samples of a piece of the spectrum."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Innovations:
    """Fixes less the estimate at their time, before the update."""

    t_ns: Stamps
    """Shape (n,)."""
    values: Array
    """North, east, down (m), velocity north, east, down (m/s), shape (n, 6)."""
    bounds: Array
    """Three sigmas of each, of estimate and fix together, shape (n, 6)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Spectra:
    """Amplitude densities of the inertial samples."""

    frequency: Array
    """Hz, shape (n,)."""
    gyro: Array
    """rad/s per square root of Hz, by axis, shape (n, 3)."""
    accel: Array
    """m/s^2 per square root of Hz, likewise."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlightReview:
    """One flight, run through the estimator and reviewed."""

    name: str
    judgement: Judgement
    report: Report
    table: Table
    ours: Trajectory
    others: tuple[Trajectory, ...]
    """A truth first, then the autopilot's own estimate, as far as the log holds them."""
    fixes: Events
    innovations: Innovations | None
    looks: tuple[Look, ...]
    spectra: Spectra | None
    numbers: Numbers
    bands: tuple[Band, ...]
    jumps_ns: tuple[int, ...]
    """Times of the resets: the estimate jumped there."""
    onboard: Onboard
    """Its stamps are on the clock of the estimates, that of the longest stretch."""
    settings: Mapping[str, str]
    """Settings of the estimator that are not the defaults."""
    evidence: FaultEvidence = NO_EVIDENCE
    """How probable each source's fault was over time; empty without ``weigh_faults``."""
    tiles: str = ""
    """Address of the tiles of a map under the track; empty: there is none."""
    tiles_credit: str = ""
    """What is written on the map."""
    begins_ns: tuple[int, ...] = ()
    """Times at which the autopilot's clock began anew: all stamps are on one clock that
    continues."""
    began_s: float | None = None
    """Start of the recording, s since 1970, UTC; None: not known."""
    has_sea_level: bool = True
    """Whether heights are above mean sea level; else above the zero of the file."""

    @property
    def duration(self) -> float:
        """Estimated time, s."""
        return sum(self.report.seconds.values())

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict and the numbers for JSON."""
        judgement = self.judgement
        return {
            "verdict": judgement.sentence,
            "grade": judgement.grade,
            "reasons": list(judgement.reasons),
            "remarks": list(judgement.aside),
            "compared_with": [one.name for one in self.others],
            **self.numbers.to_dict(),
            "firmware": self.onboard.firmware,
            "bands": [
                {
                    "name": one.name,
                    "seconds": one.seconds,
                    "spans_s": [[t * 1e-9 for t in span] for span in one.spans_ns],
                }
                for one in self.bands
            ],
            **self.report.to_dict(),
        }


def review(
    path: Path,
    config: Config,
    progress: Progress | None = None,
    truth: Trajectory | None = None,
    aid: PoseFile | None = None,
) -> FlightReview:
    """Run the estimator over a log, and collect what a report shows of it.

    Args:
        path: The log.
        config: The estimator's configuration.
        progress: Called with how much is done.
        truth: From a file beside the log; None: the log's own, where it holds one.
        aid: Poses of another estimator, which are merged into the log.

    Raises:
        LogError: The log cannot be read, nothing can be estimated from it, or the truth is of
            another time.
    """
    examined = Review(path, config, WatchedPipeline, aid=aid)
    blocks = list(examined.blocks(progress))
    run, report = examined.run, examined.finish()
    config = examined.config
    take_truth(report, truth)
    stretches = report.track.stretches
    shifts_ns = stretches.shifts_ns()
    table, events = _on_one_clock(blocks, shifts_ns)
    zero = run.log.zero_height if isinstance(run.log, Recording) else 0.0
    known = [one for one in (report.truth, report.own) if one is not None]
    shift_ns = int(shifts_ns[stretches.longest])
    others = tuple(_moved(one, shift_ns, zero) for one in known)
    looks = [look for pipeline in run.pipelines for look in pipeline.looks]
    late_ns = int(delays_ns(config, run.family, run.gnss_delay)[Kind.GNSS])
    fixes = events.take(of_receiver(events) & known_rows(events.values[:, :3]))
    return FlightReview(
        name=path.name,
        judgement=judge_log(report),
        report=report,
        table=table,
        ours=_moved(of_table(table, "ekf-companion"), 0, zero),
        others=others,
        fixes=fixes,
        innovations=_innovations(table, fixes, late_ns),
        looks=tuple(_looks_on_one_clock(looks, shifts_ns)),
        spectra=_spectra(events),
        numbers=numbers(table, [_moved(one, 0, -zero) for one in others], events),
        bands=bands(table),
        jumps_ns=tuple(table.stamp_ns[1:][np.diff(table.column("reset_count")) != 0.0].tolist()),
        onboard=_on_drawn_clock(onboard(run.log, run.autopilot), shift_ns),
        settings=changed_settings(config),
        evidence=_evidence_on_one_clock([one.fault_evidence() for one in run.pipelines], shifts_ns),
        tiles=config.http.tiles,
        tiles_credit=config.http.tiles_credit,
        begins_ns=tuple(
            one.first_ns + int(shift)
            for one, shift in zip(stretches.found[1:], shifts_ns[1:], strict=True)
        ),
        began_s=run.log.began_s,
        has_sea_level=zero == 0.0,
    )


def changed_settings(config: Config) -> dict[str, str]:
    """Return the settings of the estimator that are not the defaults."""
    usual = Config()
    sections = {field.name for field in fields(FilterSettings)}
    return {
        name: str(value_of(config, name))
        for name in KEYS
        if name.partition(".")[0] in sections and value_of(config, name) != value_of(usual, name)
    }


def _on_drawn_clock(found: Onboard, later_ns: int) -> Onboard:
    """Return the autopilot's texts with stamps shifted to the drawn clock."""
    moved = [
        one if one.t_ns is None else one._replace(t_ns=one.t_ns + later_ns)
        for one in found.messages
    ]
    return replace(found, messages=tuple(moved))


def _on_one_clock(blocks: Sequence[Block], shifts_ns: Stamps) -> tuple[Table, Events]:
    """Return estimates and events, with those after a reboot appended to those before it."""
    stretches = Stretches()
    tables: list[Table] = []
    parts: list[Events] = []
    for block in blocks:
        first = max(len(stretches.found) - 1, 0)
        t_ns = block.table.stamp_ns
        t_ns = t_ns + shifts_ns[stretches.add(t_ns)]
        tables.append(Table(stamp_ns=t_ns, values=block.table.values))
        events, last = block.events, max(len(stretches.found) - 1, 0)
        t_ns = events.t_ns + shifts_ns[of_events(events, first, last)]
        parts.append(Events(t_ns=t_ns, kind=events.kind, values=events.values))
    arrival = [np.zeros(len(part), dtype=np.int64) for part in parts]
    return join(tables), merge(*parts, arrival_ns=arrival)


def _looks_on_one_clock(looks: Sequence[Look], shifts_ns: Stamps) -> Iterator[Look]:
    """Yield the filter's state in each second, likewise."""
    stretches = Stretches().add(np.array([look.t_ns for look in looks], dtype=np.int64))
    for look, stretch in zip(looks, stretches.tolist(), strict=True):
        yield replace(look, t_ns=look.t_ns + int(shifts_ns[min(stretch, len(shifts_ns) - 1)]))


def _evidence_on_one_clock(found: Sequence[FaultEvidence], shifts_ns: Stamps) -> FaultEvidence:
    """Return what was thought of the sources, likewise."""
    known = [one for one in found if len(one.t_ns)]
    if not known:
        return NO_EVIDENCE
    t_ns, probability, protection = (np.concatenate(parts) for parts in zip(*known, strict=True))
    stretch = np.minimum(Stretches().add(t_ns), len(shifts_ns) - 1)
    return FaultEvidence(t_ns + shifts_ns[stretch], probability, protection)


def _moved(one: Trajectory, later_ns: int, lower: float) -> Trajectory:
    """Return a trajectory shifted in time and height."""
    return replace(
        one,
        pos_t_ns=one.pos_t_ns + later_ns,
        vel_t_ns=one.vel_t_ns + later_ns,
        att_t_ns=one.att_t_ns + later_ns,
        alt=one.alt - lower,
    )


def _innovations(table: Table, fixes: Events, late_ns: int) -> Innovations | None:
    status = table.column("status")
    is_good = (status >= Status.OK) & known_rows(table.columns(("lat_deg", "vel_n", "sd_pos_n")))
    if not is_good.any() or not len(fixes):
        return None
    at_ns, order = np.unique(table.stamp_ns[is_good], return_index=True)
    t_ns = fixes.t_ns - late_ns
    near = np.clip(np.searchsorted(at_ns, t_ns), 0, len(at_ns) - 1)
    is_near = np.abs(at_ns[near] - t_ns) < 100_000_000
    if not is_near.any():
        return None
    rows = np.flatnonzero(is_good)[order][near[is_near]]
    lat, lon, alt = (table.column(name)[rows] for name in ("lat_deg", "lon_deg", "alt_m"))
    frame = LocalFrame(float(np.deg2rad(lat[0])), float(np.deg2rad(lon[0])), float(alt[0]))
    mine = frame.to_ned(np.deg2rad(lat), np.deg2rad(lon), alt)
    values = fixes.values[is_near]
    theirs = frame.to_ned(values[:, 0], values[:, 1], values[:, 2])
    velocity = values[:, 3:6] - table.columns(VELOCITY)[rows]
    stated = values[:, [6, 6, 7, 8, 8, 8]]
    bounds = 3.0 * np.hypot(table.columns(SIGMA[:6])[rows], np.nan_to_num(stated))
    found = np.hstack([theirs - mine, velocity])
    return Innovations(t_ns=t_ns[is_near], values=found, bounds=bounds)


def _spectra(events: Events) -> Spectra | None:
    """Return the mean spectra over all pieces without a gap."""
    imu = events.take((events.kind == Kind.IMU) & known_rows(events.values[:, :6]))
    if len(imu) < 2 * SEGMENT:
        return None
    steps = np.diff(imu.t_ns)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    if step <= 0.0:
        return None
    cuts = np.flatnonzero((steps > 3.0 * step) | (steps <= 0)) + 1
    piece = max(np.split(imu.values[:, :6], cuts), key=len)
    if len(piece) < 2 * SEGMENT:
        return None
    root = np.sqrt(_densities(piece, 1e9 / step)[1:])
    frequency = np.arange(1.0, SEGMENT // 2 + 1) * (1e9 / step / SEGMENT)
    return Spectra(frequency=frequency, gyro=root[:, :3], accel=root[:, 3:])


def _densities(samples: Array, rate: float) -> Array:
    """Return power spectral densities of evenly spaced columns, per Hz, from 0 to half the rate.

    Pieces of ``SEGMENT`` samples overlap by half; each without its mean, under a Hann window.

    Source: Welch 1967, "The use of fast Fourier transform for the estimation of power spectra",
    IEEE Trans. Audio Electroacoust. 15(2).
    """
    window = np.hanning(SEGMENT + 1)[:-1, None]
    pieces = (samples[i : i + SEGMENT] for i in range(0, len(samples) - SEGMENT + 1, SEGMENT // 2))
    powers = [np.abs(np.fft.rfft(window * (one - one.mean(axis=0)), axis=0)) ** 2 for one in pieces]
    density = np.mean(powers, axis=0) / (rate * np.sum(window**2))
    density[1:-1] *= 2.0  # of negative frequencies
    return np.asarray(density)
