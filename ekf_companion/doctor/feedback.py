"""The last stages: ODOMETRY is sent, and the autopilot fuses it.

Sources: PX4's and ArduPilot's documentation of external position estimates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from ekf_companion.doctor.evidence import Evidence, Means
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, unknown, warning
from ekf_companion.engine.pipeline import QUALITY
from ekf_companion.mavlink.encode import Frame
from ekf_companion.nav.state import Status

_ARDUPILOT_FRAMES = (Frame.LOCAL_FRD, Frame.BODY_FRD)
_SLOWEST = 10.0
"""Hz: PX4 fuses no external position that comes less often than every 0.1 to 0.2 s."""
_HOW = {
    "px4": "EKF2_EV_CTRL = 15 and EKF2_GPS_CTRL = 0",
    "ardupilot": "VISO_TYPE = 1 and EK3_SRC1_* = 6",
}
"""The parameters by which each family fuses ODOMETRY and no GNSS of its own."""
_LEAST_QUALITY = {"px4": "EKF2_EV_QMIN", "ardupilot": "VISO_QUAL_MIN"}
"""Parameters that name the least quality of an ODOMETRY that is fused."""
_HEIGHTS = {1.0: ("EKF2_GPS_CTRL", 2), 3.0: ("EKF2_EV_CTRL", 2)}
"""Values of EKF2_HGT_REF, GNSS and ours, with the parameter and its bit that fuses that height."""
_DELAY = 20.0
"""ms."""
_CONST_POSITION, _UNINITIALISED = 128, 1024
"""Bits of EKF_STATUS_REPORT.flags."""


def sent(evidence: Evidence) -> StageResult:
    """Judge whether ODOMETRY is sent, how often and in which frame."""
    ours, output = evidence.sent, evidence.output
    frames = ", ".join(f"{frame}/{child}" for frame, child in sorted(ours.frames))
    if not ours.count and evidence.means is Means.LISTENING:
        return unknown(Stage.SENT, "nothing is sent with --listen")
    if not ours.count and evidence.means is Means.RECORDING:
        return unknown(Stage.SENT, "no ODOMETRY of ours is in the recording")
    if output.mode == "never":
        return judged(Stage.SENT, "nothing, for output.odometry.mode is never")
    what = f"ODOMETRY {ours.rate:.0f} Hz, frames {frames}"
    if not ours.frames:
        what = f"VISION_POSITION_ESTIMATE {ours.rate:.0f} Hz"  # in its place, to old firmware
    saw = what if ours.count else "no ODOMETRY"
    if not math.isnan(output.late_s):
        saw += f", {output.late_s * 1e3:.0f} ms late at the autopilot"
    if output.withheld and not ours.count:
        saw += f", {output.withheld} withheld"
    problems = _unfit(evidence) if ours.count else [_withheld(evidence)]
    return judged(Stage.SENT, saw, problems)


def _withheld(evidence: Evidence) -> Problem:
    """Return why no ODOMETRY is sent."""
    output, health = evidence.output, evidence.estimator
    if evidence.is_clash:
        return failed(
            "ODOMETRY is withheld while somebody else speaks under our ids.",
            "See the stage `source`.",
        )
    if output.withheld:
        longer = "Look again for longer: --seconds 60."
        remedy = _remedy(evidence, output.remedy) if output.remedy else longer
        return failed(f"ODOMETRY is withheld: {output.reason}.", remedy)
    if health is None or health.status < Status.OK:
        return failed("There is no estimate to send.", "Mend the first failing stage above.")
    return failed(
        "The estimate is there, and no ODOMETRY goes out.",
        "Look at output.odometry in the configuration.",
    )


def _remedy(evidence: Evidence, words: str) -> str:
    own = " Where our receiver is our own: output.odometry.independent = true."
    return f"{words[:1].upper()}{words[1:]}.{own if evidence.decision.is_double else ''}"


def _unfit(evidence: Evidence) -> Iterator[Problem]:
    """Yield why the autopilot cannot use the ODOMETRY that is sent."""
    ours, output = evidence.sent, evidence.output
    if output.advice:
        yield warning(
            f"ODOMETRY arrives {output.late_s * 1e3:.0f} ms after its state was true.",
            f"{output.advice[:1].upper()}{output.advice[1:]}.",
        )
    if output.every > 1:
        yield warning(
            f"The line carries one ODOMETRY of {output.every}.",
            "Raise the baud rate at both ends, or lower output.odometry.rate.",
        )
    if evidence.family == "ardupilot" and ours.frames and _ARDUPILOT_FRAMES not in ours.frames:
        yield failed(
            "ArduPilot takes ODOMETRY in LOCAL_FRD only, and leaves any other without a word.",
            "Set output.odometry.frame = LOCAL_FRD.",
        )
    if ours.count >= 20 and ours.rate < _SLOWEST and evidence.means is not Means.RECORDING:
        yield warning(
            f"ODOMETRY goes out at {ours.rate:.1f} Hz: the autopilot fuses nothing so rare.",
            "Set output.odometry.rate = 30, and mend the inertial rate: there is one per sample.",
        )


def fused(evidence: Evidence) -> StageResult:
    """Judge what the autopilot does, or would do, with our ODOMETRY."""
    decision, refusal = evidence.decision, _refusal(evidence)
    is_kept_back = evidence.output.withheld > 0 and not evidence.sent.count
    if evidence.family not in _HOW:
        return unknown(Stage.FUSED, "an autopilot of a family that is not known")
    if not decision.is_settled and not evidence.asked_parameters and refusal is None:
        return unknown(Stage.FUSED, "its parameters were not asked")
    if refusal is None and is_kept_back and not decision.is_streaming:
        return unknown(Stage.FUSED, "nothing is sent to it")
    if decision.is_double:
        # The parameters alone, which come first: the sentence follows below
        saw = decision.reason.split(":")[0]
        return judged(Stage.FUSED, saw, [refusal, _double(evidence)])
    if not decision.is_streaming:
        return judged(Stage.FUSED, "its parameters are not known", [refusal, _unread(evidence)])
    if not decision.is_fused:
        saw = f"{decision.reason}; it would with {_HOW[evidence.family]}"
        return judged(Stage.FUSED, saw, [refusal])
    problems = [refusal, _apart(evidence), *_unfavourable(evidence), _rejects(evidence)]
    return judged(Stage.FUSED, f"{decision.reason}{_dead_reckoning(evidence)}", problems)


def _dead_reckoning(evidence: Evidence) -> str:
    """Return what the autopilot does with dead reckoning, by its least quality; empty: unknown."""
    name = _LEAST_QUALITY[evidence.family]
    if (least := evidence.parameters.get(name)) is None:
        return ""
    ours = QUALITY[Status.DEAD_RECKONING]
    if least > ours:
        return f"; dead reckoning (quality {ours}) is not fused: {name} = {least:g}"
    return (
        f"; so is dead reckoning (quality {ours}), for as long as "
        f"output.odometry.dead_reckoning_time and _std let it be sent: {name} = {least:g}, "
        "with 30 it is refused at once"
    )


def _apart(evidence: Evidence) -> Problem | None:
    """Return that the autopilot's own estimate is not what it is sent."""
    if not (apart := evidence.following.apart):
        return None
    return failed(
        f"The autopilot does not follow ODOMETRY: its own estimate is {apart}.",
        "See whether another component sends it a position, how long its answers to TIMESYNC take, "
        "and its texts; until then fly on its own receiver.",
    )


def _unread(evidence: Evidence) -> Problem:
    return warning(
        "The autopilot did not report its parameters, so its use of ODOMETRY is not known.",
        "Let PARAM_REQUEST_READ and PARAM_VALUE pass the router; look yourself at "
        + ("EKF2_EV_CTRL and EKF2_GPS_CTRL." if evidence.family == "px4" else "EK3_SRC1_*."),
    )


def _double(evidence: Evidence) -> Problem | None:
    if evidence.config.output.odometry.independent:
        return None
    severity, decision = failed if evidence.sent.count else warning, evidence.decision
    return severity(
        f"The same GNSS would count twice, for {decision.reason}.",
        _remedy(evidence, decision.remedy),
    )


def _refusal(evidence: Evidence) -> Problem | None:
    for text in evidence.feedback.texts:
        if "estimator_type" in text:
            return failed(
                f"The autopilot refuses our ODOMETRY: “{text}”.",
                "Set output.odometry.estimator_type = auto.",
            )
    return None


def _unfavourable(evidence: Evidence) -> Iterator[Problem]:
    """Yield the parameters by which the autopilot refuses or misplaces our ODOMETRY."""
    parameters, reached = evidence.parameters, QUALITY[Status.DEGRADED]
    quality = _LEAST_QUALITY[evidence.family]
    if (least := parameters.get(quality, 0.0)) > reached:
        yield warning(
            f"{quality} = {least:g} refuses ODOMETRY of a quality below that; ours is 100 when all "
            f"is well, {reached} without an aid.",
            f"Set {quality} = 30: dead reckoning (20) is then refused, and nothing else.",
        )
    reference = parameters.get("EKF2_HGT_REF", 0.0)
    name, bit = _HEIGHTS.get(reference, ("", 0))
    value = parameters.get(name)
    if value is not None and not int(value) & bit:
        yield warning(
            f"EKF2_HGT_REF = {reference:g} names a height that {name} = {value:g} does not fuse.",
            f"Set EKF2_HGT_REF = 0 (barometer), or add {bit} to {name}.",
        )
    late = evidence.output.late_s * 1e3
    if (delay := parameters.get("EKF2_EV_DELAY", 0.0)) > _DELAY and not delay < late + _DELAY:
        yield warning(
            f"EKF2_EV_DELAY = {delay:g} ms is taken off the stamps of our ODOMETRY, which are of "
            "the autopilot's own time already.",
            "Set EKF2_EV_DELAY = 0.",
        )


def _rejects(evidence: Evidence) -> Problem | None:
    feedback = evidence.feedback
    if not evidence.sent.count:
        return None
    if feedback.worst_ratio > 1.0:
        return warning(
            f"The autopilot's own filter refuses measurements (test ratio "
            f"{feedback.worst_ratio:.1f}; above 1 is refused).",
            "PX4: EKF2_EV_DELAY = 0 where TIMESYNC is locked, EKF2_EV_NOISE_MD = 0. ArduPilot: "
            "VISO_DELAY_MS = 0, and set the origin before take-off.",
        )
    flags = feedback.flags if evidence.family == "ardupilot" else 0
    if flags & _UNINITIALISED:
        return warning(
            "ArduPilot's filter has not started yet.",
            "Without GNSS it needs an origin: set it in the ground station "
            "(SET_GPS_GLOBAL_ORIGIN).",
        )
    if flags & _CONST_POSITION:
        return warning(
            "ArduPilot's filter holds its position fixed: it takes no aid.",
            "Set EK3_SRC1_POSXY = 6 and EK3_SRC1_YAW = 6, and the origin (SET_GPS_GLOBAL_ORIGIN).",
        )
    return None
