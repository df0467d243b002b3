"""The motions that the cases fly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.truth.earth import Array
from benchmarks.truth.motion import Motion, aeroplane, from_euler, multirotor, posed

Function = Callable[[Array], Array]
DEG = np.pi / 180.0
TURN = 2.0 * np.pi


class Draw:
    """What differs from seed to seed."""

    def __init__(self, seed: int, name: str) -> None:
        self.rng = np.random.default_rng([seed, *name.encode()])

    def about(self, value: float, share: float = 0.3) -> float:
        """Draw around a value, within a share of it."""
        return value * self.rng.uniform(1.0 - share, 1.0 + share)

    def sign(self) -> float:
        """Draw -1 or 1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def angle(self) -> float:
        """Draw any angle."""
        return float(self.rng.uniform(-np.pi, np.pi))

    def level(self) -> Array:
        """Draw a horizontal unit vector."""
        angle = self.angle()
        return np.array([np.cos(angle), np.sin(angle), 0.0])

    def unit(self) -> Array:
        """Draw a unit vector."""
        v = self.rng.standard_normal(3)
        return np.asarray(v / np.linalg.norm(v))

    def wander(self, std: float, slowest: float, fastest: float) -> Function:
        """Draw a smooth wandering function of one sigma, its periods between two, s."""
        waves = 12
        rate = TURN / np.exp(self.rng.uniform(np.log(fastest), np.log(slowest), waves))
        phase = self.rng.uniform(0.0, TURN, waves)
        share = std * np.sqrt(2.0 / waves)
        return lambda t: share * np.sin(np.multiply.outer(t, rate) + phase).sum(axis=-1)


def ramp(t: Array, begin: float, length: float) -> Array:
    """Rise from 0 to 1 with two continuous derivatives."""
    x = np.clip((t - begin) / length, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


def ramped(t: Array, begin: float, length: float) -> Array:
    """Return the integral of `ramp`: time that begins to run softly."""
    x = np.clip((t - begin) / length, 0.0, 1.0)
    return np.asarray(
        length * (2.5 * x**4 - 3.0 * x**5 + x**6) + np.maximum(t - begin - length, 0.0)
    )


def turned(angle: float, north: Array, east: Array, down: Array) -> Array:
    """Stack a path's components and turn it about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack(np.broadcast_arrays(c * north - s * east, s * north + c * east, down), axis=1)


def swing(
    draw: Draw, begin: float = -10.0, by: float = 46.0 * DEG, period: float = 45.0
) -> Function:
    """Return a yaw that swings about a drawn one, from a moment on."""
    middle, phase = draw.angle(), draw.angle()
    return lambda t: middle + by * ramp(t, begin, 8.0) * np.sin(TURN * t / period + phase)


def still(value: float) -> Function:
    """Return a constant function of time."""
    return lambda t: np.full_like(t, value)


def figure_eights(draw: Draw, period: float = 22.0, begin: float = 6.0) -> Motion:
    """Return a multirotor's figure-eights of 70 m by 36 m with climbs; at rest until they begin."""
    way, phase = draw.angle(), draw.rng.uniform(0.0, TURN) if begin < 0.0 else 0.0

    def pos_t(t: Array) -> Array:
        angle = TURN / period * ramped(t, begin, 4.0) + phase
        climb = -20.0 * (1.0 - np.cos(angle / 3.0))
        return turned(way, 35.0 * np.sin(angle), 18.0 * np.sin(2.0 * angle), climb)

    return Motion(pos_t, multirotor(swing(draw, begin)))


def hover(draw: Draw, gust: float = 0.6) -> Motion:
    """Return 6 s at rest, a climb of 15 m and a hover pushed about by gusts."""
    push = [draw.wander(gust, 20.0, 3.0) for _ in range(2)] + [draw.wander(0.3, 20.0, 4.0)]

    def pos_t(t: Array) -> Array:
        aloft = ramp(t, 7.0, 6.0)[:, None]
        gusts = np.stack([p(t) for p in push], axis=1)
        return np.asarray(aloft * (gusts - np.array([0.0, 0.0, 15.0])))

    return Motion(pos_t, multirotor(swing(draw, 8.0, 15.0 * DEG, 25.0)))


def resting(draw: Draw, yaw: Function | None = None, drift: Function | None = None) -> Motion:
    """Return a vehicle that stands nearly level; perhaps it turns, or drifts along a function."""
    roll, pitch = draw.rng.normal(0.0, 1.5 * DEG, 2)
    middle = draw.angle()
    turn = yaw or still(0.0)
    way = drift or (lambda t: np.zeros((len(t), 3)))
    return Motion(way, posed(still(roll), still(pitch), lambda t: middle + turn(t)))


def boat(draw: Draw) -> Motion:
    """Return 40 s on a rocking deck, then take-off and figure-eights."""
    flight, phase, leave = figure_eights(draw, begin=40.0), draw.rng.uniform(0, TURN, 5), 40.0
    yaw, size = draw.angle(), [draw.about(x) for x in (3.0, 1.8, 3.0, 0.15, 0.3)]

    def rock(i: int, rate: float, t: Array) -> Array:
        return size[i] * np.sin(TURN * rate * t + phase[i]) * (1.0 - ramp(t, leave - 2.0, 4.0))

    def pos_t(t: Array) -> Array:
        deck = turned(yaw, rock(4, 0.12, t), 0.0 * t, rock(3, 0.2, t))
        return np.asarray(deck + flight.pos_t(t))

    def attitude(t: Array, vel: Array, acc: Array) -> Array:
        flown = multirotor(lambda t: yaw + rock(2, 0.03, t) * DEG)(
            t, vel, acc * ramp(t, leave, 2.0)[:, None]
        )
        zero = np.zeros_like(t)
        return flown @ posed(
            lambda t: rock(0, 0.15, t) * DEG, lambda t: rock(1, 0.2, t) * DEG, still(0.0)
        )(t, zero, zero)

    return Motion(pos_t, attitude)


def along(draw: Draw, rate: Function, speed: Function, climb: Function | None = None) -> Function:
    """Return the path of a course rate (rad/s) and a speed from a drawn course, level or not."""
    course0 = draw.angle()

    def pos_t(t: Array) -> Array:
        dt = 1.0 / 400.0
        fine = np.arange(t[0], t[-1] + dt, dt)
        course = course0 + _integral(rate(fine), dt)
        v = speed(fine)
        north, east = _integral(v * np.cos(course), dt), _integral(v * np.sin(course), dt)
        down = np.zeros_like(fine) if climb is None else climb(fine)
        return np.stack([np.interp(t, fine, x) for x in (north, east, down)], axis=1)

    return pos_t


def _integral(rate: Array, dt: float) -> Array:
    return np.concatenate([[0.0], np.cumsum(rate[1:] + rate[:-1]) * 0.5 * dt])


def straight_then_turns(draw: Draw, turns_at: float, speed: float = 20.0) -> Motion:
    """Return level flight, straight at first and S-turns later; in the air from the start."""
    size, period = draw.about(24.0 * DEG), draw.about(16.0)
    bank = lambda t: size * ramp(t, turns_at, 4.0) * np.sin(TURN * (t - turns_at) / period)  # noqa: E731
    way = along(draw, lambda t: 9.81 / speed * np.tan(bank(t)), still(speed))
    return Motion(way, aeroplane(np.zeros(3)))


def circuits(
    draw: Draw, gust: float = 0.2, speed: float = 25.0, bank: float = 42.0 * DEG
) -> Motion:
    """Return an aeroplane's circuits: legs of 10 s, turns of 180 degrees, gusts along all axes."""
    rate = 9.81 / speed * np.tan(bank)
    leg = draw.about(10.0, 0.2)
    lap = leg + np.pi / rate + 2.0
    side = draw.sign()
    push = [draw.wander(gust, 8.0, 2.5) for _ in range(3)]

    def turn(t: Array) -> Array:
        phase = np.mod(t, lap)
        return side * rate * (ramp(phase, leg, 2.0) - ramp(phase, lap - 2.0, 2.0))

    level = along(draw, turn, still(speed), lambda t: -10.0 * (1.0 - np.cos(TURN * t / 40.0)))
    return Motion(
        lambda t: level(t) + np.stack([p(t) for p in push], axis=1) * [0.5, 0.5, 1.0],
        aeroplane(draw.about(3.0) * draw.level()),
    )


def fast_and_straight(draw: Draw) -> Motion:
    """Return a take-off, turns at 12 m/s, then straight on at 25 m/s from 30 s."""
    speed = lambda t: 12.0 * ramp(t, 8.0, 8.0) + 13.0 * ramp(t, 26.0, 8.0)  # noqa: E731
    size = draw.about(0.35) * draw.sign()
    rate = lambda t: (
        size * np.sin(TURN * (t - 10.0) / 9.0) * (ramp(t, 10.0, 3.0) - ramp(t, 26.0, 3.0))
    )  # noqa: E731
    way = along(draw, rate, speed, lambda t: -20.0 * ramp(t, 6.0, 10.0))
    return Motion(way, multirotor(swing(draw, 8.0, 20.0 * DEG)))


def aerobatics(draw: Draw, speed: float = 25.0, radius: float = 25.0) -> Motion:
    """Return straight legs with a loop or a full roll in turn, every 12 s from 15 s on.

    The loop's path has its rate of turning rise and fall smoothly within each figure.
    """
    way, side, loop = draw.angle(), draw.sign(), TURN * radius / speed
    starts = np.arange(15.0, 400.0, 12.0)

    def pos_t(t: Array) -> Array:
        dt = 1.0 / 400.0
        fine = np.arange(t[0], t[-1] + dt, dt)
        pitch = sum((TURN * ramp(fine, s, 1.5 * loop) for s in starts[::2]), np.zeros_like(fine))
        course = sum(
            (np.pi * ramp(fine, s + 8.0, 4.0) * side for s in starts), np.full_like(fine, way)
        )
        parts = (np.cos(pitch) * np.cos(course), np.cos(pitch) * np.sin(course), -np.sin(pitch))
        return np.stack([np.interp(t, fine, _integral(speed * x, dt)) for x in parts], axis=1)

    def attitude(t: Array, vel: Array, acc: Array) -> Array:
        roll = sum((TURN * side * ramp(t, s, 3.0) for s in starts[1::2]), np.zeros_like(t))
        return aeroplane(np.zeros(3), lambda _: roll)(t, vel, acc)

    return Motion(pos_t, attitude)


def car(draw: Draw, gain: float = 11.0, within: float = 8.0) -> Motion:
    """Return a car that stands for 10 s, speeds up straight ahead, and takes bends from 40 s on."""
    start, bend = draw.angle(), draw.about(12.0)
    turn = lambda t: 0.25 * ramp(t, 40.0, 4.0) * np.sin(TURN * (t - 40.0) / bend)  # noqa: E731
    rough = [draw.wander(0.3 * DEG, 4.0, 0.5) for _ in range(2)]

    def course(t: Array) -> Array:
        fine = np.arange(-1.0, t[-1] + 0.0025, 0.0025)
        return np.asarray(start + np.interp(t, fine, _integral(turn(fine), 0.0025)))

    def pos_t(t: Array) -> Array:
        fine = np.arange(t[0], t[-1] + 0.0025, 0.0025)
        v = gain * np.clip(ramp(fine, 10.0, within), 0.0, 1.0)
        parts = (v * np.cos(course(fine)), v * np.sin(course(fine)), 0.0 * v)
        return np.stack([np.interp(t, fine, _integral(x, 0.0025)) for x in parts], axis=1)

    def attitude(t: Array, vel: Array, acc: Array) -> Array:
        moving = ramp(t, 10.0, within)
        return from_euler(rough[0](t) * moving, rough[1](t) * moving, course(t))

    return Motion(pos_t, attitude)
