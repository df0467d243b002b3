"""Whether the messages come often enough, and if not, why.

Sources: MAVLink's guide on message rates; PX4's and ArduPilot's documentation of their streams.
"""

from __future__ import annotations

import math
from statistics import median

from ekf_companion.doctor.evidence import Evidence, Means
from ekf_companion.doctor.rate_override import ALIKE, GROUND, STREAMED
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, unknown, warning
from ekf_companion.engine.health import DECIMATED
from ekf_companion.status.snapshot import MessageState

SLOWEST = 25.0
"""Inertial samples needed to follow a flight at all, Hz."""
_PX4_IMU = 250.0
_FEW_FIXES = 1.5
"""Hz."""
_LOST, _MANY_LOST = 0.01, 0.1
_TWICE = 0.05
"""Share of all frames that came again; a burst after a stall is less."""
ENOUGH = 0.8
"""Share of the rate asked that is enough."""
_LOOP_SHARE = 0.8
"""Share of SCHED_LOOP_RATE: ArduPilot streams nothing faster."""
_PLANE_LOOP = 50.0
_LARGEST_LOOP = 400.0
_SENSORS = "Set SRn_RAW_SENS = 50 (MAVn_RAW_SENS from 4.7 on) for this port"
_Cause = tuple[str, str]
"""Why it is slow, and what to set."""


def rates(evidence: Evidence) -> StageResult:
    """Judge the rates, asked and received, and the frames lost."""
    name = evidence.stamps.message
    state = evidence.messages.get(name)
    if state is None or not state.rate:
        return unknown(Stage.RATES, "no inertial message, no rate")
    gnss = evidence.messages.get("GPS_RAW_INT")
    asked = f" of {state.asked:.0f} asked" if state.asked else ""
    saw = f"{name} {_hertz(state.rate)}{asked}"
    if gnss is not None:
        saw += f", GPS_RAW_INT {_hertz(gnss.rate)}"
    lost = evidence.frames.lost
    received = sum(state.count for state in evidence.messages.values())
    share = lost / (lost + received) if received else 0.0
    saw += f", {share:.1%} lost"
    if state.rate < ENOUGH * state.asked and _is_whole_division(evidence, state):
        saw += " (PX4 divides its rate by whole numbers)"
    problems = [_twice(evidence), _lost(share, evidence), *_slow(evidence, state, share)]
    if gnss is not None and 0.0 < gnss.rate < _FEW_FIXES:
        few = warning(
            f"GPS_RAW_INT comes at {_hertz(gnss.rate)}: few fixes make a slow and coarse estimate.",
            "Set link.gnss_rate = 10, and the receiver to 5 Hz (ArduPilot: GPS1_RATE_MS = 200).",
        )
        problems.append(few)
    return judged(Stage.RATES, saw, problems)


def _hertz(rate: float) -> str:
    return f"{rate:.1f} Hz" if rate < 9.95 else f"{rate:.0f} Hz"


def _slow(evidence: Evidence, state: MessageState, share: float) -> list[Problem]:
    """Return why the inertial message is slow; nothing if it is as fast as asked, or as can be.

    Frames lost on their way are reported already: it is judged by what the autopilot sends.
    """
    name = evidence.stamps.message
    given = _promised(evidence, name)
    is_lost = share >= _LOST and abs(state.rate / (1.0 - share) - given) <= (1.0 - ENOUGH) * given
    sent = given if is_lost else state.rate
    is_short = sent < ENOUGH * state.asked
    is_well = sent >= DECIMATED and (not is_short or _is_whole_division(evidence, state))
    severity = failed if state.rate < SLOWEST else warning
    rate = f"{name} comes at {_hertz(state.rate)}"
    causes = [_ground_station(evidence, state), None if is_well else _loop_rate(evidence, state)]
    if not is_well and causes == [None, None]:
        causes = [_budget(evidence, state, share if is_lost else 0.0)]
    named = [severity(f"{rate}: {cause[0]}", cause[1]) for cause in causes if cause is not None]
    if named or sent >= DECIMATED:
        # Without another cause, the sensor has no higher rate
        return named
    return [severity(f"{rate}; flight needs {DECIMATED:.0f} or more.", _more(evidence, state))]


def _is_whole_division(evidence: Evidence, state: MessageState) -> bool:
    """Return whether PX4 divides its rate by a whole number: 200 asked of 250 gives 125."""
    if evidence.family != "px4" or not state.asked:
        return False
    base = evidence.parameters.get("IMU_INTEG_RATE", _PX4_IMU)
    parts = max(1, math.ceil(base / state.asked - 0.05))
    return abs(state.rate - base / parts) <= 0.08 * base / parts


def _twice(evidence: Evidence) -> Problem | None:
    """Return that the autopilot's frames come by two paths."""
    frames = evidence.frames
    if frames.again < _TWICE * frames.frames:
        return None
    return warning(
        f"The autopilot's messages come by two paths, on one of them {frames.again_late:.2f} s "
        f"later: {frames.again} came again, which do not count.",
        "Nothing need be done for the estimate; look for a second link, or a router, that leads "
        "here: it costs the board time and the link room.",
    )


def _lost(share: float, evidence: Evidence) -> Problem | None:
    counted = evidence.frames
    if counted.late + counted.duplicates > 0.5 * counted.frames:
        return warning(
            "The frames' sequence numbers stand still: whoever made them numbers none, so losses "
            "cannot be seen.",
            "Nothing need be done for the estimate; a recording of the daemon's own has them.",
        )
    if share < _LOST:
        return None
    severity, kind = failed if share > 3.0 * _MANY_LOST else warning, _line(evidence)
    many = "as over a radio at its limit" if kind == "network" else "as over a damaged or full wire"
    remedies = {
        "serial": "Connect RTS and CTS or lower the streams",
        "network": "Take a cable for the radio, or lower link.imu_rate and other streams",
    }
    either = "Where the link is serial connect RTS and CTS; lower the streams"
    return severity(
        f"{share:.0%} of the autopilot's frames never arrive"
        + (f", {many}." if share > _MANY_LOST else "."),
        f"{remedies.get(kind, either)}; behind a router that filters, the numbers have gaps though "
        "nothing is lost.",
    )


def _line(evidence: Evidence) -> str:
    """Return ``serial`` or ``network``; ``unknown`` for a recording, which does not tell."""
    if evidence.opening is None:
        return "unknown"
    return "serial" if evidence.is_serial else "network"


def _promised(evidence: Evidence, name: str) -> float:
    """Return the rate at which a message was granted, else the rate asked for, Hz."""
    return evidence.granted.get(name, evidence.messages[name].asked)


def _ground_station(evidence: Evidence, state: MessageState) -> _Cause | None:
    """Return a cause if many streams have one low rate: a ground station sets 4 Hz, typically."""
    name, messages = evidence.stamps.message, evidence.messages
    others = [messages[one].rate for one in STREAMED if one in messages and messages[one].rate]
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
    return (
        why,
        "ArduPilot: let the port ignore it, SERIALn_OPTIONS + 4096 (MAVn_OPTIONS + 4 from 4.7 on), "
        "or set its SRn_* (MAVn_*) higher; in the ground station set the stream rate to -1 "
        f"(MAVProxy: --streamrate=-1).{record}",
    )


def _loop_rate(evidence: Evidence, state: MessageState) -> _Cause | None:
    """Return a cause if ArduPilot's loop is the limit: it grants no more than 0.8 of its rate."""
    if evidence.family != "ardupilot":
        return None
    known = evidence.parameters.get("SCHED_LOOP_RATE")
    granted = _promised(evidence, evidence.stamps.message)
    loop = known or _PLANE_LOOP
    ceiling = _LOOP_SHARE * loop
    is_denied = granted < state.asked and (known is None or ceiling < state.asked)
    is_at_it = abs(state.rate - ceiling) <= 0.05 * ceiling and state.asked >= 1.1 * ceiling
    if not (is_denied or is_at_it):
        return None
    if is_at_it:
        own = f"SCHED_LOOP_RATE = {loop:.0f}" if known else f"a SCHED_LOOP_RATE of {loop:.0f}"
        why = f"that is 0.8 of {own}, the most that ArduPilot streams."
    else:
        own = f"SCHED_LOOP_RATE = {known:.0f}" if known else "SCHED_LOOP_RATE"
        why = (
            f"{granted:.0f} Hz were granted, and {state.asked:.0f} denied: ArduPilot streams no "
            f"more than 0.8 of {own}."
        )
    # The interval is in whole milliseconds
    wanted = min(50.0 * math.ceil(state.asked / _LOOP_SHARE / 50.0), _LARGEST_LOOP)
    return (why, f"Set SCHED_LOOP_RATE = {wanted:.0f} (up to {_LARGEST_LOOP:.0f}) and reboot.")


def _budget(evidence: Evidence, state: MessageState, lost: float) -> _Cause | None:
    """Return a cause if all streams are slower by one factor, apart from the share lost."""
    shares = [
        state.rate / (1.0 - lost) / _promised(evidence, name)
        for name, state in evidence.messages.items()
        if state.asked > 1.0
        and state.answer == "accepted"
        and state.rate > 0.0
        # A receiver gives what it has
        and name != "GPS_RAW_INT"
    ]
    opening = evidence.opening
    baud = opening.baud if opening is not None and _line(evidence) == "serial" else 0
    is_full = baud > 0 and evidence.bytes_rate > 0.8 * baud / 10.0
    factor = median(shares) if shares else state.rate / max(state.asked, state.rate)
    alike = sum(abs(share - factor) <= ALIKE * factor for share in shares)
    if not is_full and (factor > ENOUGH or alike < 3):
        return None
    need = evidence.bytes_rate / max(factor, 0.01)
    wire = f" of {baud / 10e3:.1f} that the wire carries" if baud else ""
    is_open = _line(evidence) == "network" and evidence.family != "px4"
    who = "neither the autopilot nor the network gives more"
    return (
        f"all streams come at about {factor:.0%} of what was asked: "
        + (who if is_open else "the link's budget is spent")
        + f" ({evidence.bytes_rate / 1e3:.1f} kB/s{wire}; {need / 1e3:.1f} asked).",
        _more_budget(evidence, need),
    )


def _more_budget(evidence: Evidence, need: float) -> str:
    kind = _line(evidence)
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


def _more(evidence: Evidence, state: MessageState) -> str:
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
            f"{_promised(evidence, evidence.stamps.message):.0f} Hz were granted: look at the "
            "load of the autopilot's processor, and at who else asks it for streams."
        )
    if state.answer not in ("accepted", ""):
        return f"The request was answered “{state.answer}”. {_SENSORS}."
    return _SENSORS + ("." if is_live else ", or let the daemon ask: link.imu_rate = 100 or more.")
