"""Sources beside the usual sensors: right, and each with its faults, with and without a receiver.

A fault lasts for about 40 s beside the receiver; in a case that ends in ``outage`` for about 30 s
of about 60 s without a fix. A setting that is wrong is so throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.truth import paths, sources
from benchmarks.truth.cases.case import Case, during, flown, lose
from benchmarks.truth.draw import DEG, Draw
from benchmarks.truth.earth import Array
from benchmarks.truth.sensors import Readings, Source
from benchmarks.truth.sources import Mask

Fault = Callable[[Draw, Readings, Source, Mask], None]


@dataclass(frozen=True, slots=True)
class Kind:
    """A source: a flight with it, what it is, and its faults with a sentence each."""

    fly: Callable[[Draw], tuple[Readings, Source]]
    words: str
    faults: Mapping[str, tuple[str, Fault]]


# What any source may do


def late(by: float) -> Fault:
    """Let readings come late, with the stamp of their arrival, s."""

    def fault(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
        delay = draw.about(by)
        source.t[rows] += delay
        source.stamp[rows] += delay

    return fault


def jitter(std: float) -> Fault:
    """Let the stamps jitter, s."""

    def fault(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
        source.stamp[rows] += draw.about(std) * draw.rng.standard_normal(rows.sum())

    return fault


def burst(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    """Let readings come together, eight at a time, with their own stamps."""
    index = np.flatnonzero(rows)
    for first in range(0, len(index), 8):
        together = index[first : first + 8]
        source.t[together] = source.t[together[-1]]


def frozen(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    """Repeat the first reading."""
    source.values[rows] = source.values[np.argmax(rows)]


def times(factor: float, *columns: int) -> Fault:
    """Multiply columns by about a factor."""

    def fault(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
        for column in columns:
            source.values[rows, column] *= 1.0 + draw.about(factor - 1.0)

    return fault


def plus(step: float, rate: float = 0.0) -> Fault:
    """Add about a step, and about a rate (1/s) of either sign, to the first column."""

    def fault(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
        since = source.t[rows] - source.t[np.argmax(rows)]
        source.values[rows, 0] += draw.about(step) + draw.about(rate) * draw.sign() * since

    return fault


# Anchors


def _anchored(draw: Draw) -> tuple[Readings, Source]:
    readings = flown(draw, paths.figure_eights(draw), 125.0)
    return readings, sources.anchors(readings, draw)


def _anchors_off(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    sources.place(readings, sources.ANCHORS_T + draw.about(5.0) * draw.level())


def _anchors_turned(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    angle = draw.about(5.0 * DEG) * draw.sign()
    sources.place(readings, sources.turned(angle, sources.ANCHORS_T))


def _anchor_misplaced(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    places_t = sources.ANCHORS_T.copy()
    places_t[draw.rng.integers(len(places_t))] += draw.about(3.0) * draw.level()
    sources.place(readings, places_t)


def _anchors_hidden(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[rows & (source.values[:, 1] % 2 == 0), 0] += draw.about(2.0)


# Flow and range


def _low(draw: Draw) -> Readings:
    return flown(draw, paths.figure_eights(draw, least=4.0, most=15.0), 125.0)


def _with_flow(draw: Draw) -> tuple[Readings, Source]:
    readings = _low(draw)
    sources.range_finder(readings, draw)
    return readings, sources.optical_flow(readings, draw)


def flow_scaled(by: float) -> Fault:
    """Multiply what the way adds to the flow, which its gyro does not see."""

    def fault(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
        flow, gyro = source.values[rows, :2], source.values[rows, 2:4]
        source.values[rows, :2] = gyro + (1.0 + draw.about(by - 1.0)) * (flow - gyro)

    return fault


def _flow_reversed(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[rows, :2] *= -1.0


def _flow_turned(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[rows, :2] = source.values[rows, 1::-1] * [-1.0, 1.0]


def _flow_over_water(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[rows, :2] += draw.about(0.1) * draw.level()[:2]


def _ranged(draw: Draw) -> tuple[Readings, Source]:
    readings = _low(draw)
    return readings, sources.range_finder(readings, draw)


def _bounce(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[rows, 0] = draw.rng.uniform(0.3, 39.0, rows.sum())


# Airspeed and wheels


def _winged(draw: Draw) -> tuple[Readings, Source]:
    wind = draw.about(4.0) * draw.level()
    readings = flown(draw, paths.circuits(draw, wind_t=wind), 125.0)
    return readings, sources.airspeed(readings, draw, wind)


def _blocked(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    noise = 0.05 * draw.rng.standard_normal(rows.sum())
    source.values[rows, 0] = source.values[np.argmax(rows), 0] + noise


def _rolling(draw: Draw) -> tuple[Readings, Source]:
    readings = flown(draw, paths.car(draw), 125.0)
    return readings, sources.wheels(readings, draw)


# Poses and velocities of another estimator


def _seeing(draw: Draw) -> tuple[Readings, Source]:
    readings = flown(draw, paths.figure_eights(draw), 125.0)
    return readings, sources.visual_odometry(readings, draw)


def since_first(source: Source, rows: Mask) -> tuple[Array, Array]:
    """Return time and way since the first of some poses, s and m."""
    first = np.argmax(rows)
    return source.t[rows] - source.t[first], source.values[rows, :3] - source.values[first, :3]


def _pose_drift(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    since, _ = since_first(source, rows)
    source.values[rows, :3] += np.outer(since, draw.about(0.5) * draw.level())


def _pose_scale(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[rows, :3] += draw.about(0.2) * since_first(source, rows)[1]


def _pose_turned(source: Source, rows: Mask, angle: Array) -> None:
    way = since_first(source, rows)[1]
    source.values[rows, :3] += sources.turned(angle, way) - way
    heading = source.values[rows, 3] + angle
    source.values[rows, 3] = np.arctan2(np.sin(heading), np.cos(heading))


def _pose_leap(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    _pose_turned(source, rows, np.full(rows.sum(), draw.about(40.0 * DEG) * draw.sign()))
    source.values[rows, :3] += draw.about(3.0) * draw.level()


def _pose_slip(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    since, _ = since_first(source, rows)
    _pose_turned(source, rows, draw.about(2.0 * DEG) * draw.sign() * since)


def _pose_east_first(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[:, :3] = source.values[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    heading = np.pi / 2.0 - source.values[:, 3]
    source.values[:, 3] = np.arctan2(np.sin(heading), np.cos(heading))


def _sensing_velocity(draw: Draw) -> tuple[Readings, Source]:
    readings = flown(draw, paths.figure_eights(draw), 125.0)
    return readings, sources.visual_velocity(readings, draw)


def _velocity_off(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    source.values[rows] += draw.about(0.5) * draw.level()


def _velocity_turned(draw: Draw, readings: Readings, source: Source, rows: Mask) -> None:
    angle = draw.about(30.0 * DEG) * draw.sign()
    source.values[rows] = sources.turned(angle, source.values[rows])


KINDS = {
    "anchors": Kind(
        _anchored,
        "Ranges to eight anchors",
        {
            "frame-off": ("the anchors are all said to be about 5 m off to one side", _anchors_off),
            "frame-turned": (
                "they are said to be about 5 deg further round the start",
                _anchors_turned,
            ),
            "misplaced": ("one is said to be about 3 m off", _anchor_misplaced),
            "hidden": ("every second one has ranges about 2 m too long", _anchors_hidden),
            "scale": ("they are about 2 % too long", times(1.02, 0)),
            "drift": ("all get longer or shorter by about 0.1 m/s", plus(0.0, 0.1)),
            "late": ("they come about 1 s late, with the stamp of their arrival", late(1.0)),
            "frozen": ("one range again and again", frozen),
            "jitter": ("stamps that jitter by about 50 ms", jitter(0.05)),
        },
    ),
    "flow": Kind(
        _with_flow,
        "Optical flow and range finder",
        {
            "water": ("the ground moves by about 0.1 rad/s", _flow_over_water),
            "scale": ("it is about 1.4 times as fast", flow_scaled(1.4)),
            "reversed": ("it has the wrong sign", _flow_reversed),
            "turned": ("its axes are turned by 90 deg", _flow_turned),
            "late": ("it comes about 0.3 s late, with the stamp of its arrival", late(0.3)),
            "frozen": ("the same again and again", frozen),
        },
    ),
    "range": Kind(
        _ranged,
        "A range finder over nearly level ground",
        {
            "roof": ("the ground is about 5 m higher", plus(-5.0)),
            "sinking": ("the ground rises or sinks by about 0.3 m/s", plus(0.0, 0.3)),
            "scale": ("it reads about 10 % too much", times(1.1, 0)),
            "bounce": ("it reads anything", _bounce),
            "frozen": ("the same again and again", frozen),
        },
    ),
    "airspeed": Kind(
        _winged,
        "A fixed wing's airspeed",
        {
            "blocked": ("the tube is shut at the pressure of the moment", _blocked),
            "scale": ("it reads about 20 % too little", times(0.8, 0)),
            "slide": ("it reads more or less by about 0.2 m/s each second", plus(0.0, 0.2)),
            "late": ("it comes about 1 s late, with the stamp of its arrival", late(1.0)),
            "frozen": ("the same again and again", frozen),
        },
    ),
    "wheels": Kind(
        _rolling,
        "A car's wheels",
        {
            "spin": ("they turn about 3 m/s too fast", plus(3.0)),
            "scale": ("they turn about 10 % too fast", times(1.1, 0)),
            "late": ("they come about 0.5 s late, with the stamp of their arrival", late(0.5)),
            "frozen": ("the same again and again", frozen),
        },
    ),
    "poses": Kind(
        _seeing,
        "Poses of visual odometry",
        {
            "drift": ("they drift off by about 0.5 m/s", _pose_drift),
            "scale": ("they become about 1.2 times as large", _pose_scale),
            "leap": ("they leap by about 3 m and 40 deg, and do not say so", _pose_leap),
            "slip": ("their frame turns by about 2 deg/s", _pose_slip),
            "east-first": ("east, north, up is called north, east, down", _pose_east_first),
            "late": ("they come about 0.3 s late, with the stamp of their arrival", late(0.3)),
            "frozen": ("the same again and again", frozen),
            "jitter": ("stamps that jitter by about 20 ms", jitter(0.02)),
            "burst": ("eight come together, with their own stamps", burst),
        },
    ),
    "velocities": Kind(
        _sensing_velocity,
        "Velocities of visual odometry",
        {
            "off": ("they are off by about 0.5 m/s to one side of the body", _velocity_off),
            "scale": ("they are about 1.3 times as fast", times(1.3, 0, 1, 2)),
            "turned": ("their axes are about 30 deg off", _velocity_turned),
            "late": ("they come about 0.3 s late, with the stamp of their arrival", late(0.3)),
            "frozen": ("the same again and again", frozen),
        },
    ),
}


def _case(kind: Kind, words: str, fault: Fault | None, *, is_outage: bool) -> Case:
    def case(draw: Draw) -> Readings:
        readings, source = kind.fly(draw)
        begin, length = draw.about(45.0, 0.1), draw.about(40.0, 0.1)
        if is_outage:
            lose(readings, begin, draw.about(60.0, 0.1))
            begin, length = begin + draw.about(15.0), draw.about(30.0)
        if fault is not None:
            fault(draw, readings, source, during(source.t, begin, length))
        return readings

    case.__doc__ = words
    return case


CASES: dict[str, Case] = {}
for name, kind in KINDS.items():
    words = f"{kind.words}; nothing wrong, and no fix for about 60 s."
    CASES[name] = _case(kind, words, None, is_outage=True)
    for fault_name, (what, fault) in kind.faults.items():
        for is_outage in (False, True):
            words = f"{kind.words}; {what}{', without a fix' * is_outage}."
            full = f"{name}-{fault_name}{'-outage' * is_outage}"
            CASES[full] = _case(kind, words, fault, is_outage=is_outage)
