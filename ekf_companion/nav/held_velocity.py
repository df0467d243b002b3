"""Velocities of fixes that were not measured: a constant one while the positions move.

A receiver or a driver without a velocity sends 0, or repeats its last one. A measured velocity has
noise: it does not repeat to the bit while the vehicle moves. A single jump of the position, or a
vehicle at rest whose receiver holds its position, is no reason to refuse the velocity.

A slow receiver holds its course: the speed is measured, the direction is the last one. A velocity
of speed and course, as GPS_RAW_INT and ArduPilot's logs have it, then points anywhere.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ekf_companion.nav.earth import radii

FAR = 2.0
"""Distance, m, by which the positions must differ from what the velocity implies, at ``SPEED`` or
faster: more than the noise of a receiver in the open from one fix to the next."""
SIGMAS = 2.0
"""The same in sigmas of a fix, where that is more."""
SPEED = 1.0
"""m/s: the positions of a receiver at rest wander more slowly."""
STEPS = 3
"""Steps in a row, from fix to fix, all in one direction: a single one is a jump."""
LONGEST_S = 3.0
"""A longer step is a gap, in which the velocity may have been anything."""
ALWAYS_ZERO = "velocity always 0"
HELD = "velocity held"
REPEATED = "velocity repeated"
COURSE_HELD = "course held"
"""Why a velocity was not measured."""
SINGLE = (REPEATED, COURSE_HELD)
"""Those that say it of single fixes, and nothing of the receiver's settings."""
MOVING = 0.3
"""m/s: faster, a velocity with noise does not repeat to the bit for ``TWICE`` in a row. In cm/s a
single repetition is chance: 9 of 5015 fixes in three of 60 logs; two in a row came in none."""
TWICE = 2
SLOW = 2.55
"""m/s: faster, no receiver holds its course. u-blox M8 protocol, CFG-NAV5: staticHoldThresh is a
byte of cm/s; 657 of 2312 fixes of a copter's log had the course of the one before, up to 2.1 m/s.
A faster vehicle that flies straight may repeat its course by chance."""
SAME_COURSE = 1e-9
"""Sine of an angle that is none but for rounding."""


class _Place(NamedTuple):
    t_ns: int
    pos: tuple[float, ...]
    """North and east, or up, m, of anywhere near."""
    way: tuple[float, ...]
    """Displacement of the positions beyond what the velocity implies, m."""
    spent: float
    """Time in which it arose, s."""


class HeldVelocity:
    """Finds out that a receiver does not measure its velocity, or one part of it."""

    def __init__(self) -> None:
        """Begin without fixes."""
        self.number = 0
        """Of the velocity now, which may have been repeated."""
        self._vel: tuple[float, ...] = ()
        self._last: _Place | None = None
        self._steps = 0
        self._is_dead = False

    def judge(
        self, t_ns: int, pos: tuple[float, ...], vel: tuple[float, ...], std: float
    ) -> str | None:
        """Return why the velocity of a fix was not measured; None if it may have been.

        Args:
            t_ns: Stamp of the fix.
            pos: Position, m: horizontal, or up.
            vel: Velocity in the same order, m/s.
            std: One sigma of the position, m.
        """
        last = self._last
        if vel != self._vel:
            self._vel, self._is_dead, self._steps = vel, False, 0
            self.number += 1
            self._last = _Place(t_ns, pos, (0.0,) * len(pos), 0.0)
            return None
        assert last is not None, "a velocity was known before it repeats"
        if t_ns <= last.t_ns:
            return self._why()
        dt = (t_ns - last.t_ns) * 1e-9
        step = tuple(p - q - v * dt for p, q, v in zip(pos, last.pos, vel, strict=True))
        along = sum(s * w for s, w in zip(step, last.way, strict=True))
        is_begin = not any(last.way)
        if dt > LONGEST_S or not (is_begin or along > 0.0) or not any(step):
            way, spent, self._steps = (0.0,) * len(pos), 0.0, 0
        else:
            way = tuple(w + s for w, s in zip(last.way, step, strict=True))
            spent, self._steps = last.spent + dt, self._steps + 1
        self._last = _Place(t_ns, pos, way, spent)
        far = max(FAR, SIGMAS * std, SPEED * spent)
        self._is_dead |= self._steps >= STEPS and math.hypot(*way) > far
        return self._why()

    def _why(self) -> str | None:
        if not self._is_dead:
            return None
        return HELD if any(self._vel) else ALWAYS_ZERO


class HeldVelocities:
    """Judges the horizontal and the vertical velocity of one receiver's fixes, each by itself."""

    def __init__(self) -> None:
        """Begin without fixes."""
        self.horizontal, self.vertical = HeldVelocity(), HeldVelocity()
        self._scale: tuple[float, float] | None = None
        self._place = (math.nan, math.nan, math.nan)
        self._vel: tuple[float | None, ...] = (None,) * 3
        self._repeats = self._courses = 0

    def judge(
        self,
        t_ns: int,
        place: tuple[float, float, float],
        vel: tuple[float | None, float | None, float | None],
        std_h: float,
        std_v: float,
    ) -> tuple[str | None, str | None]:
        """Return why horizontal and vertical velocity of a fix were not measured, or None each.

        Args:
            t_ns: Stamp of the fix.
            place: Latitude, longitude (rad) and altitude (m).
            vel: North, east, down, m/s; None: not known.
            std_h: One sigma of the horizontal position per axis, m.
            std_v: One sigma of the altitude, m.
        """
        lat, lon, alt = place
        if self._scale is None:
            meridian, transverse = radii(lat)
            self._scale = float(meridian), float(transverse) * math.cos(lat)
        north, east, down = vel
        why_h = why_v = None
        if north is not None and east is not None:
            pos = lat * self._scale[0], lon * self._scale[1]
            why_h = self.horizontal.judge(t_ns, pos, (north, east), std_h)
        if down is not None:
            why_v = self.vertical.judge(t_ns, (alt,), (-down,), std_v)
        why = self._find_hold(place, vel)
        if why == REPEATED and down is not None and down == self._vel[2]:
            why_v = why_v or why
        self._place, self._vel = place, vel
        return why_h or why, why_v

    def _find_hold(
        self,
        place: tuple[float, float, float],
        vel: tuple[float | None, float | None, float | None],
    ) -> str | None:
        """Return whether a velocity of motion, or its course, is the last one to the bit.

        At a new position: a receiver repeats its last fix too. One that has only ever sent one
        velocity is judged by its positions instead.
        """
        (north, east, _), (last_north, last_east, _) = vel, self._vel
        if north is None or east is None or last_north is None or last_east is None:
            self._repeats = self._courses = 0
            return None
        speed, last = math.hypot(north, east), math.hypot(last_north, last_east)
        if vel[:2] == self._vel[:2]:
            if place == self._place:
                return None
            self._repeats += 1
            is_motion = self.horizontal.number > 1 and speed > MOVING
            return REPEATED if is_motion and self._repeats >= TWICE else None
        self._repeats = 0
        across = abs(north * last_east - east * last_north)
        along = north * last_north + east * last_east
        is_same = along > 0.0 and across <= SAME_COURSE * speed * last
        self._courses = self._courses + 1 if is_same else 0
        return COURSE_HELD if self._courses >= TWICE and MOVING < speed < SLOW else None
