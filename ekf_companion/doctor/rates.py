"""Whether the messages come often enough, and who keeps them from it.

Sources: MAVLink's guide on message rates; PX4's and ArduPilot's documentation of their streams.
"""

from __future__ import annotations

import math
from statistics import median

from ekf_companion.bulletin import DECIMATED
from ekf_companion.doctor.evidence import Evidence, Means
from ekf_companion.doctor.finding import Finding, Stage, Trouble, failed, found, unknown, warning
from ekf_companion.mavlink.audit import INERTIAL
from ekf_companion.snapshot import MessageState

SLOWEST = 25.0
"""Inertial samples below this follow no flight, Hz."""
_ENOUGH = 0.8
"""Share of the rate asked that is as good as all of it."""
_ALIKE = 0.25
"""Streams whose rates differ by no more, as a share, were set by one hand."""
_GROUND = 12.0
"""A ground station sets streams no faster than this, Hz."""
_LOOP_SHARE = 0.8
"""Of SCHED_LOOP_RATE: ArduPilot streams nothing faster."""
_PLANE_LOOP = 50.0
_PX4_IMU = 250.0
_FEW_FIXES = 1.5
"""Hz."""
_LOST, _MANY_LOST = 0.01, 0.1
_STREAMED = (
    *INERTIAL,
    *("GPS_RAW_INT", "ATTITUDE", "GLOBAL_POSITION_INT", "SCALED_PRESSURE", "VFR_HUD"),
    *("SYS_STATUS", "RC_CHANNELS", "SERVO_OUTPUT_RAW", "AHRS2", "VIBRATION", "LOCAL_POSITION_NED"),
)


def rates(evidence: Evidence) -> Finding:
    """Judge the rates, asked and got, and the frames lost."""
    name = evidence.stamps.message
    state = evidence.messages.get(name)
    if state is None or not state.rate:
        return unknown(Stage.RATES, "no inertial message, no rate")
    gnss = evidence.messages.get("GPS_RAW_INT")
    asked = f" of {state.asked:.0f} asked" if state.asked else ""
    saw = f"{name} {_hertz(state.rate)}{asked}"
    if gnss is not None:
        saw += f", GPS_RAW_INT {_hertz(gnss.rate)}"
    share = _share_lost(evidence)
    saw += f", {share:.1%} lost"
    return found(
        Stage.RATES,
        saw + _note(evidence, state),
        [_slow(evidence, state), _slow_gnss(gnss), _lost(share, evidence)],
    )


def _hertz(rate: float) -> str:
    return f"{rate:.1f} Hz" if rate < 9.95 else f"{rate:.0f} Hz"


def _slow(evidence: Evidence, state: MessageState) -> Trouble | None:
    """Name who keeps the inertial message slow; None: it is as fast as asked, or as can be."""
    is_enough = state.rate >= DECIMATED
    is_short = state.rate < _ENOUGH * state.asked
    if is_enough and (not is_short or _is_whole_division(evidence, state)):
        return None
    say = failed if state.rate < SLOWEST else warning
    rate = f"{evidence.stamps.message} comes at {_hertz(state.rate)}"
    for judge in (_loop_rate, _budget, _ground_station):
        if (why := judge(evidence, state)) is not None:
            return say(f"{rate}: {why[0]}", why[1])
    if is_enough:
        # Nobody holds it back: the sensor gives no more
        return None
    return say(f"{rate}; flight needs {DECIMATED:.0f} or more.", _ask_for_more(evidence, state))


def _slow_gnss(gnss: MessageState | None) -> Trouble | None:
    if gnss is None or not 0.0 < gnss.rate < _FEW_FIXES:
        return None
    return warning(
        f"GPS_RAW_INT comes at {_hertz(gnss.rate)}: few fixes make a slow and coarse estimate.",
        "Set link.gnss_rate = 10, and the receiver to 5 Hz (ArduPilot: GPS1_RATE_MS = 200).",
    )


def _family(evidence: Evidence) -> str:
    return evidence.peer.family if evidence.peer else "unknown"


def _loop_rate(evidence: Evidence, state: MessageState) -> tuple[str, str] | None:
    """ArduPilot streams no faster than 0.8 of its loop: 40 Hz for planes and rovers."""
    if _family(evidence) != "ardupilot":
        return None
    loop = evidence.parameters.get("SCHED_LOOP_RATE", _PLANE_LOOP)
    ceiling = _LOOP_SHARE * loop
    if abs(state.rate - ceiling) > 0.05 * ceiling or state.asked < 1.1 * ceiling:
        return None
    # The interval is in whole milliseconds
    wanted = 50.0 * math.ceil(state.asked / _LOOP_SHARE / 50.0)
    return (
        f"that is 0.8 of SCHED_LOOP_RATE = {loop:.0f}, the most that ArduPilot streams.",
        f"Set SCHED_LOOP_RATE = {min(wanted, 400.0):.0f} (up to 400) and reboot.",
    )


def _ground_station(evidence: Evidence, state: MessageState) -> tuple[str, str] | None:
    """Many streams at one low rate were set by a ground station, typically to 4 Hz."""
    others = [
        evidence.messages[name].rate
        for name in _STREAMED
        if name in evidence.messages and evidence.messages[name].rate > 0.0
    ]
    if state.rate > _GROUND or len(others) < 3:
        return None
    usual = median(others)
    alike = [rate for rate in others if abs(rate - usual) <= _ALIKE * usual]
    if len(alike) < 3 or abs(state.rate - usual) > 2.0 * _ALIKE * usual:
        return None
    seen = " (its REQUEST_DATA_STREAM was seen here)" if evidence.stream_requests else ""
    return (
        f"{len(alike)} streams come at about {usual:.1f} Hz, so a ground station sets them{seen}, "
        "or the port's SRn_* parameters do.",
        "ArduPilot: let the port ignore it, SERIALn_OPTIONS + 4096 (MAVn_OPTIONS + 4 from 4.7 on), "
        "or set its SRn_* (MAVn_*) higher; in the ground station set the stream rate to -1 "
        "(MAVProxy: --streamrate=-1)."
        + (
            " For a recording: record at the companion."
            if evidence.means is Means.RECORDING
            else ""
        ),
    )


def _budget(evidence: Evidence, state: MessageState) -> tuple[str, str] | None:
    """All that was asked coming slower by one factor is the link's budget."""
    asked = [
        state.rate / state.asked
        for name, state in evidence.messages.items()
        if state.asked > 1.0
        and state.answer == "accepted"
        and state.rate > 0.0
        # A receiver gives what it has
        and name != "GPS_RAW_INT"
    ]
    opening = evidence.opening
    baud = opening.baud if opening is not None and opening.kind == "serial" else 0
    is_full = baud > 0 and evidence.bytes_rate > 0.8 * baud / 10.0
    if not is_full:
        if len(asked) < 3:
            return None
        usual = median(asked)
        if usual > _ENOUGH or sum(abs(share - usual) <= _ALIKE * usual for share in asked) < 3:
            return None
    factor = median(asked) if asked else state.rate / max(state.asked, state.rate)
    need = evidence.bytes_rate / max(factor, 0.01)
    wire = f" of {baud / 10e3:.1f} that the wire carries" if baud else ""
    if _family(evidence) == "px4":
        limits = {
            name: value
            for name, value in sorted(evidence.parameters.items())
            if name.startswith("MAV_") and name.endswith("_RATE")
        }
        told = ", ".join(f"{name} = {value:.0f}" for name, value in limits.items())
        remedy = (
            f"Set MAV_n_RATE = {1000 * math.ceil(need * 1.2 / 1000)} bytes/s for this port"
            f"{f' ({told} now; 0 is half of the wire)' if told else ''}, SER_TEL2_BAUD = 921600 "
            "and link.url with :921600."
        )
    else:
        remedy = (
            "Set SERIALn_BAUD = 921 and link.url with :921600, or lower link.imu_rate and the "
            "SRn_* of streams that nobody needs."
        )
    return (
        f"all streams come at about {factor:.0%} of what was asked: the link's budget is spent "
        f"({evidence.bytes_rate / 1e3:.1f} kB/s{wire}; {need / 1e3:.1f} asked).",
        remedy,
    )


def _ask_for_more(evidence: Evidence, state: MessageState) -> str:
    if evidence.means is Means.LISTENING:
        return "The daemon asks for link.imu_rate by itself: examine without --listen."
    if _family(evidence) == "px4":
        return (
            "Set IMU_INTEG_RATE = 250 and MAV_n_MODE = 2 (Onboard) for this port, and "
            f"link.imu_rate = {max(state.asked, 100.0):.0f} or more."
        )
    if state.answer not in ("accepted", ""):
        return (
            f"The request was answered “{state.answer}”: set SRn_RAW_SENS = 50 (MAVn_RAW_SENS from "
            "4.7 on) for this port."
        )
    return (
        "Set SRn_RAW_SENS = 50 (MAVn_RAW_SENS from 4.7 on) for this port, or let the daemon ask: "
        "link.imu_rate = 100 or more."
    )


def _is_whole_division(evidence: Evidence, state: MessageState) -> bool:
    """PX4 leaves out whole samples: 200 asked of 250 gives 125, and that is as it should be."""
    if _family(evidence) != "px4" or not state.asked:
        return False
    base = evidence.parameters.get("IMU_INTEG_RATE", _PX4_IMU)
    parts = max(1, math.ceil(base / state.asked - 0.05))
    return abs(state.rate - base / parts) <= 0.08 * base / parts


def _note(evidence: Evidence, state: MessageState) -> str:
    if state.rate < _ENOUGH * state.asked and _is_whole_division(evidence, state):
        return " (PX4 divides its rate by whole numbers)"
    return ""


def _share_lost(evidence: Evidence) -> float:
    counted = evidence.frames
    ours = sum(state.count for state in evidence.messages.values())
    return counted.lost / (counted.lost + ours) if ours else 0.0


def _lost(share: float, evidence: Evidence) -> Trouble | None:
    counted = evidence.frames
    if counted.late + counted.duplicates > 0.5 * counted.frames:
        return warning(
            "The frames' sequence numbers stand still: whoever made them numbers none, so losses "
            "cannot be seen.",
            "Nothing need be done for the estimate; a recording of the daemon's own has them.",
        )
    if share < _LOST:
        return None
    say = failed if share > 3.0 * _MANY_LOST else warning
    return say(
        f"{share:.0%} of the autopilot's frames never arrive"
        + (", the same share as a damaged wire or a full one." if share > _MANY_LOST else "."),
        "Connect RTS and CTS or lower the streams; behind a router that filters, the numbers have "
        "gaps though nothing is lost.",
    )
