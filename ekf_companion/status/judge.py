"""Whether the daemon does its work, by a snapshot, in one line; and the snapshot as JSON.

The line is the same for ``/healthz``, the status and the service manager.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, NamedTuple

import msgspec

from ekf_companion.mavlink.audit import no_samples_cause
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.lag import CROWDED
from ekf_companion.nav.state import Status
from ekf_companion.status.lacking import lacking
from ekf_companion.status.snapshot import LinkState, Snapshot

BARREN_S = 3.0
"""After so long with samples and without an estimate the filter is stuck, and only a restart
helps."""
STALL_S = 2.0
"""The filter's task runs at least ten times a second."""
SILENCE_S = 2.0
"""After so long without a byte a link is silent: heartbeats come once a second."""
OLD_S = 1.0
"""An estimate whose newest inertial sample is older is out of date: samples come 50 times a second
or more. The page (page/live.js), preflight and status use the same limit."""
MANY_UNSENT = 0.5
"""Rate of dropped ODOMETRY, Hz, that is reported; one now and then is normal."""


class HealthCheck(NamedTuple):
    """Whether the daemon does its work."""

    is_healthy: bool
    """Whether the estimate may be used and a restart would not improve anything."""
    line: str
    """The state, and where something is wrong, the remedy."""
    is_ok: bool = False
    """Whether it also has what it needs: its input gives a current estimate."""


def judge(snapshot: Snapshot) -> HealthCheck:
    """Return whether the filter runs and can be used; missing input is not ok, but no fault."""
    stuck_s, health = snapshot.process.tick_age_s, snapshot.estimator
    if stuck_s > STALL_S:
        return HealthCheck(False, f"stalled: the filter's task has not run for {stuck_s:.1f} s")
    if snapshot.barren_s > BARREN_S:
        return HealthCheck(
            False,
            f"stalled: inertial samples have come for {snapshot.barren_s:.1f} s, and the filter "
            "makes no estimate of them; see what became of them in /status",
        )
    if health is not None and health.status is Status.INVALID:
        return HealthCheck(
            False,
            "invalid: the error has passed its limit; /status says which aids it lacks",
        )
    if silence := missing_input(snapshot):
        line = "waiting for an autopilot"
        if health is not None:
            is_old = snapshot.sample_age_s > OLD_S
            line = "no estimate, the last was" if is_old else "the estimate is"
            line += f" {health.status.name}"
        return HealthCheck(True, f"{line}; {silence}")
    if health is None:
        return HealthCheck(True, "waiting for an autopilot")
    if health.status < Status.OK:
        why = lacking(health, snapshot.refused)
        return HealthCheck(True, f"no position yet: the estimate is {health.status.name}; {why}")
    word = health.status.words
    line = "ok: the estimate is OK, " if health.status is Status.OK else f"{word}: "
    line += "".join(f"{words}, " for words in health.reasons.values())
    line += "".join(f"{one.sentence}, " for one in health.wrong)
    line += f"{snapshot.imu.rate:.0f} Hz IMU, {_odometry(snapshot)}"
    in_vain = [
        f"{name} at {message.rate:.0f} of {message.asked:.0f} Hz: {message.cause}"
        for name, message in snapshot.messages.items()
        if message.cause
    ]
    trouble = snapshot.process.recording_trouble
    recording = [f"not all is recorded: {trouble}"] if trouble else []
    other = snapshot.vehicle.autopilot
    apart = (
        []
        if other is None or not other.apart
        else [f"the autopilot does not follow: {other.apart}"]
    )
    return HealthCheck(True, "; ".join([*apart, line, *in_vain, *recording]), is_ok=not apart)


def _odometry(snapshot: Snapshot) -> str:
    output = snapshot.output
    if output.is_allowed:
        line = f"ODOMETRY {output.rate:.0f} Hz" if output.is_streaming else "no ODOMETRY"
        if output.every > 1 and output.is_streaming:
            line += ", which is what the line carries"
        if output.silence:
            line = f"no ODOMETRY: {output.silence}"
        elif output.advice:
            line += f", {output.advice}"
        if output.second_source:
            line += f"; {output.second_source} too"
        return line + _thrown_away(snapshot)
    remedy = f"; {output.remedy}" if output.remedy else ""
    return f"ODOMETRY withheld: {output.reason}{remedy}"


def _thrown_away(snapshot: Snapshot) -> str:
    """Return how many ODOMETRY are dropped, and why; empty: none or few."""
    output, text = snapshot.output, ""
    if output.unsent_rate >= MANY_UNSENT:
        remedy = "lower output.odometry.rate"
        if _is_serial(snapshot.link):
            remedy = f"check RTS and CTS, raise the rate of the line or {remedy}"
        unsent = f"{output.unsent_rate:.0f} Hz thrown away"
        text += f", {unsent} as the link takes no more: {remedy}"
    if output.held_rate >= MANY_UNSENT:
        text += (
            f", {output.held_rate:.0f} Hz thrown away as this board let the daemon wait for "
            f"{snapshot.process.loop_lag_ms * 1e-3:.1f} s: {CROWDED}"
        )
    if output.late_rate >= MANY_UNSENT:
        text += (
            f", {output.late_rate:.0f} Hz thrown away as the samples came too late: check the "
            "radio or the network on the way from the autopilot"
        )
    return text


def missing_input(snapshot: Snapshot) -> str:
    """Return which input is missing, beginning at the wire: the rest follows from that."""
    link, peer = snapshot.link, snapshot.peer
    if not link.is_open:
        if not link.opened and not link.failure:
            return f"the link {link.url} is being opened"
        why = f" ({link.failure})" if link.failure else ""
        return f"the link {link.url} is closed{why}: check the device or the host that it names"
    if math.isnan(link.silent_s):
        return f"not a byte has come over the link: check {_other_end(link)}"
    if link.silent_s > SILENCE_S:
        return f"the link has been silent for {link.silent_s:.1f} s: check {_other_end(link)}"
    if peer is None and snapshot.frames.refused:
        why, count = max(snapshot.frames.refused.items(), key=lambda entry: entry[1])
        return (
            f"no autopilot has been admitted: {count} frames: {why}; link.allow_systems, "
            "link.allow_components and signing decide"
        )
    if peer is None:
        return "no autopilot has been heard: check the baud rate and link.autopilot"
    if not peer.is_heard:
        return f"the autopilot has been silent for {peer.silent_s:.1f} s"
    if math.isnan(snapshot.sample_age_s):
        answers = {name: one.answer for name, one in snapshot.messages.items() if one.answer}
        cause = no_samples_cause(answers, Family(peer.family))
        return f"no inertial sample of the autopilot has come: {cause}"
    if snapshot.sample_age_s > OLD_S:
        return f"no inertial sample has come for {snapshot.sample_age_s:.1f} s"
    return ""


def _other_end(link: LinkState) -> str:
    if _is_serial(link):
        return "the wire, the port and the baud rate"
    return "that the other end sends here, its address and port"


def _is_serial(link: LinkState) -> bool:
    return link.url.startswith("serial:")


def to_plain(value: Any) -> Any:
    """Return data as plain tables and lists, enums by their names in small letters."""
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, (float, int, str)):
        return value
    if is_dataclass(value):
        return {entry.name: to_plain(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(to_plain(key)): to_plain(content) for key, content in value.items()}
    return [to_plain(item) for item in value] if isinstance(value, (tuple, list)) else value


def to_json(snapshot: Snapshot, pause: Callable[[], None] = lambda: None) -> bytes:
    """Return a snapshot, and its check as ``health``, as JSON; null: not known.

    ``pause`` is called between two stages: it lets other threads run while the text is made.
    """
    check = judge(snapshot)
    health = {"is_healthy": check.is_healthy, "is_ok": check.is_ok, "words": check.line}
    plain: dict[str, Any] = {"health": health}
    for entry in fields(snapshot):
        plain[entry.name] = to_plain(getattr(snapshot, entry.name))
        pause()
    return msgspec.json.encode(plain)
