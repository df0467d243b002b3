"""A fault: its kind, its time and its values; ``KIND[:start=20,duration=5,key=value,...]``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

import numpy as np

from ekf_companion.errors import ConfigError
from sim_autopilot import spec


class Layer(Enum):
    """Where a fault acts."""

    WIRE = "wire"
    SENSOR = "sensor"
    CLOCK = "clock"


@dataclass(frozen=True, slots=True)
class Number:
    """A value that is a number, with its bounds."""

    default: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Word:
    """A value that is one of some words; the first is the default."""

    words: tuple[str, ...]

    def __str__(self) -> str:
        """Return the words to choose from."""
        return "|".join(self.words)


Value = Number | Word
_NONE: Mapping[str, Value] = MappingProxyType({})
_SHARE = Number(0.2, 0.0, 1.0)
_WAY = Word(("both", "out", "in"))
"""out: from the autopilot to the companion."""
_METRES = Number(0.0, -1e6, 1e6)


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A kind of failure."""

    name: str
    layer: Layer
    summary: str
    values: Mapping[str, Value] = field(default_factory=lambda: _NONE)
    duration: float = 5.0
    """By default, s."""


KINDS = {
    kind.name: kind
    for kind in (
        FaultKind(
            "loss", Layer.WIRE, "a share of the frames is lost", {"share": _SHARE, "way": _WAY}
        ),
        FaultKind(
            "duplicate",
            Layer.WIRE,
            "a share of the frames comes twice",
            {"share": _SHARE, "way": _WAY},
        ),
        FaultKind(
            "reorder",
            Layer.WIRE,
            "a share of the frames is held back by `delay` seconds, and overtaken",
            {"share": _SHARE, "delay": Number(0.02, 0.0, 10.0), "way": _WAY},
        ),
        FaultKind(
            "jitter",
            Layer.WIRE,
            "each frame is late by up to `delay` seconds, in order",
            {"delay": Number(0.05, 0.0, 10.0), "way": _WAY},
        ),
        FaultKind(
            "corrupt",
            Layer.WIRE,
            "`bits` bits of a share of the frames are flipped",
            {"share": _SHARE, "bits": Number(3, 1, 1000), "way": _WAY},
        ),
        FaultKind("cut", Layer.WIRE, "nothing passes", {"way": _WAY}),
        FaultKind(
            "reboot",
            Layer.CLOCK,
            "the autopilot starts anew: silence, its clock from 0, requests forgotten",
        ),
        FaultKind(
            "clock-jump",
            Layer.CLOCK,
            "the autopilot's clock jumps by `by` seconds at the start, for good",
            {"by": Number(0.5, -1e6, 1e6)},
            1.0,
        ),
        FaultKind(
            "clock-skew",
            Layer.CLOCK,
            "the autopilot's clock runs `ppm` millionths fast; what is gained stays",
            {"ppm": Number(200.0, -1e5, 1e5)},
            20.0,
        ),
        FaultKind(
            "gnss-outage",
            Layer.SENSOR,
            "no fix: the receiver is silent, or says fix_type 0 with true coordinates (nofix)",
            {"how": Word(("silent", "nofix"))},
            10.0,
        ),
        FaultKind(
            "gnss-jump",
            Layer.SENSOR,
            "fixes are elsewhere at once, by metres",
            {"north": _METRES, "east": Number(50.0, -1e6, 1e6), "down": _METRES},
            10.0,
        ),
        FaultKind(
            "gnss-drag",
            Layer.SENSOR,
            "fixes are dragged off, m/s, towards a course in degrees; their velocity says so too",
            {"speed": Number(1.0, 0.0, 1e3), "course": Number(90.0, -360.0, 360.0)},
            30.0,
        ),
        FaultKind(
            "gnss-frozen",
            Layer.SENSOR,
            "the same fix again and again, its time going on or the same",
            {"time": Word(("advancing", "same"))},
            10.0,
        ),
        FaultKind(
            "imu-saturation",
            Layer.SENSOR,
            "gyro and accelerometer end at so many rad/s and m/s^2",
            {"gyro": Number(0.5, 0.0, 100.0), "accel": Number(11.0, 0.0, 1e3)},
            2.0,
        ),
        FaultKind(
            "imu-stuck", Layer.SENSOR, "the last inertial sample again and again", _NONE, 2.0
        ),
        FaultKind("imu-nan", Layer.SENSOR, "inertial samples are no numbers", _NONE, 2.0),
        FaultKind("imu-gap", Layer.SENSOR, "no inertial samples", _NONE, 2.0),
        FaultKind(
            "mag-disturbance",
            Layer.SENSOR,
            "a field is added, gauss in the body",
            {
                "forward": Number(0.3, -100.0, 100.0),
                "right": Number(0.0, -100.0, 100.0),
                "down": Number(0.0, -100.0, 100.0),
            },
            10.0,
        ),
        FaultKind(
            "baro-step",
            Layer.SENSOR,
            "the barometer reads `height` metres more",
            {"height": Number(20.0, -1e4, 1e4)},
            10.0,
        ),
    )
}
"""By name."""

VARIETY = (
    *KINDS,
    "gnss-outage:how=nofix",
    "gnss-frozen:time=same",
    "clock-jump:by=-0.5",
)
"""Every kind, and the variants that other code handles."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One failure, from ``start`` to ``end``."""

    kind: FaultKind
    start: float
    """Since the start of the flight, s."""
    duration: float
    """s."""
    values: Mapping[str, float | str]
    """All values of the kind."""

    @property
    def end(self) -> float:
        """Its end, since the start of the flight, s; it is over then."""
        return self.start + self.duration

    def number(self, key: str) -> float:
        """Return a value that is a number."""
        return float(self.values[key])

    def __str__(self) -> str:
        """Return it as ``parse`` reads it."""
        values = {"start": f"{self.start:g}", "duration": f"{self.duration:g}"}
        values |= {k: v if isinstance(v, str) else f"{v:g}" for k, v in self.values.items()}
        return f"{self.kind.name}:" + ",".join(f"{key}={value}" for key, value in values.items())


def parse(text: str, flight_duration: float = math.inf) -> Fault:
    """Read ``KIND[:key=value,...]``; every kind has ``start`` and ``duration``, in s.

    Raises:
        ConfigError: An unknown kind or key, an invalid value, or a start after the end of the
            flight.
    """
    name, texts = spec.split(text)
    kind = KINDS[spec.choose(text, "fault", name, KINDS)]
    known = {"start": Number(0.0, 0.0, 1e6), "duration": Number(kind.duration, 0.0, 1e6)}
    values: dict[str, float | str] = {
        key: value.default if isinstance(value, Number) else value.words[0]
        for key, value in {**known, **kind.values}.items()
    }
    for key, value in texts.items():
        spec.choose(text, f"value of {name}", key, values)
        rule = {**known, **kind.values}[key]
        if isinstance(rule, Number):
            values[key] = spec.number(text, key, value, rule.low, rule.high)
        else:
            values[key] = spec.choose(text, f"value of {key}", value, rule.words)
    start, duration = float(values.pop("start")), float(values.pop("duration"))
    if start >= flight_duration:
        raise ConfigError(
            f"{text}: starts at {start:g} s, but the flight ends at "
            f"{flight_duration:g} s; start earlier or fly longer"
        )
    return Fault(kind, start, duration, MappingProxyType(values))


def schedule(
    kinds: Iterable[str], seed: int, duration: float, gap: float, *, first: float = 30.0
) -> list[Fault]:
    """Schedule faults in random order with quiet time between them, round after round.

    Args:
        kinds: Names, or names with values, as ``parse`` reads them, without ``start``.
        seed: Of the order.
        duration: Of the flight, s: the last fault and its gap end before.
        gap: Quiet time between two faults, s.
        first: Quiet time before the first, s.

    Raises:
        ConfigError: A kind cannot be read, or not all of them fit into the duration.
    """
    texts = list(kinds)
    needed = first + sum(parse(text).duration + gap for text in texts)
    if needed > duration:
        raise ConfigError(
            f"{len(texts)} faults need {needed:g} s with {gap:g} s of quiet between them, but the "
            f"flight has {duration:g} s; fly longer or choose fewer"
        )
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(200,)))
    found: list[Fault] = []
    at = first
    while texts:
        for index in rng.permutation(len(texts)).tolist():
            fault = _at(texts[index], at)
            if fault.end + gap > duration:
                return found
            found.append(fault)
            at = fault.end + gap
    return found


def of_layer(faults: Sequence[Fault], layer: Layer) -> list[tuple[int, Fault]]:
    """Return the faults of a layer, each with its index among all, which seeds its chance."""
    return [(place, fault) for place, fault in enumerate(faults) if fault.kind.layer is layer]


def _at(text: str, start: float) -> Fault:
    joint = "," if ":" in text else ":"
    return parse(f"{text}{joint}start={start!r}")
