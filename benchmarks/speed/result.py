"""One measured figure, and a table of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A measured figure."""

    name: str
    value: float
    unit: str
    aim: float | None = None
    """Largest value wanted; None: no aim."""

    @property
    def is_met(self) -> bool:
        """Whether the aim is met."""
        return self.aim is None or self.value <= self.aim


def table(results: Iterable[Result]) -> Iterable[str]:
    """Yield the figures as lines of text."""
    yield f"{'':<62} {'measured':>10} {'aim':>7}"
    for one in results:
        aim = "" if one.aim is None else f"{one.aim:.3g}"
        verdict = "" if one.is_met else "  <- above the aim"
        yield f"{one.name:<62} {_digits(one.value):>10} {aim:>7} {one.unit}{verdict}"


def _digits(value: float) -> str:
    """Format with three significant digits and no exponent."""
    size = abs(value)
    return f"{value:.0f}" if size >= 100.0 else f"{value:.1f}" if size >= 10.0 else f"{value:.2f}"
