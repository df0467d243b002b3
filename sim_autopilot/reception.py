"""What became of the ODOMETRY that the autopilot got: its own rules, and the count."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from sim_autopilot.acceptance import History, Stack, judge

_REASONS = 32
"""Told apart."""


class Reception:
    """Judges message by message."""

    def __init__(self, rules: str, parameters: Mapping[str, float]) -> None:
        """Judge by a ``Stack``'s rules; empty: take all. The parameters are looked at each time."""
        self.accepted = 0
        """Messages that were handed to the filter."""
        self.fused = 0
        """Messages of which the filter fuses something, gates apart."""
        self.refused: Counter[str] = Counter()
        """Messages that were not, by reason."""
        self.unfused: Counter[str] = Counter()
        """Messages that were accepted, and not or not wholly fused, by reason."""
        self._stack = Stack(rules) if rules else None
        self._parameters = parameters
        self._history = History()

    def take(self, odometry: Any) -> str:
        """Judge one; give the critical text that the pilot sees of it, empty: none."""
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
        """Give the counts, as JSON has them."""
        return {
            "accepted": self.accepted,
            "fused": self.fused,
            "refused": dict(self.refused),
            "not_fused": dict(self.unfused),
        }


def _count(counter: Counter[str], reason: str) -> None:
    """Count, under a bounded number of reasons: some have a number in them."""
    counter[reason if reason in counter or len(counter) < _REASONS else "another"] += 1


def sentence(summary: Mapping[str, Any]) -> str:
    """Say it: ``odometry: accepted N, refused M: reason``."""
    refused = sum(summary["refused"].values())
    said = f"odometry: accepted {summary['accepted']}, refused {refused}"
    if summary["refused"]:
        said += ": " + "; ".join(f"{why} ({n})" for why, n in summary["refused"].items())
    return said
