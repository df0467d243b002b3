"""Whether the messages come often enough, and if not, why.

Sources: MAVLink's guide on message rates; PX4's and ArduPilot's documentation of their streams.
"""

from __future__ import annotations

import math

from ekf_companion.doctor.evidence import Evidence
from ekf_companion.doctor.slowness import (
    ENOUGH,
    budget,
    ground_station,
    line,
    loop_rate,
    more,
    promised,
)
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, unknown, warning
from ekf_companion.engine.announcer import DECIMATED
from ekf_companion.status.snapshot import MessageState

SLOWEST = 25.0
"""Inertial samples needed to follow a flight at all, Hz."""
_PX4_IMU = 250.0
_FEW_FIXES = 1.5
"""Hz."""
_LOST, _MANY_LOST = 0.01, 0.1


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
    problems = [_lost(share, evidence), *_slow(evidence, state, share)]
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
    given = promised(evidence, name)
    is_lost = share >= _LOST and abs(state.rate / (1.0 - share) - given) <= (1.0 - ENOUGH) * given
    sent = given if is_lost else state.rate
    is_short = sent < ENOUGH * state.asked
    is_well = sent >= DECIMATED and (not is_short or _is_whole_division(evidence, state))
    severity = failed if state.rate < SLOWEST else warning
    rate = f"{name} comes at {_hertz(state.rate)}"
    causes = [ground_station(evidence, state), None if is_well else loop_rate(evidence, state)]
    if not is_well and causes == [None, None]:
        causes = [budget(evidence, state, share if is_lost else 0.0)]
    named = [
        severity(f"{rate}: {cause.why}", cause.remedy) for cause in causes if cause is not None
    ]
    if named or sent >= DECIMATED:
        # Without another cause, the sensor has no higher rate
        return named
    return [severity(f"{rate}; flight needs {DECIMATED:.0f} or more.", more(evidence, state))]


def _is_whole_division(evidence: Evidence, state: MessageState) -> bool:
    """Return whether PX4 divides its rate by a whole number: 200 asked of 250 gives 125."""
    if evidence.family != "px4" or not state.asked:
        return False
    base = evidence.parameters.get("IMU_INTEG_RATE", _PX4_IMU)
    parts = max(1, math.ceil(base / state.asked - 0.05))
    return abs(state.rate - base / parts) <= 0.08 * base / parts


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
    severity, kind = failed if share > 3.0 * _MANY_LOST else warning, line(evidence)
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
