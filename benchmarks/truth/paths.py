"""The motions that the cases fly."""

from __future__ import annotations

import numpy as np

from benchmarks.truth.draw import DEG, TURN, Draw, integrated, ramp, ramped, still
from benchmarks.truth.earth import Array
from benchmarks.truth.motion import Function, Motion, aeroplane, from_euler, multirotor, posed


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


def figure_eights(
    draw: Draw, period: float = 22.0, begin: float = 6.0, *, least: float = 0.0, most: float = 40.0
) -> Motion:
    """Return a multirotor's figure-eights of 70 m by 36 m with climbs; at rest until they begin.

    ``least`` and ``most`` are how high it flies, m.
    """
    way, phase = draw.angle(), draw.rng.uniform(0.0, TURN) if begin < 0.0 else 0.0

    def pos_t(t: Array) -> Array:
        angle = TURN / period * ramped(t, begin, 4.0) + phase
        climb = -0.5 * (most - least) * (1.0 - np.cos(angle / 3.0)) - least * ramp(t, begin, 6.0)
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
        wave = size[i] * np.sin(TURN * rate * t + phase[i])
        return np.asarray(wave * (1.0 - ramp(t, leave - 2.0, 4.0)))

    def pos_t(t: Array) -> Array:
        deck = turned(yaw, rock(4, 0.12, t), 0.0 * t, rock(3, 0.2, t))
        return np.asarray(deck + flight.pos_t(t))

    def attitude(t: Array, vel: Array, acc: Array) -> Array:
        aloft = acc * ramp(t, leave, 2.0)[:, None]
        flown = multirotor(lambda t: yaw + rock(2, 0.03, t) * DEG)(t, vel, aloft)
        return flown @ from_euler(rock(0, 0.15, t) * DEG, rock(1, 0.2, t) * DEG, np.zeros_like(t))

    return Motion(pos_t, attitude)


def along(draw: Draw, turn: Function, speed: Function, climb: Function | None = None) -> Function:
    """Return the path of a rate of turning (rad/s) and a speed from a drawn course on.

    Args:
        draw: The seed's draws.
        turn: Rate of the course, rad/s.
        speed: Over ground, m/s.
        climb: Down from the start, m; None: level.
    """
    first = draw.angle()

    def pos_t(t: Array) -> Array:
        def vel_t(fine: Array) -> Array:
            course = first + integrated(fine, turn)
            return np.stack([speed(fine) * np.cos(course), speed(fine) * np.sin(course)], axis=1)

        down = np.zeros_like(t) if climb is None else climb(t)
        return np.column_stack([integrated(t, vel_t), down])

    return pos_t


def straight_then_turns(draw: Draw, turns_at: float, speed: float = 20.0) -> Motion:
    """Return level flight, straight at first and S-turns later; in the air from the start."""
    size, period = draw.about(24.0 * DEG), draw.about(16.0)

    def turn(t: Array) -> Array:
        bank = size * ramp(t, turns_at, 4.0) * np.sin(TURN * (t - turns_at) / period)
        return np.asarray(9.81 / speed * np.tan(bank))

    return Motion(along(draw, turn, still(speed)), aeroplane(np.zeros(3)))


def circuits(
    draw: Draw, gust: float = 0.2, speed: float = 25.0, wind_t: Array | None = None
) -> Motion:
    """Return an aeroplane's circuits: legs of 10 s, turns of 1.34 g, gusts along all axes."""
    rate = 9.81 / speed * np.tan(42.0 * DEG)
    leg = draw.about(10.0, 0.2)
    lap = leg + np.pi / rate + 2.0
    side = draw.sign()
    push = [draw.wander(size, 8.0, 2.5) for size in (0.5 * gust, 0.5 * gust, gust)]

    def turn(t: Array) -> Array:
        phase = np.mod(t, lap)
        return np.asarray(side * rate * (ramp(phase, leg, 2.0) - ramp(phase, lap - 2.0, 2.0)))

    smooth = along(draw, turn, still(speed), lambda t: -10.0 * (1.0 - np.cos(TURN * t / 40.0)))
    return Motion(
        lambda t: smooth(t) + np.stack([p(t) for p in push], axis=1),
        aeroplane(draw.about(3.0) * draw.level() if wind_t is None else wind_t),
    )


def fast_and_straight(draw: Draw) -> Motion:
    """Return a take-off, turns at 12 m/s, then straight on at 25 m/s from 30 s."""
    size = draw.about(0.35) * draw.sign()

    def turn(t: Array) -> Array:
        wave = size * np.sin(TURN * (t - 10.0) / 9.0)
        return np.asarray(wave * (ramp(t, 10.0, 3.0) - ramp(t, 26.0, 3.0)))

    def speed(t: Array) -> Array:
        return 12.0 * ramp(t, 8.0, 8.0) + 13.0 * ramp(t, 26.0, 8.0)

    way = along(draw, turn, speed, lambda t: -20.0 * ramp(t, 6.0, 10.0))
    return Motion(way, multirotor(swing(draw, 8.0, 20.0 * DEG)))


def steady_and_stopping(draw: Draw) -> Motion:
    """Return a take-off, a minute of level flight at 15 m/s, a stop, and stops and starts."""

    def speed(t: Array) -> Array:
        steady = ramp(t, 16.0, 6.0) - ramp(t, 80.0, 5.0)
        again = (0.5 - 0.5 * np.cos(TURN * (t - 95.0) / 16.0)) * (t > 95.0)
        return np.asarray(15.0 * (steady + again))

    def turn(t: Array) -> Array:
        return 0.1 * ramp(t, 20.0, 4.0) * np.sin(TURN * t / 20.0)

    way = along(draw, turn, speed, lambda t: -20.0 * ramp(t, 6.0, 10.0))
    return Motion(way, multirotor(swing(draw, 8.0, 20.0 * DEG)))


def aerobatics(draw: Draw, speed: float = 25.0) -> Motion:
    """Return a loop or a full roll in turn, every 16 s from 15 s on, and a turn after each."""
    way, side = draw.angle(), draw.sign()
    starts = np.arange(15.0, 400.0, 16.0)

    def summed(angle: float, starts: Array, length: float, t: Array) -> Array:
        return np.asarray(sum(angle * ramp(t, start, length) for start in starts))

    def vel_t(t: Array) -> Array:
        pitch = summed(TURN, starts[::2], 9.4, t)
        course = way + summed(side * np.pi, starts + 10.0, 5.0, t)
        north, east = np.cos(pitch) * np.cos(course), np.cos(pitch) * np.sin(course)
        return speed * np.stack([north, east, -np.sin(pitch)], axis=1)

    return Motion(
        lambda t: integrated(t, vel_t),
        aeroplane(np.zeros(3), lambda t: summed(side * TURN, starts[1::2], 3.0, t)),
    )


def car(draw: Draw, gain: float = 11.0, within: float = 8.0) -> Motion:
    """Return a car that stands for 10 s, speeds up straight ahead, and takes bends from 40 s on."""
    first, bend = draw.angle(), draw.about(12.0)
    rough = [draw.wander(0.3 * DEG, 4.0, 0.5) for _ in range(2)]

    def course(t: Array) -> Array:
        return first + integrated(
            t, lambda t: 0.25 * ramp(t, 40.0, 4.0) * np.sin(TURN * (t - 40.0) / bend)
        )

    def vel_t(t: Array) -> Array:
        speed, ahead = gain * ramp(t, 10.0, within), course(t)
        return np.stack([speed * np.cos(ahead), speed * np.sin(ahead), np.zeros_like(t)], axis=1)

    def attitude(t: Array, vel: Array, acc: Array) -> Array:
        moving = ramp(t, 10.0, within)
        return from_euler(rough[0](t) * moving, rough[1](t) * moving, course(t))

    return Motion(lambda t: integrated(t, vel_t), attitude)
