"""The estimate that the filter makes of the messages, and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.doctor.evidence import Evidence
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, unknown, warning
from ekf_companion.engine.health import Aid, Health, Verdict
from ekf_companion.logs.recording import counted
from ekf_companion.nav.state import Status

_MANY = 0.05
"""Share of refused measurements that is more than chance."""
_NIS = 3.0
_GNSS = (
    "Raise gnss.{}_std, check gnss.lever_arm, and measure gnss.delay with "
    "`ekf-companion calibrate delay LOG`."
)
_COMPASS = (
    "Calibrate the magnetometer (`ekf-companion calibrate mag LOG`), look at the autopilot's "
    "compass orientation, or raise heading.magnetometer_std."
)
_AIDS = {
    Aid.POSITION: ("position", _GNSS.format("position")),
    Aid.HEIGHT: ("height", "Raise gnss.height_std."),
    Aid.VELOCITY: ("velocity", _GNSS.format("velocity")),
    Aid.HEADING: ("heading", _COMPASS),
    **{Aid[one.name.upper()]: (one.words, one.advice) for one in DECLARED},
}
"""Names of the aids, and what helps if they are refused."""
_RESETS = {
    "inertial gap": "Look at the stage `rates`: samples are missing for longer than gap_reset; on "
    "a slow radio raise imu.gap and imu.gap_reset.",
    "heading against the motion": "The compass points elsewhere than the vehicle flies: calibrate "
    "it, look at its orientation (CAL_MAG0_ROT, COMPASS_ORIENT).",
    "clock": "Look at the stage `time`: the autopilot's clock jumped.",
}
"""What helps after a reset, by its reason."""


def estimate(evidence: Evidence) -> StageResult:
    """Judge the estimate."""
    health = evidence.estimator
    if health is None:
        return unknown(Stage.ESTIMATE, "nothing to estimate from")
    saw = health.status.words
    if math.isfinite(health.std_horizontal):
        saw += f", position to {health.std_horizontal:.1f} m"
    problems = [_status(health), *_wrong(health), *_aids(health)]
    # A reboot is reported already
    resets = health.resets - (evidence.peer.reboots if evidence.peer else 0)
    if resets > 0:
        saw += f", {counted(resets, 'reset')} (the last: {health.reset_reason})"
        times = "once" if resets == 1 else f"{resets} times"
        jump = warning(
            f"The estimate was reset {times}; the last: {health.reset_reason}.",
            _RESETS.get(health.reset_reason, "Look at the aids that were refused before it."),
        )
        problems.append(jump)
    if health.gaps:
        saw += f", {counted(health.gaps, 'gap')}"
    return judged(Stage.ESTIMATE, saw, problems)


def _status(health: Health) -> Problem | None:
    if health.status is Status.OK:
        return None
    if health.status is Status.DEGRADED:
        absent = [
            _AIDS[aid][0]
            for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY, Aid.HEADING)
            if not health.fused(aid)
        ]
        without = " and ".join(absent)
        what = f" without {without}" if absent else ", but one aid is silent or refused"
        remedy = "Mend the warnings of the stages above first."
        return warning(f"The estimate goes on{what}.", remedy)
    if health.status in (Status.DEAD_RECKONING, Status.INVALID):
        return failed(
            "No fix is taken any more: the position drifts.",
            "Look at the receiver; the stage `values` says what came last.",
        )
    if not health.samples:
        return failed("No inertial sample has come through.", "Mend the first failing stage above.")
    if not any(health.verdicts[Aid.POSITION].values()):
        return failed(
            "Roll and pitch are found; no position is, for no fix has come.",
            "Give the receiver a free view of the sky; a second of rest and two fixes are enough.",
        )
    has_heading = health.verdicts[Aid.HEADING][Verdict.BEFORE_ALIGNMENT] > 0
    if health.status is Status.ATTITUDE or not has_heading:
        return failed(
            "North is not found: no heading has come.",
            "Stream ATTITUDE (SRn_EXTRA1 = 10), calibrate the magnetometer, or fly: in motion "
            "north follows from the fixes.",
        )
    return failed(
        "Down is not found yet: the vehicle moves, and has since the start.",
        "Let it stand for align.time = 1 s; on a ship raise align.rest_gyro and align.rest_accel.",
    )


def _wrong(health: Health) -> Iterator[Problem]:
    """Find what the fault hypotheses have found, where they decide."""
    for one in health.wrong:
        yield warning(
            f"The fault hypotheses say: {one.sentence}.",
            "Look at this sensor; a receiver needs a free view of the sky, a compass no iron.",
        )


def _aids(health: Health) -> Iterator[Problem]:
    for aid, (label, cure) in _AIDS.items():
        gated = health.verdicts[aid][Verdict.GATED] + health.verdicts[aid].get(Verdict.DENIED, 0)
        fused = health.fused(aid)
        share, nis = gated / max(gated + fused, 1), health.nis[aid]
        if gated > 5 and share > _MANY:
            yield warning(
                f"{share:.0%} of the measurements of the {label} contradict the estimate.", cure
            )
        elif math.isfinite(nis) and nis > _NIS and fused > 20:
            scatter = f"The {label} scatters {math.sqrt(nis):.1f} times as much as it claims."
            yield warning(scatter, cure)
