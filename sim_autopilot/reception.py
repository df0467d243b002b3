"""The autopilot's verdicts on the ODOMETRY that it received, by its own rules, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from sim_autopilot.acceptance import History, Stack, judge

_REASONS = 32
"""Most reasons that are counted separately."""


class Reception:
    """Judges message by message."""

    def __init__(self, rules: str, parameters: Mapping[str, float]) -> None:
        """Judge by a ``Stack``'s rules; empty: accept all. Parameters are read for each message."""
        self.accepted = 0
        """Messages that were passed to the filter."""
        self.fused = 0
        """Messages of which the filter fuses something, before its gates."""
        self.refused: Counter[str] = Counter()
        """Messages that were not, by reason."""
        self.unfused: Counter[str] = Counter()
        """Messages that were accepted, and not or not wholly fused, by reason."""
        self._stack = Stack(rules) if rules else None
        self._parameters = parameters
        self._history = History()

    def take(self, odometry: Any) -> str:
        """Judge a message; return the critical text that the pilot sees, empty: none."""
        if self._stack is None:
            self.accepted += 1
            return ""
        judgement = judge(self._stack, odometry, self._parameters, self._history)
        self._history = judgement.history
        if not judgement.is_accepted:
            _count(self.refused, judgement.reason)
            return judgement.text
        self.accepted += 1
        self.fused += bool(judgement.fused)
        if judgement.reason:
            _count(self.unfused, judgement.reason)
        return judgement.text

    def summary(self) -> dict[str, Any]:
        """Return the counts, for JSON."""
        return {
            "accepted": self.accepted,
            "fused": self.fused,
            "refused": dict(self.refused),
            "not_fused": dict(self.unfused),
        }


def _count(counter: Counter[str], reason: str) -> None:
    """Count under a bounded number of reasons, as some contain a number."""
    counter[reason if reason in counter or len(counter) < _REASONS else "another"] += 1


def sentence(summary: Mapping[str, Any]) -> str:
    """Return it as ``odometry: accepted N, refused M: reason``."""
    refused = sum(summary["refused"].values())
    line = f"odometry: accepted {summary['accepted']}, refused {refused}"
    if summary["refused"]:
        line += ": " + "; ".join(f"{why} ({n})" for why, n in summary["refused"].items())
    return line
