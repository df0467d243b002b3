"""Why the inertial message is slower than was asked.

Sources: MAVLink's guide on message rates; PX4's and ArduPilot's documentation of their streams.
"""

from __future__ import annotations

import math
from statistics import median
from typing import NamedTuple

from ekf_companion.doctor.evidence import Evidence, Means
from ekf_companion.doctor.rate_override import ALIKE, GROUND, STREAMED
from ekf_companion.engine.announcer import DECIMATED
from ekf_companion.status.snapshot import MessageState

ENOUGH = 0.8
"""Share of the rate asked that is enough."""
_LOOP_SHARE = 0.8
"""Share of SCHED_LOOP_RATE: ArduPilot streams nothing faster."""
_PLANE_LOOP = 50.0
_LARGEST_LOOP = 400.0
_SENSORS = "Set SRn_RAW_SENS = 50 (MAVn_RAW_SENS from 4.7 on) for this port"


class Cause(NamedTuple):
    """Why it is slow, and what to set."""

    why: str
    remedy: str


def line(evidence: Evidence) -> str:
    """Return ``serial`` or ``network``; ``unknown`` for a recording, which does not tell."""
    if evidence.opening is None:
        return "unknown"
    return "serial" if evidence.is_serial else "network"


def promised(evidence: Evidence, name: str) -> float:
    """Return the rate at which a message was granted, else the rate asked for, Hz."""
    return evidence.granted.get(name, evidence.messages[name].asked)


def ground_station(evidence: Evidence, state: MessageState) -> Cause | None:
    """Return a cause if many streams have one low rate: a ground station sets 4 Hz, typically."""
    name = evidence.stamps.message
    others = [
        evidence.messages[one].rate
        for one in STREAMED
        if one in evidence.messages and evidence.messages[one].rate > 0.0
    ]
    usual = median(others)
    alike = [rate for rate in others if abs(rate - usual) <= ALIKE * usual]
    seen = " (its REQUEST_DATA_STREAM was seen here)" if evidence.stream_requests else ""
    is_recording = evidence.means is Means.RECORDING
    record = " For a recording: record at the companion." if is_recording else ""
    is_like_others = len(alike) >= 3 and abs(state.rate - usual) <= 2.0 * ALIKE * usual
    if state.rate <= GROUND and is_like_others:
        why = (
            f"{len(alike)} streams come at about {usual:.1f} Hz, so a ground station sets "
            f"them{seen}, or the port's SRn_* parameters do."
        )
    elif evidence.overridden:
        why = (
            f"{name} and others were granted their rates, and then came at about "
            f"{evidence.overridden:.1f} Hz alike: a ground station overrules us{seen}."
        )
    else:
        return None
    return Cause(
        why,
        "ArduPilot: let the port ignore it, SERIALn_OPTIONS + 4096 (MAVn_OPTIONS + 4 from 4.7 on), "
        "or set its SRn_* (MAVn_*) higher; in the ground station set the stream rate to -1 "
        f"(MAVProxy: --streamrate=-1).{record}",
    )


def loop_rate(evidence: Evidence, state: MessageState) -> Cause | None:
    """Return a cause if ArduPilot's loop is the limit: it grants no more than 0.8 of its rate."""
    if evidence.family != "ardupilot":
        return None
    told = evidence.parameters.get("SCHED_LOOP_RATE")
    granted = promised(evidence, evidence.stamps.message)
    loop = told or _PLANE_LOOP
    ceiling = _LOOP_SHARE * loop
    is_denied = granted < state.asked and (told is None or ceiling < state.asked)
    is_at_it = abs(state.rate - ceiling) <= 0.05 * ceiling and state.asked >= 1.1 * ceiling
    if not (is_denied or is_at_it):
        return None
    if is_at_it:
        own = f"SCHED_LOOP_RATE = {loop:.0f}" if told else f"a SCHED_LOOP_RATE of {loop:.0f}"
        why = f"that is 0.8 of {own}, the most that ArduPilot streams."
    else:
        own = f"SCHED_LOOP_RATE = {told:.0f}" if told else "SCHED_LOOP_RATE"
        why = (
            f"{granted:.0f} Hz were granted, and {state.asked:.0f} denied: ArduPilot streams no "
            f"more than 0.8 of {own}."
        )
    # The interval is in whole milliseconds
    wanted = min(50.0 * math.ceil(state.asked / _LOOP_SHARE / 50.0), _LARGEST_LOOP)
    return Cause(why, f"Set SCHED_LOOP_RATE = {wanted:.0f} (up to {_LARGEST_LOOP:.0f}) and reboot.")


def budget(evidence: Evidence, state: MessageState, lost: float) -> Cause | None:
    """Return a cause if all streams are slower by one factor, apart from the share lost."""
    shares = [
        state.rate / (1.0 - lost) / promised(evidence, name)
        for name, state in evidence.messages.items()
        if state.asked > 1.0
        and state.answer == "accepted"
        and state.rate > 0.0
        # A receiver gives what it has
        and name != "GPS_RAW_INT"
    ]
    opening = evidence.opening
    baud = opening.baud if opening is not None and line(evidence) == "serial" else 0
    is_full = baud > 0 and evidence.bytes_rate > 0.8 * baud / 10.0
    factor = median(shares) if shares else state.rate / max(state.asked, state.rate)
    alike = sum(abs(share - factor) <= ALIKE * factor for share in shares)
    if not is_full and (factor > ENOUGH or alike < 3):
        return None
    need = evidence.bytes_rate / max(factor, 0.01)
    wire = f" of {baud / 10e3:.1f} that the wire carries" if baud else ""
    is_open = line(evidence) == "network" and evidence.family != "px4"
    who = "neither the autopilot nor the network gives more"
    return Cause(
        f"all streams come at about {factor:.0%} of what was asked: "
        + (who if is_open else "the link's budget is spent")
        + f" ({evidence.bytes_rate / 1e3:.1f} kB/s{wire}; {need / 1e3:.1f} asked).",
        _more_budget(evidence, need),
    )


def _more_budget(evidence: Evidence, need: float) -> str:
    kind = line(evidence)
    where = "where the link is serial, " if kind == "unknown" else ""
    if evidence.family == "px4":
        limits = ", ".join(
            f"{name} = {value:.0f}"
            for name, value in sorted(evidence.parameters.items())
            if name.startswith("MAV_") and name.endswith("_RATE")
        )
        now = f" ({limits} now; 0 is half of the wire)" if limits else ""
        baud = f", {where}SER_TEL2_BAUD = 921600 and link.url with :921600"
        rate = 1000 * math.ceil(need * 1.2 / 1000)
        return (
            f"Set MAV_n_RATE = {rate} bytes/s for this port{now}"
            f"{'' if kind == 'network' else baud}."
        )
    less = "ower link.imu_rate and the SRn_* of streams that nobody needs."
    if kind == "network":
        return f"L{less}"
    faster = f"{where}set SERIALn_BAUD = 921 and link.url with :921600, or l{less}"
    return f"{faster[0].upper()}{faster[1:]}"


def more(evidence: Evidence, state: MessageState) -> str:
    """Return what to set if no cause is known."""
    if evidence.means is Means.LISTENING:
        return "The daemon asks for link.imu_rate by itself: examine without --listen."
    is_live, wanted = evidence.means is Means.LIVE, evidence.config.link.imu_rate
    if is_live and wanted < DECIMATED:
        return "Set link.imu_rate = 100 or more."
    is_granted = state.answer == "accepted" and state.asked >= DECIMATED
    if evidence.family == "px4":
        asks = "." if is_granted else ", and link.imu_rate = 100 or more."
        return f"Set IMU_INTEG_RATE = 250 and MAV_n_MODE = 2 (Onboard) for this port{asks}"
    if is_granted:
        return (
            f"{promised(evidence, evidence.stamps.message):.0f} Hz were granted: look at the "
            "load of the autopilot's processor, and at who else asks it for streams."
        )
    if state.answer not in ("accepted", ""):
        return f"The request was answered “{state.answer}”. {_SENSORS}."
    return _SENSORS + ("." if is_live else ", or let the daemon ask: link.imu_rate = 100 or more.")
