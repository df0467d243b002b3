"""How far the heading of a magnetic field can be trusted: by what else of the field has changed.

The Earth's field at a place has one horizontal and one vertical part. What a disturbance adds to
these two is seen; what it adds across them turns the heading and is not. A disturbance has no
reason to prefer a direction, so the part that is seen tells how large the other may be.
"""

from __future__ import annotations

import math

NEAR = 0.1
"""Share of the field's strength within which it is still the known one."""
CANDIDATE_MEMORY = 5.0
"""Time constant of the mean of a field that may become the known one, s."""
FIRST = 2.0
"""The first field is learnt over so long, s."""


class Compass:
    """The field that is known, and how far the present one is from it."""

    def __init__(self, memory: float, patience: float) -> None:
        """Begin with nothing known.

        Args:
            memory: Time constant of the known field, and of the mean stray, s.
            patience: A field that is another, but steady in motion for so long, is the known one.
        """
        self._memory, self._patience = memory, patience
        self.level = self.down = 0.0
        """The known field, gauss: its horizontal part and its vertical one."""
        self._age = 0.0
        self._square = 0.0
        self._other_level = self._other_down = 0.0
        self._other_for = 0.0

    def judge(self, level: float, down: float, dt: float, *, is_still: bool) -> tuple[float, bool]:
        """Return one sigma of the field's heading, rad, and whether another field is now the known.

        Args:
            level: Horizontal part of the present field, gauss.
            down: Vertical part of it.
            dt: Since the last one, s.
            is_still: The sensor stands still, and what it sees says nothing of other places.
        """
        self._age += dt
        a, b = level - self.level, down - self.down
        strength = math.hypot(self.level, self.down)
        stray = math.hypot(a, b)
        is_new = False
        if self._age <= FIRST or stray < NEAR * strength:
            share = dt / (min(self._age, FIRST) if self._age <= FIRST else self._memory)
            if self._age <= FIRST or not is_still:
                self.level += share * a
                self.down += share * b
            self._other_for = max(self._other_for - dt, 0.0)
        elif not is_still:
            is_new = self._consider(level, down, dt)
        stray2 = 0.0 if self._age <= FIRST or is_new else stray * stray
        self._square += min(dt / self._memory, 1.0) * (stray2 - self._square)
        across = math.sqrt(0.5 * max(stray2, self._square))
        return across / max(level, 1e-6), is_new

    def _consider(self, level: float, down: float, dt: float) -> bool:
        """Take a field that is not the known one; return whether it has been steady long enough."""
        a, b = level - self._other_level, down - self._other_down
        if math.hypot(a, b) > NEAR * math.hypot(level, down):
            self._other_for = max(self._other_for - dt, 0.0)
        else:
            self._other_for += dt
        share = min(dt / CANDIDATE_MEMORY, 1.0)
        self._other_level += share * a
        self._other_down += share * b
        if self._other_for < self._patience:
            return False
        self.level, self.down = self._other_level, self._other_down
        self._other_for = self._square = 0.0
        return True
