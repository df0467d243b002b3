"""The stages in their order: evidence in, a result for each out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ekf_companion.doctor import content, estimate, feedback, opening, peer, rates, transport
from ekf_companion.doctor.evidence import Evidence
from ekf_companion.doctor.stage import NOT_REACHED, Outcome, Stage, StageResult, unknown

_JUDGES: dict[Stage, Callable[[Evidence], StageResult]] = {
    Stage.LINK: opening.link,
    Stage.BYTES: transport.bytes_,
    Stage.FRAMES: transport.frames,
    Stage.CHECKSUMS: transport.checksums,
    Stage.SOURCE: peer.source,
    Stage.MESSAGES: peer.messages,
    Stage.RATES: rates.rates,
    Stage.TIME: content.time,
    Stage.VALUES: content.values,
    Stage.ESTIMATE: estimate.estimate,
    Stage.SENT: feedback.sent,
    Stage.FUSED: feedback.fused,
}
GATES = (Stage.LINK, Stage.BYTES, Stage.FRAMES, Stage.SOURCE)
"""If one of these fails, nothing can be known about the stages after it."""


def diagnose(evidence: Evidence) -> list[StageResult]:
    """Judge every stage, in order; those that a failed one hides are unknown."""
    results: list[StageResult] = []
    is_hidden = False
    for stage, judge in _JUDGES.items():
        results.append(unknown(stage, NOT_REACHED) if is_hidden else judge(evidence))
        is_hidden |= stage in GATES and results[-1].outcome is Outcome.FAILED
    return results


def first_failure(results: Sequence[StageResult]) -> StageResult | None:
    """Return the stage at which the data are lost; None if there is none."""
    return next((result for result in results if result.outcome is Outcome.FAILED), None)
