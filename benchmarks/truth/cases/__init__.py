"""The named cases: a motion, and what is wrong with what was measured.

Each is a function of a seed's draws, and its docstring the sentence of the list; "about" is drawn
within 30 % from seed to seed, as are the place, the moment, the direction and the sign.
"""

from __future__ import annotations

from benchmarks.truth.cases import height, inertial, nothing, receiver, sources, stamps, start
from benchmarks.truth.cases.case import Case
from benchmarks.truth.draw import Draw
from benchmarks.truth.sensors import Readings

CASES: dict[str, Case] = {
    function.__name__.replace("_", "-"): function
    for room in (nothing, receiver, start, height, inertial, stamps)
    for function in room.CASES
} | sources.CASES

USUAL = tuple(name for name in CASES if not name.endswith("-outage"))
"""Those that are flown unless others are asked for: a source's faults beside the receiver."""


def generate(name: str, seed: int) -> Readings:
    """Return what was measured in a case; a seed is a flight."""
    return CASES[name](Draw(seed, name))
