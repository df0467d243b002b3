"""What the messages contain: their time stamps and their values."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ekf_companion.doctor.evidence import Evidence, Means
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, unknown, warning
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.mavlink.clock import FOREIGN, NO_TIME
from ekf_companion.mavlink.decode.inertial import ANOTHER_UNIT, UNIT_CHANGED
from ekf_companion.mavlink.session import MISADDRESSED
from ekf_companion.status.snapshot import TimeState

_MANY = 0.05
"""Share of refused measurements that is more than chance."""
_LEAPS = (": stamp leaps", ": stamp far from the inertial samples")
"""Why a measurement with a stamp far from the others is refused, after its message."""
_TOO_MUCH_SKEW = 200.0
"""ppm; a crystal has less than 100."""
_STILL = 3.0
"""Seconds for which a fix may be repeated: the slowest receiver has a new one each second."""
_FIXES = ("no receiver", "no fix", "2-D fix", "3-D fix", "DGPS fix", "RTK float", "RTK fixed")


def time(evidence: Evidence) -> StageResult:
    """Judge time stamps and clocks."""
    state = evidence.time
    if state.base == "unknown":
        return unknown(Stage.TIME, "nothing that has a time has come")
    saw = f"since {'boot' if state.base == 'boot' else '1970'}"
    if state.is_locked:
        saw += f", synchronised to {state.rtt_p95_ms:.1f} ms, {state.skew_ppm:+.0f} ppm"
    elif state.answers:
        saw += f", {state.answers} answers to TIMESYNC"
    leaps = sum(n for why, n in evidence.refused.items() if why.endswith(_LEAPS))
    if leaps:
        saw += f"; not used, as their stamps leap: {leaps}"
    return judged(Stage.TIME, saw, [*_clocks(evidence), *_stamps(evidence), *_timesync(evidence)])


def _is_of_time(why: str) -> bool:
    """Return whether a refusal is for a stamp, which the stage ``time`` reports."""
    return why.endswith((*_LEAPS, ": time base unknown")) or why == "clock set back"


def _clocks(evidence: Evidence) -> Iterator[Problem]:
    stamps = evidence.stamps
    if stamps.zero > 0.5 * max(stamps.count, 1):
        yield failed(
            f"{stamps.message} holds no time: {stamps.zero} of {stamps.count} stamps are 0.",
            "Update the autopilot's firmware; until then use another inertial message.",
        )
    lost = evidence.refused.get("GPS_RAW_INT: time base unknown", 0)
    if lost > max(5, evidence.receiver.messages // 2):
        state = evidence.messages.get("SYSTEM_TIME")
        has_time = state is not None and state.count > 0
        yield failed(
            f"GPS_RAW_INT counts time from another start than {stamps.message}, and "
            + ("SYSTEM_TIME does not know the date yet." if has_time else "no SYSTEM_TIME comes."),
            "Wait until the receiver knows the date."
            if has_time
            else "Stream SYSTEM_TIME, which relates both clocks: PX4 MAV_n_MODE = 2 (Onboard); "
            "ArduPilot SRn_EXTRA3 = 2.",
        )
    if evidence.refused.get("GPS_RAW_INT: stamp far from the inertial samples", 0) > 2:
        yield failed(
            f"GPS_RAW_INT is stamped more than 30 s away from {stamps.message}.",
            "Stream SYSTEM_TIME, which relates both clocks: ArduPilot SRn_EXTRA3 = 2.",
        )
    if evidence.peer is not None and evidence.peer.reboots:
        yield warning(
            f"The autopilot's clock began anew: it rebooted (restarts: {evidence.peer.reboots}).",
            "Look at its power.",
        )


def _stamps(evidence: Evidence) -> Iterator[Problem]:
    stamps = evidence.stamps
    count = max(stamps.count, 1)
    if stamps.repeated > _MANY * count:
        yield warning(
            f"{stamps.repeated} of {stamps.count} stamps of {stamps.message} repeat the one "
            "before: two paths bring the same frames, or it is sent faster than it is measured.",
            "Let only one router endpoint lead here, or lower link.imu_rate to the sensor's rate.",
        )
    if stamps.backward > 0.01 * count:
        yield warning(
            f"{stamps.backward} of {stamps.count} stamps of {stamps.message} go back.",
            "Let only one path lead here; over UDP and radio take a link that keeps the order.",
        )
    # A reboot is reported already
    if stamps.leaps and not (evidence.peer is not None and evidence.peer.reboots >= stamps.leaps):
        times = "once" if stamps.leaps == 1 else f"{stamps.leaps} times"
        yield warning(
            f"The stamps of {stamps.message} leap {times} away from the times at which they came, "
            f"by up to {stamps.largest_leap:.3g} s: the estimate begins anew there.",
            "Look at what sets the autopilot's clock in flight, or the clock of the computer that "
            "received them; a recording may have been joined of several.",
        )
    if stamps.is_whole_ms and stamps.message.startswith("SCALED"):
        yield warning(
            f"{stamps.message} is stamped in whole milliseconds: at high rates its steps are "
            "uneven.",
            "Take HIGHRES_IMU: ArduPilot 4.6 or newer on a board of more than 1 MB has it.",
        )


def _timesync(evidence: Evidence) -> Iterator[Problem]:
    state, wanted = evidence.time, evidence.config.timesync
    # A recording shows as much, if it holds our requests
    is_asked = state.answers or state.trouble or evidence.means is Means.LIVE
    if not (is_asked and wanted.request) or evidence.means is Means.LISTENING:
        return
    if evidence.seconds < 6.0:
        return
    if not state.is_locked and state.rtt_p50_ms > wanted.largest_rtt * 1e3:
        yield warning(
            f"TIMESYNC takes too long: {state.rtt_p50_ms:.0f} ms there and back.",
            f"Set timesync.largest_rtt = {max(state.rtt_p50_ms * 2e-3, 0.02):.2g}, or take a "
            "faster link than a radio.",
        )
    elif not state.is_locked and not state.answers and not state.refused:
        yield warning(
            "The autopilot does not answer TIMESYNC; the estimate goes by its stamps and needs "
            "none, PX4 does to place our ODOMETRY in time.",
            "Let TIMESYNC (id 111) pass the router both ways.",
        )
    elif state.trouble:
        yield warning(
            f"The autopilot's clock cannot be compared with ours: {state.trouble}.",
            _timesync_remedy(state),
        )
    if abs(state.skew_ppm) > _TOO_MUCH_SKEW:
        runs = "faster" if state.skew_ppm > 0.0 else "slower"
        yield warning(
            f"The autopilot's clock runs {abs(state.skew_ppm) * 1e-4:.2g} % {runs} than ours.",
            "A crystal has less than 0.01 %: stop what steps this board's clock, or give a "
            "simulator more of the processor.",
        )


def _timesync_remedy(state: TimeState) -> str:
    """Return what to do about a clock that cannot be compared."""
    if math.isfinite(state.residual_us):  # answers are in use
        return (
            "A simulator: give it more of the processor, or less to simulate. Else stop what steps "
            "this board's clock."
        )
    if state.refused.get(FOREIGN):
        return (
            "Somebody else on this link is answered, and we are not, or 1.6 s late: let our "
            "TIMESYNC (id 111) pass the router to the autopilot, or take a faster link."
        )
    if state.refused.get(NO_TIME):
        return "Update the autopilot's firmware."
    return "Let TIMESYNC (id 111) pass the router both ways."


def values(evidence: Evidence) -> StageResult:
    """Judge whether the values in the messages are plausible."""
    receiver = evidence.receiver
    saw = "all can be meant"
    if receiver.messages:
        fix = _FIXES[receiver.fix_type] if receiver.fix_type < len(_FIXES) else "fix"
        satellites = f", {receiver.satellites} satellites" if receiver.satellites < 255 else ""
        saw = f"GNSS: {fix}{satellites}"
    strange = {
        why: count
        for why, count in evidence.refused.items()
        if why not in ("IMU: a better source speaks", "GPS_RAW_INT: first after none")
        and not why.endswith(ANOTHER_UNIT)
        and not _is_of_time(why)
        and not why.endswith(MISADDRESSED)
    }
    if strange:
        worst = sorted(strange.items(), key=lambda item: -item[1])[:3]
        saw += "; " + ", ".join(f"{why} ({count})" for why, count in worst)
    return judged(Stage.VALUES, saw, [*_inertial(evidence), *_magnetic(evidence), *_gnss(evidence)])


def _inertial(evidence: Evidence) -> Iterator[Problem]:
    stale = evidence.refused.get("HIGHRES_IMU: accel or gyro not updated", 0)
    empty = evidence.refused.get("SCALED_IMU: no sensor behind it", 0)
    other = evidence.refused.get("HIGHRES_IMU: another instance", 0)
    count = max(evidence.stamps.count, 1)
    if stale > 0.5 * count:
        yield failed(
            f"{stale} of {count} HIGHRES_IMU say that accelerometer or gyro are not updated "
            "(fields_updated).",
            "Look at the autopilot's sensors (PX4: `sensors status`), or lower link.imu_rate to "
            "their rate.",
        )
    if empty > 0.5 * count and evidence.stamps.message.startswith("SCALED"):
        yield failed(
            f"{evidence.stamps.message} comes with zeros: there is no sensor behind it.",
            "Let the autopilot send RAW_IMU or HIGHRES_IMU: SRn_RAW_SENS = 50.",
        )
    if changes := evidence.refused.get(UNIT_CHANGED, 0):
        often = "once" if changes == 1 else f"{changes} times"
        yield warning(
            f"An inertial unit was left for another, {often}: the log and the status say which, "
            "and why.",
            "Look at its mounting, its range and its temperature; ArduPilot: INS_ENABLE_MASK "
            "leaves one out.",
        )
    if other > 0.5 * count:
        yield failed(
            "HIGHRES_IMU comes of another sensor than the first.",
            "Make the first inertial sensor the primary one.",
        )


def _magnetic(evidence: Evidence) -> Iterator[Problem]:
    million = evidence.refused.get("mag: unit corrected by 1e6", 0)
    wrong = evidence.refused.get("mag: no field of the Earth", 0)
    heading = evidence.estimator.verdicts[Aid.HEADING] if evidence.estimator else {}
    disturbed = heading.get(Verdict.DISTURBED, 0)
    fused = heading.get(Verdict.FUSED, 0) + heading.get(Verdict.DEWEIGHTED, 0)
    if million:
        yield warning(
            "The magnetometer of HIGHRES_IMU comes a million times too large (ArduPilot before "
            "its fix #32286); it is divided here, and nothing is lost.",
            "Update ArduPilot when you can.",
        )
    if wrong > 10:
        yield warning(
            f"{wrong} magnetic fields are weaker or stronger than the Earth's: motors, steel, or "
            "an uncalibrated magnetometer.",
            "Calibrate the magnetometer in the autopilot; `ekf-companion calibrate mag LOG` "
            "measures heading.hard_iron.",
        )
    if disturbed > 10 and disturbed > 0.2 * (disturbed + fused):
        yield warning(
            f"{disturbed} magnetic fields do not fit the Earth's at this place, and were not used.",
            "Calibrate: `ekf-companion calibrate mag LOG` measures heading.hard_iron and "
            "heading.soft_iron; or heading.source = autopilot.",
        )


def _gnss(evidence: Evidence) -> Iterator[Problem]:
    refused, receiver = evidence.refused, evidence.receiver
    count = max(receiver.messages, 1)
    none = refused.get("GPS_RAW_INT: no 3-D fix", 0) + refused.get("GPS_RAW_INT: no position", 0)
    satellites = f" ({receiver.satellites} satellites)" if receiver.satellites < 255 else ""
    if receiver.messages > 0 and receiver.fix_type < 3:
        yield failed(
            f"The receiver has no 3-D fix{satellites}.",
            "Give its antenna a free view of the sky, away from cables and cameras; after a cold "
            "start wait a minute.",
        )
    elif none > _MANY * count:
        yield warning(
            f"{none} of {receiver.messages} GPS_RAW_INT had no 3-D fix.",
            "If that was in flight: look at the antenna and at what disturbs it.",
        )
    # Of a receiver that repeats one fix, now or for a while
    is_still = receiver.still_s > _STILL
    seconds = receiver.still_s if is_still else receiver.longest_still_s
    if seconds > _STILL:
        severity, when = (failed, "now") if is_still else (warning, "at the longest")
        yield severity(
            f"The same fix comes again and again, {when} for {seconds:.0f} s: the receiver, or the "
            "autopilot's reading of it, stands still.",
            "Look at the receiver's wire; ArduPilot repeats the last fix when the receiver is out.",
        )
    if receiver.without_time > _MANY * count and receiver.fix_type >= 3:
        yield warning(
            f"{receiver.without_time} GPS_RAW_INT hold no time; the newest inertial stamp stands "
            "in, which may be 0.1 s off.",
            "Set the receiver to send UTC (UBX-NAV-PVT), or wait until it knows the time.",
        )
    is_first_version = evidence.first_version >= 0.99 * evidence.frames.frames
    if receiver.fix_type >= 3 and not receiver.has_accuracy and not is_first_version:
        yield warning(
            "The receiver reports no accuracy (h_acc is 0): it is guessed from the dilution.",
            "Let the autopilot read the receiver in a protocol that has it (u-blox UBX), and let "
            "no router turn MAVLink 2 into 1.",
        )
