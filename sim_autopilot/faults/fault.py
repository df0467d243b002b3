"""A fault: its kind, its time and its values; ``KIND[:start=20,duration=5,key=value,...]``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

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
_SHARE = Number(0.2, 0.0, 1.0)
_WAY = Word(("both", "out", "in"))
"""out: from the autopilot to the companion."""
_METRES = Number(0.0, -1e6, 1e6)
_ANGLE = Number(0.0, -180.0, 180.0)
_GAUSS = Number(0.0, -100.0, 100.0)
_DELAY = Number(0.5, 0.0, 10.0)


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A kind of failure."""

    name: str
    summary: str
    duration: float
    """By default, s."""
    values: Mapping[str, Value]
    layer: Layer


_Kinds = dict[str, tuple[str, float, dict[str, Value]]]
"""By name: summary, duration and values."""

_WIRE: _Kinds = {
    "loss": ("a share of the frames is lost", 5.0, {"share": _SHARE, "way": _WAY}),
    "duplicate": ("a share of the frames comes twice", 5.0, {"share": _SHARE, "way": _WAY}),
    "reorder": (
        "a share of the frames is held back by `delay` seconds, and overtaken",
        5.0,
        {"share": _SHARE, "delay": Number(0.02, 0.0, 10.0), "way": _WAY},
    ),
    "jitter": (
        "each frame is late by up to `delay` seconds, in order",
        5.0,
        {"delay": Number(0.05, 0.0, 10.0), "way": _WAY},
    ),
    "corrupt": (
        "`bits` bits of a share of the frames are flipped",
        5.0,
        {"share": _SHARE, "bits": Number(3, 1, 1000), "way": _WAY},
    ),
    "cut": ("nothing passes", 5.0, {"way": _WAY}),
}
_CLOCK: _Kinds = {
    "reboot": ("the autopilot starts anew: silence, its clock from 0, requests forgotten", 5.0, {}),
    "clock-jump": (
        "the autopilot's clock jumps by `by` seconds at the start, for good",
        1.0,
        {"by": Number(0.5, -1e6, 1e6)},
    ),
    "clock-skew": (
        "the autopilot's clock runs `ppm` millionths fast; what is gained stays",
        20.0,
        {"ppm": Number(200.0, -1e5, 1e5)},
    ),
}
_SENSOR: _Kinds = {
    "gnss-outage": (
        "no fix: the receiver is silent, or says fix_type 0 with true coordinates (nofix)",
        10.0,
        {"how": Word(("silent", "nofix"))},
    ),
    "gnss-jump": (
        "fixes are elsewhere at once, by metres",
        10.0,
        {"north": _METRES, "east": Number(50.0, -1e6, 1e6), "down": _METRES},
    ),
    "gnss-drag": (
        "fixes are dragged off, m/s, towards a course in degrees; their velocity says so too",
        30.0,
        {"speed": Number(1.0, 0.0, 1e3), "course": Number(90.0, -360.0, 360.0)},
    ),
    "gnss-frozen": (
        "the same fix again and again, its time going on or the same",
        10.0,
        {"time": Word(("advancing", "same"))},
    ),
    "imu-saturation": (
        "gyro and accelerometer end at so many rad/s and m/s^2",
        2.0,
        {"gyro": Number(0.5, 0.0, 100.0), "accel": Number(11.0, 0.0, 1e3)},
    ),
    "imu-stuck": ("the last inertial sample again and again", 2.0, {}),
    "imu-nan": ("inertial samples are no numbers", 2.0, {}),
    "imu-gap": ("no inertial samples", 2.0, {}),
    "mag-disturbance": (
        "a field is added, gauss in the body",
        10.0,
        {
            "forward": Number(0.3, -100.0, 100.0),
            "right": _GAUSS,
            "down": _GAUSS,
            "compass": Word(("first", "all")),
        },
    ),
    "baro-step": (
        "the barometer reads `height` metres more",
        10.0,
        {"height": Number(20.0, -1e4, 1e4)},
    ),
    "range-bounce": (
        "the range finder reads anything that it can read",
        10.0,
        {"lowest": Number(0.3, 0.0, 1e3), "highest": Number(39.0, 0.0, 1e3)},
    ),
    "range-step": (
        "the range finder reads `by` metres more: a pit, or a roof",
        10.0,
        {"by": Number(-5.0, -1e3, 1e3)},
    ),
    "range-drift": (
        "the ground sinks by `speed` m/s, as a deck does",
        20.0,
        {"speed": Number(0.3, -10.0, 10.0)},
    ),
    "range-scale": (
        "the range is `factor` times what it is",
        20.0,
        {"factor": Number(1.1, 0.0, 10.0)},
    ),
    "range-frozen": ("the same range again and again", 10.0, {}),
    "range-late": ("ranges come late, as if they were new", 20.0, {"delay": _DELAY}),
    "pitot-blocked": (
        "the pitot tube is shut: its pressure stays, and reads as more the higher the vehicle is",
        20.0,
        {},
    ),
    "pitot-frozen": ("the same airspeed again and again", 20.0, {}),
    "pitot-scale": (
        "the airspeed is `factor` times what it is",
        20.0,
        {"factor": Number(0.5, -10.0, 10.0)},
    ),
    "pitot-drift": (
        "the airspeed reads `speed` m/s more in each second",
        20.0,
        {"speed": Number(0.2, -10.0, 10.0)},
    ),
    "pitot-late": ("airspeeds come late, as if they were new", 20.0, {"delay": _DELAY}),
    "wheel-slip": (
        "the wheels turn by `speed` m/s faster than the vehicle moves; its way jumps back after",
        5.0,
        {"speed": Number(3.0, -100.0, 100.0)},
    ),
    "wheel-frozen": ("the wheels' way stays as it is, and jumps after", 5.0, {}),
    "wheel-scale": (
        "the wheels turn by `factor`; their way jumps back after",
        20.0,
        {"factor": Number(1.1, 0.0, 10.0)},
    ),
    "wheel-late": ("the wheels' way comes late, as if it were new", 20.0, {"delay": _DELAY}),
    "flow-frozen": ("the optical flow sensor says the same again and again", 10.0, {}),
    "flow-blind": (
        "the optical flow sensor sees nothing, and says so, or that nothing moves (still)",
        10.0,
        {"how": Word(("dark", "still"))},
    ),
    "flow-scale": (
        "the optical flow is `by` times as fast; -1 is a wrong sign",
        10.0,
        {"by": Number(-1.0, -10.0, 10.0)},
    ),
    "flow-drift": (
        "the ground that the optical flow sensor sees moves itself, as water, rad/s",
        10.0,
        {"x": Number(0.1, -10.0, 10.0), "y": Number(0.0, -10.0, 10.0)},
    ),
    "flow-turned": (
        "the optical flow sensor is turned by `yaw` degrees, and its gyro with it",
        10.0,
        {"yaw": Number(90.0, -180.0, 180.0)},
    ),
    "flow-late": ("optical flow comes late, as if it were new", 10.0, {"delay": _DELAY}),
    "flow-jitter": (
        "the stamps of the optical flow are off by `std` seconds, one sigma",
        10.0,
        {"std": Number(0.05, 0.0, 1.0)},
    ),
}
_SETUP: _Kinds = {
    "mounting": (
        "the board is turned in the vehicle, deg, and the autopilot does not know",
        3600.0,
        {"roll": Number(180.0, -180.0, 180.0), "pitch": _ANGLE, "yaw": _ANGLE},
    ),
    "own-estimate": (
        "the autopilot's own estimate is off, by degrees of heading and by metres",
        3600.0,
        {
            "heading": Number(34.0, -180.0, 180.0),
            "north": _METRES,
            "east": _METRES,
            "down": _METRES,
        },
    ),
    "accel-drift": (
        "the accelerometers drift, m/s^2 in each second, as while a board warms up",
        3600.0,
        {"forward": Number(0.02, -10.0, 10.0), "right": Number(0.0, -10.0, 10.0)},
    ),
    "imu-step": (
        "accelerometer and gyro are off at once, m/s^2 and rad/s",
        3600.0,
        {
            "forward": Number(1.0, -100.0, 100.0),
            "down": Number(0.0, -100.0, 100.0),
            "yaw": Number(0.0, -10.0, 10.0),
        },
    ),
    "imu-noise": (
        "accelerometer and gyro are noisy at once, one sigma, m/s^2 and rad/s",
        3600.0,
        {"accel": Number(3.0, 0.0, 100.0), "gyro": Number(0.3, 0.0, 10.0)},
    ),
}
_PASSING = ((Layer.WIRE, _WIRE), (Layer.CLOCK, _CLOCK), (Layer.SENSOR, _SENSOR))
KINDS = {
    name: FaultKind(name, *kind, layer)
    for layer, kinds in (*_PASSING, (Layer.SENSOR, _SETUP))
    for name, kind in kinds.items()
}
"""By name."""

VARIETY = (
    *(name for name in KINDS if name not in _SETUP),
    "gnss-outage:how=nofix",
    "gnss-frozen:time=same",
    "clock-jump:by=-0.5",
)
"""Every kind that comes and goes in flight, and the variants that other code handles."""


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
    rules = {
        "start": Number(0.0, 0.0, 1e6),
        "duration": Number(kind.duration, 0.0, 1e6),
        **kind.values,
    }
    values: dict[str, float | str] = {
        key: rule.default if isinstance(rule, Number) else rule.words[0]
        for key, rule in rules.items()
    }
    for key, value in texts.items():
        rule = rules[spec.choose(text, f"value of {name}", key, rules)]
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
    return Fault(kind, start, duration, values)


def schedule(
    kinds: Iterable[str], seed: int, duration: float, gap: float, *, first: float = 30.0
) -> list[Fault]:
    """Schedule faults in random order with quiet time between them, round after round.

    Kinds are names, or names with values, as ``parse`` reads them, without ``start``. Quiet are
    ``first`` seconds, and ``gap`` seconds after each fault, the last within the flight's duration.

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
            joint = "," if ":" in texts[index] else ":"
            fault = parse(f"{texts[index]}{joint}start={at!r}")
            if fault.end + gap > duration:
                return found
            found.append(fault)
            at = fault.end + gap
    return found
