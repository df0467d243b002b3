"""The stages in their order: evidence in, a finding for each out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ekf_companion.doctor import content, estimate, feedback, opening, peer, rates, transport
from ekf_companion.doctor.evidence import Evidence
from ekf_companion.doctor.finding import Finding, Mark, Stage, unknown

_JUDGES: dict[Stage, Callable[[Evidence], Finding]] = {
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
_GATES = (Stage.LINK, Stage.BYTES, Stage.FRAMES, Stage.SOURCE)
"""Behind these, where they fail, nothing can be seen."""


def diagnose(evidence: Evidence) -> list[Finding]:
    """Judge every stage, in order; what a failed one hides is unknown."""
    findings: list[Finding] = []
    is_hidden = False
    for stage, judge in _JUDGES.items():
        if is_hidden:
            findings.append(unknown(stage, "not reached"))
            continue
        finding = judge(evidence)
        findings.append(finding)
        is_hidden = stage in _GATES and finding.mark is Mark.FAILED
    return findings


def first_failure(findings: Sequence[Finding]) -> Finding | None:
    """Give the stage at which the data are lost; None: at none."""
    return next((finding for finding in findings if finding.mark is Mark.FAILED), None)
