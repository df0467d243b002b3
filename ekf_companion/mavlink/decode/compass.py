"""Which of several compasses is used, where the autopilot sends the fields of more than one.

All of them turn with the vehicle, so their fields differ by a constant in its axes, which is learnt
while they agree, and each of them moves as the gyro says. The one in use is left when it has leapt
against the gyro and against one that has not, or when two others contradict it alike. The field of
the next is sent as the first would have measured it, so that nothing jumps. There is no way back
but the same.
"""

from __future__ import annotations

import math

from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.matrix3 import Vector3

LIMIT = 0.08
"""gauss; a larger deviation of a compass is a fault. By as much a level field of 0.2 gauss turns by
20 degrees; what currents and a poor calibration make it differ by is less."""
_FRESH_NS = SECOND_NS // 2
"""Age up to which a field is compared."""
_STEP_NS = SECOND_NS // 20
"""Least time between two fields of the first compass that are compared with the gyro."""
_LONGEST_NS = SECOND_NS
"""Longest time that the gyro is integrated over by its ends."""
_SMOOTH = 0.5
"""Time constant of a deviation from another compass, s."""
_LEAP = 1.0
"""Time constant of a deviation from the gyro, s: a leap may take some readings."""
_ENOUGH = 20
"""Comparisons before a difference is known."""
_MEMORY = 600
"""Comparisons over which it is learnt: a minute at 10 Hz."""
_LASTING_NS = 10 * SECOND_NS
"""A compass that has leapt is not gone to for so long, and then what it differs by is learnt
anew."""
_SILENT_NS = 3 * SECOND_NS
_LATENESS = 0.1
"""Time by which two fields may have been measured apart, s."""


class _Track:
    """The field of one compass, and how it deviates from what the gyro says."""

    def __init__(self, t_ns: int, field: Vector3) -> None:
        self.t_ns, self.field = t_ns, field
        self.off: Vector3 = (0.0, 0.0, 0.0)
        self.leapt_ns: int | None = None

    def follow(self, t_ns: int, field: Vector3, rate_b: Vector3) -> None:
        """Compare a field with the last one, turned by the gyro."""
        dt = (t_ns - self.t_ns) * 1e-9
        if not 0.0 < dt <= _LONGEST_NS * 1e-9:
            self.t_ns, self.field, self.off = t_ns, field, (0.0, 0.0, 0.0)
            return
        turn = (rate_b[0] * dt, rate_b[1] * dt, rate_b[2] * dt)
        fade = math.exp(-dt / _LEAP)
        off, was = _turned_back(self.off, turn), _turned_back(self.field, turn)
        self.off = (
            off[0] * fade + field[0] - was[0],
            off[1] * fade + field[1] - was[1],
            off[2] * fade + field[2] - was[2],
        )
        if math.hypot(*self.off) > LIMIT + _allowance(rate_b, field):
            self.leapt_ns = t_ns
        self.t_ns, self.field = t_ns, field

    def has_leapt(self, t_ns: int) -> bool:
        """Whether it has lately moved otherwise than the gyro says."""
        return self.leapt_ns is not None and t_ns - self.leapt_ns < _LASTING_NS


class _Pair:
    """The difference of two compasses."""

    def __init__(self) -> None:
        self.count = 0
        self.usual: Vector3 = (0.0, 0.0, 0.0)
        self.off: Vector3 = (0.0, 0.0, 0.0)
        """Recent deviation from the usual one."""
        self.t_ns = 0
        self.agreed_ns = 0

    @property
    def is_known(self) -> bool:
        """Whether the usual difference has been learnt."""
        return self.count >= _ENOUGH

    def add(self, t_ns: int, difference: Vector3, allowance: float) -> None:
        """Add a difference of now; learn from it while it is the usual one."""
        if self.is_known:
            gain = 1.0 - math.exp(-max(t_ns - self.t_ns, 0) * 1e-9 / _SMOOTH)
            d, u, o = difference, self.usual, self.off
            self.off = (
                o[0] + gain * (d[0] - u[0] - o[0]),
                o[1] + gain * (d[1] - u[1] - o[1]),
                o[2] + gain * (d[2] - u[2] - o[2]),
            )
        self.t_ns = t_ns
        if not self.is_known or math.hypot(*self.off) < 0.5 * LIMIT + allowance:
            self.agreed_ns = t_ns
        elif t_ns - self.agreed_ns > _LASTING_NS:
            self.count, self.off = 0, (0.0, 0.0, 0.0)
        else:
            return
        self.count += 1
        share = 1.0 / min(self.count, _MEMORY)
        u, d = self.usual, difference
        self.usual = (
            u[0] + share * (d[0] - u[0]),
            u[1] + share * (d[1] - u[1]),
            u[2] + share * (d[2] - u[2]),
        )


class Compasses:
    """Compares the fields of several compasses, and says which of them is used."""

    def __init__(self) -> None:
        self.used = 0
        """0: the first, whichever message carries it."""
        self._offset: Vector3 = (0.0, 0.0, 0.0)
        self._tracks: dict[int, _Track] = {}
        self._pairs: dict[tuple[int, int], _Pair] = {}
        self._rate: Vector3 = (0.0, 0.0, 0.0)

    def as_first(self, field: Vector3) -> Vector3:
        """Return the field of the compass in use as the first one would have measured it."""
        return (
            field[0] + self._offset[0],
            field[1] + self._offset[1],
            field[2] + self._offset[2],
        )

    def compare(
        self, compass: int, t_ns: int, field: Vector3, first: Vector3 | None, rate_b: Vector3 | None
    ) -> int:
        """Compare the field of another compass with the first's of now; return which one to use.

        Args:
            compass: Which other one: 1 or 2.
            t_ns: Its stamp.
            field: What it measures, gauss.
            first: What the first one has measured last, gauss; None: it is silent.
            rate_b: Of the gyro, rad/s; None: none came with it, so that the last one holds.
        """
        rate_b = self._rate if rate_b is None else rate_b
        track = self._tracks.get(0)
        if first is not None and (track is None or not 0 <= t_ns - track.t_ns < _STEP_NS):
            self._follow(0, t_ns, first, rate_b)
        self._follow(compass, t_ns, field, rate_b)
        self._rate = rate_b
        for other, track in self._tracks.items():
            if other != compass and t_ns - track.t_ns < _FRESH_NS:
                pair = self._pair(compass, other)
                low, high = sorted((compass, other))
                difference = _less(self._tracks[high], self._tracks[low])
                pair.add(t_ns, difference, _allowance(rate_b, field))
        return self._choose(t_ns, rate_b, field)

    def use(self, compass: int) -> None:
        """Use a compass from now on, with what it is known to differ by."""
        pair = self._pair(self.used, compass)
        if pair.is_known:
            sign = 1.0 if compass > self.used else -1.0
            usual, was = pair.usual, self._offset
            self._offset = (
                was[0] - sign * usual[0],
                was[1] - sign * usual[1],
                was[2] - sign * usual[2],
            )
        self.used = compass

    def is_silent(self, t_ns: int) -> bool:
        """Whether the compass in use, which is not the first, has been silent for 3 s."""
        track = self._tracks.get(self.used)
        return track is None or t_ns - track.t_ns > _SILENT_NS

    def _follow(self, compass: int, t_ns: int, field: Vector3, rate_b: Vector3) -> None:
        track = self._tracks.get(compass)
        if track is None:
            self._tracks[compass] = _Track(t_ns, field)
        else:
            r, was = rate_b, self._rate
            mean = (0.5 * (r[0] + was[0]), 0.5 * (r[1] + was[1]), 0.5 * (r[2] + was[2]))
            track.follow(t_ns, field, mean)

    def _choose(self, t_ns: int, rate_b: Vector3, field: Vector3) -> int:
        """Return the compass in use, or another where it is wrong."""
        used = self._tracks.get(self.used)
        if used is None:
            return self.used
        limit = LIMIT + _allowance(rate_b, field)
        against = [
            other
            for other in sorted(self._tracks, key=self._rank)
            if other != self.used
            and t_ns - self._tracks[other].t_ns < _FRESH_NS
            and not self._tracks[other].has_leapt(t_ns)
            and self._pair(self.used, other).is_known
            and math.hypot(*self._pair(self.used, other).off) > limit
        ]
        if not against:
            return self.used
        if used.has_leapt(t_ns):
            return against[0]
        if len(against) > 1:
            # it came about too slowly for the gyro: two that agree outvote it
            between = self._pair(against[0], against[1])
            if between.is_known and math.hypot(*between.off) < 0.5 * LIMIT:
                return against[0]
        return self.used

    def _rank(self, compass: int) -> tuple[bool, int]:
        """Return the order in which compasses are gone to: one that has never leapt before."""
        return self._tracks[compass].leapt_ns is not None, compass

    def _pair(self, one: int, other: int) -> _Pair:
        return self._pairs.setdefault((min(one, other), max(one, other)), _Pair())


def _less(one: _Track, other: _Track) -> Vector3:
    a, b = one.field, other.field
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _turned_back(v: Vector3, turn: Vector3) -> Vector3:
    """Return a vector that stands still, as a body sees it that has turned (rad)."""
    (x, y, z), (p, q, r) = v, turn
    cx, cy, cz = q * z - r * y, r * x - p * z, p * y - q * x
    # v - t x v + t x (t x v) / 2
    return (
        x - cx + 0.5 * (q * cz - r * cy),
        y - cy + 0.5 * (r * cx - p * cz),
        z - cz + 0.5 * (p * cy - q * cx),
    )


def _allowance(rate_b: Vector3, field: Vector3) -> float:
    """Return by how much fields may differ that were not measured at one time, gauss."""
    return math.hypot(*rate_b) * _LATENESS * math.hypot(*field)
