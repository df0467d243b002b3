"""One sentence on an estimate of a whole log: good, fair, poor, or attitude alone; and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status
from ekf_companion.replay.report import Report

STARTED = frozenset((Status.OK, Status.DEGRADED, Status.DEAD_RECKONING, Status.INVALID))
"""With a position."""
OFTEN, RARELY = 0.2, 0.05
"""Shares of the flight, or of the fixes, beyond which it is poor, or no more than fair."""
FAR, NEAR = 5.0, 2.0
"""Horizontal differences from a truth, m RMS, likewise: a receiver alone has 1 to 2 m."""
SLOW, FAST_ENOUGH = 20.0, 50.0
"""Inertial samples per second, Hz, likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What a log's estimate is good for."""

    grade: str
    """``good``, ``fair``, ``poor`` or ``attitude only``."""
    size: str
    """How large its horizontal error is, and by whom; empty: there is no position."""
    reasons: tuple[str, ...]
    """What speaks against it, the worst first."""

    @property
    def sentence(self) -> str:
        """The judgement as one sentence: ``good: 0.4 m, no resets``."""
        words = [self.size] if self.size else []
        return f"{self.grade}: {', '.join([*words, *(self.reasons or ('no resets',))])}"


def judge(report: Report, difference: tuple[float, str, bool] | None = None) -> Judgement:
    """Judge the estimate of a whole log.

    Args:
        report: Of the conversion.
        difference: Horizontal RMS difference from something else, m, its name, and whether that is
            a truth; None: nothing to compare with.
    """
    spent = sum(report.seconds.get(status, 0.0) for status in STARTED)
    poor, fair = _of_status(report, spent)
    for part in (_of_resets(report), _of_fixes(report), _of_samples(report)):
        poor += part[0]
        fair += part[1]
    size = ""
    if spent > 0.0 and np.isfinite(report.horizontal_std):
        size = f"{report.horizontal_std:.1f} m by its own sigma"
    if spent > 0.0 and difference is not None:
        rms, name, is_truth = difference
        size = f"{rms:.1f} m RMS from {name}"
        # The autopilot's own estimate may be the one that is wrong
        if rms > FAR:
            (poor if is_truth else fair).append(f"far from {name}")
        elif is_truth and rms > NEAR:
            fair.append(f"not close to {name}")
    if spent == 0.0:
        return Judgement(grade="attitude only", size="", reasons=(_why_no_position(report),))
    grade = "poor" if poor else "fair" if fair else "good"
    return Judgement(grade=grade, size=size, reasons=tuple(poor + fair))


def _of_status(report: Report, spent: float) -> tuple[list[str], list[str]]:
    """Return what the status says: reasons for poor, and for fair."""
    poor: list[str] = []
    fair: list[str] = []
    for status, words in (
        (Status.INVALID, "not valid for {:.0f} s"),
        (Status.DEAD_RECKONING, "without GNSS for {:.0f} s"),
        (Status.DEGRADED, "degraded for {:.0f} s"),
    ):
        seconds = report.seconds.get(status, 0.0)
        is_long = seconds > OFTEN * spent or status is Status.INVALID
        if seconds > 1.0 and seconds > RARELY * spent * (status is Status.DEGRADED):
            (poor if is_long else fair).append(words.format(seconds))
    return poor, fair


def _of_resets(report: Report) -> tuple[list[str], list[str]]:
    resets = report.health.resets if report.health else 0
    resets -= report.reboots
    if resets <= 0:
        times = "once" if report.reboots == 1 else f"{report.reboots} times"
        return [], [f"the autopilot rebooted {times}"] if report.reboots else []
    reason = report.health.reset_reason if report.health else ""
    words = [f"{resets} reset{'s' if resets > 1 else ''} (last: {reason})"]
    return (words, []) if resets > 2 else ([], words)


def _of_fixes(report: Report) -> tuple[list[str], list[str]]:
    """Judge the share of the fixes that was refused."""
    if report.health is None:
        return [], []
    verdicts = report.health.verdicts[Aid.POSITION]
    refused = verdicts[Verdict.GATED] + verdicts[Verdict.SUSPECT]
    share = refused / max(refused + verdicts[Verdict.FUSED] + verdicts[Verdict.DEWEIGHTED], 1)
    words = [f"{share:.0%} of the fixes refused"]
    return (words, []) if share > OFTEN else ([], words) if share > RARELY else ([], [])


def _of_samples(report: Report) -> tuple[list[str], list[str]]:
    rate = report.rates.get(Kind.IMU, 0.0)
    words = [f"inertial samples at {rate:.3g} Hz"]
    return (words, []) if rate < SLOW else ([], words) if rate < FAST_ENOUGH else ([], [])


def _why_no_position(report: Report) -> str:
    if report.counts[Kind.GNSS] + report.derived == 0:
        return "no GNSS fix"
    return "no position, for no heading was found"
