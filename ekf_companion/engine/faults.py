"""Faults that were found, and sources that are suspected, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.core.memory.enums import Fault, Source
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.nav.arrays import Array, Stamps

_DEG = math.degrees(1.0)

WORDS: Mapping[Fault, tuple[str, float]] = {
    Fault.POSITION_STEP: ("GNSS position {:.1f} m off", 1.0),
    Fault.POSITION_RAMP: ("GNSS position slides at {:.2f} m/s", 1.0),
    Fault.DRAG: ("GNSS position and velocity led away at {:.2f} m/s", 1.0),
    Fault.DRAG_RAMP: ("GNSS position and velocity led away at {:.2f} m/s^2", 1.0),
    Fault.VELOCITY_STEP: ("GNSS velocity {:.2f} m/s off", 1.0),
    Fault.VELOCITY_SCALE: ("GNSS velocity {:.1f} % off in length", 100.0),
    Fault.VELOCITY_LAG: ("GNSS velocity {:.2f} s apart from the position", 1.0),
    Fault.VELOCITY_TURN: ("GNSS velocity turned by {:.1f} deg", _DEG),
    Fault.CLIMB_STEP: ("GNSS vertical velocity {:.2f} m/s off", 1.0),
    Fault.HEIGHT_STEP: ("GNSS height {:.1f} m off", 1.0),
    Fault.HEIGHT_RAMP: ("GNSS height slides at {:.2f} m/s", 1.0),
    Fault.FALL: ("GNSS height and vertical velocity led away at {:.2f} m/s", 1.0),
    Fault.FALL_RAMP: ("GNSS height and vertical velocity led away at {:.2f} m/s^2", 1.0),
    Fault.BARO_STEP: ("barometer {:.1f} m off", 1.0),
    Fault.BARO_RAMP: ("barometer slides at {:.2f} m/s", 1.0),
    Fault.BARO_SPEED: ("barometer {:.1f} m off at 15 m/s, by the air", 1.0),
    Fault.BARO_SCALE: ("barometer {:.1f} % off by the height", 100.0),
    Fault.ACCEL_STEP: ("accelerometer {:.2f} m/s^2 off", 1.0),
    Fault.GYRO_STEP: ("gyro {:.2f} deg/s off", _DEG),
    Fault.TILT: ("our roll and pitch were {:.1f} deg off", _DEG),
    Fault.YAW: ("our yaw was {:.1f} deg off", _DEG),
    Fault.LED: ("our position had been led away by {:.0f} % of a way without fixes", 100.0),
    Fault.LED_ON: ("our position and velocity led away by {:.0f} %, without fixes", 100.0),
    Fault.KICK: ("our velocity was {:.2f} m/s off, as by a shock", 1.0),
    Fault.FIELD: ("magnetic field of {:.3f} gauss beside the Earth's", 1.0),
    Fault.BODY_FIELD: ("the vehicle's magnetic field changed by {:.3f} gauss", 1.0),
    Fault.HEADING_STEP: ("heading {:.1f} deg off", _DEG),
    Fault.DELAY: ("fixes {:.0f} ms off the delay that is set", 1000.0),
    Fault.LEVER: ("antenna {:.2f} m from where it is set", 1.0),
    Fault.SETTLE: ("GNSS position {:.1f} m off at first", 1.0),
    Fault.SETTLE_HEIGHT: ("GNSS height {:.1f} m off at first", 1.0),
    Fault.RECOVERY: ("GNSS position and velocity right again, by {:.0f} % of its error", 100.0),
    Fault.RECOVERY_HEIGHT: (
        "GNSS height and vertical velocity right again, by {:.0f} % of its error",
        100.0,
    ),
    Fault.HALT: ("GNSS position slides no more, by {:.0f} % of its rate", 100.0),
    Fault.HALT_HEIGHT: ("GNSS height slides no more, by {:.0f} % of its rate", 100.0),
    Fault.HALT_BARO: ("barometer slides no more, by {:.0f} % of its rate", 100.0),
    Fault.FADE: ("GNSS position settles again, by {:.0f} % of its error", 100.0),
    Fault.FADE_HEIGHT: ("GNSS height settles again, by {:.0f} % of its error", 100.0),
    Fault.RECOVERY_HEADING: ("heading right that was {:.1f} deg off", _DEG),
    Fault.STATE_WILD: ("our own attitude and velocity lost", 1.0),
    Fault.ALIGNMENT: ("our own yaw lost", 1.0),
    Fault.POSITION_WILD: ("GNSS position erratic", 1.0),
    Fault.RECEIVER_WILD: ("GNSS position and velocity erratic", 1.0),
    Fault.VELOCITY_WILD: ("GNSS velocity erratic", 1.0),
    Fault.CLIMB_WILD: ("GNSS vertical velocity erratic", 1.0),
    Fault.HEIGHT_WILD: ("GNSS height erratic", 1.0),
    Fault.FALL_WILD: ("GNSS height and vertical velocity erratic", 1.0),
    Fault.BARO_WILD: ("barometer erratic", 1.0),
}
"""What each is called, and its size in the unit of the words."""


SOURCES: Mapping[Source, tuple[str, str]] = {
    Source.POSITION: ("position", "GNSS position"),
    Source.DRAG: ("position", "GNSS position with its velocity"),
    Source.VELOCITY: ("position", "GNSS velocity"),
    Source.SETTLING: ("position", "a receiver that settles"),
    Source.HEIGHT: ("height", "GNSS height"),
    Source.FALL: ("height", "GNSS height with its velocity"),
    Source.SETTLING_HEIGHT: ("height", "a receiver that settles"),
    Source.CLIMB: ("height", "GNSS vertical velocity"),
    Source.BARO: ("height", "barometer"),
    Source.COMPASS: ("heading", "compass"),
    Source.HEADING: ("heading", "heading source"),
    Source.ACCEL: ("motion", "accelerometer"),
    Source.GYRO: ("motion", "gyro"),
    Source.STATE: ("motion", "our own state"),
    Source.DELAY: ("motion", "delay of the fixes"),
    Source.LEVER: ("motion", "place of the antenna"),
}
"""What a fault of each source spoils, and the source in words."""
EVEN = 0.5
"""Probability from which on something is suspected: it is more likely wrong than right."""
SHARE = 0.1
"""Share of that from which on a source is named with others."""
MOST_NAMES = 3
"""Sources that are named at once: more say no more than that nobody knows."""
OPENED = (
    *((Source.POSITION,), (Source.VELOCITY,), (Source.BARO,)),
    *((Source.HEIGHT, Source.FALL), (Source.CLIMB, Source.FALL)),
)
"""Sources whose readings correct nothing while one of them is suspected, with ``weigh_faults:
act``; so decides ``hypotheses.open_rows``, but while the inertial noise leaps."""
ENDS = (
    *(Fault.RECOVERY, Fault.RECOVERY_HEIGHT, Fault.HALT, Fault.HALT_HEIGHT, Fault.HALT_BARO),
    *(Fault.FADE, Fault.FADE_HEIGHT),
    Fault.RECOVERY_HEADING,
)
"""Of what was found these are no faults."""
SIZES = {
    Fault.DELAY: 1,
    Fault.FADE: 1,
    Fault.FADE_HEIGHT: 1,
    Fault.LED_ON: 2,
    Fault.RECOVERY_HEADING: 1,
}
"""Their other components are no part of the size: what a delay is about, how fast it fades, the
velocity beside the way."""

OF_NO_SIZE = (Fault.ALIGNMENT, *(kind for kind in Fault if kind.name.endswith("_WILD")))
"""What is wrong in no shape has none, nor has a yaw that may be any."""


class FoundFault(NamedTuple):
    """A fault that was beyond doubt, of constant size since its onset."""

    kind: Fault
    onset_ns: int
    """Stamp from which on it explains what was measured."""
    until_ns: int
    """Stamp at which that was so last."""
    size: tuple[float, float, float]
    """By component, in the fault's unit; what it has no component for is 0."""
    std: tuple[float, float, float]
    """One sigma of each."""
    evidence: float
    """Log-likelihood of what was measured, beside that of no fault."""

    @property
    def source(self) -> Source:
        """Whose fault it is."""
        return FAULTS[self.kind].source

    @property
    def components(self) -> int:
        """How many numbers its size has."""
        if self.kind in OF_NO_SIZE:
            return 0
        return SIZES.get(self.kind, FAULTS[self.kind].rows)

    @property
    def size_words(self) -> tuple[str, str]:
        """What it is with its size, and one sigma of that in the same unit."""
        text, scale = WORDS[self.kind]
        if not self.components:
            return text, ""
        parts = self.size[: self.components]
        size = float(np.linalg.norm(parts))
        # of the size along the fault
        along = np.divide(parts, size) if size > 0.0 else np.full(len(parts), len(parts) ** -0.5)
        std = float(np.linalg.norm(along * self.std[: self.components]))
        digits = text[text.index("{") : text.index("}") + 1]
        return text.format(scale * size), digits.format(scale * std)

    def words(self, first_ns: int) -> str:
        """Return what it is, how large, and when, counted from a stamp."""
        begin, end = (1e-9 * (t - first_ns) for t in (self.onset_ns, self.until_ns))
        return f"{self.size_words[0]}, {begin:.0f} to {end:.0f} s"

    def words_ago(self, now_ns: int, *, repaired: bool = False) -> str:
        """Return what it is, how large, and how long ago it began and was so last, or repaired."""
        begin, end = (1e-9 * (now_ns - t) for t in (self.onset_ns, self.until_ns))
        if repaired and self.kind not in ENDS:
            return f"{self.size_words[0]}, since {begin:.0f} s, repaired {end:.0f} s ago"
        return f"{self.size_words[0]}, {begin:.0f} to {end:.0f} s ago"

    def to_dict(self, first_ns: int) -> dict[str, Any]:
        """Return it for JSON, in the unit of its kind, with times in s, counted from a stamp."""
        return {
            "source": self.source.name.lower(),
            "kind": self.kind.name.lower(),
            "words": self.size_words[0],
            "size": list(self.size[: self.components]),
            "std": list(self.std[: self.components]),
            "from_s": (self.onset_ns - first_ns) * 1e-9,
            "to_s": (self.until_ns - first_ns) * 1e-9,
            "evidence": self.evidence,
        }


class FaultEvidence(NamedTuple):
    """How probable it was over time that each source was wrong."""

    t_ns: Stamps
    """Stamps, once a second or less often, shape (n,)."""
    probability: Array
    """By :class:`~.enums.Source`, shape (n, sources). What shows in the level and what shows in the
    vertical may be there at once."""
    protection: Array
    """Horizontal and vertical protection level, m, shape (n, 2); NaN: none."""


NO_EVIDENCE = FaultEvidence(
    np.zeros(0, dtype=np.int64), np.zeros((0, len(Source))), np.zeros((0, 2))
)


def by_source(probability: Array) -> dict[str, float]:
    """Return the probabilities of the sources by name, those below a thousandth left out."""
    return {
        source.name.lower(): float(probability[source])
        for source in SOURCES
        if probability[source] >= 1e-3
    }


def suspicions(probability: Array, *, decides: bool = False) -> tuple[str, ...]:
    """Return what is suspected, in words, by what a fault of it spoils.

    As ``height: GNSS height or barometer (0.93)``, with the probability that any of these is wrong.
    Where the hypotheses decide, a source that is more likely wrong than right is not used.
    """
    spoilt: dict[str, list[Source]] = {}
    for source, (what, _) in SOURCES.items():
        spoilt.setdefault(what, []).append(source)
    found = []
    for what, sources in spoilt.items():
        total = float(probability[sources].sum())
        if total > EVEN:
            ranked = sorted(sources, key=lambda one: -probability[one])
            named = [SOURCES[one][1] for one in ranked if probability[one] >= SHARE * total]
            is_opened = decides and any(
                ranked[0] in group and probability[list(group)].sum() > EVEN for group in OPENED
            )
            words = f"{what}: {' or '.join(named[:MOST_NAMES])} ({total:.2f})"
            found.append(f"{words}, {named[0]} not used" if is_opened else words)
    return tuple(found)
