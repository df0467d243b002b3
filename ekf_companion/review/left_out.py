"""What of a log is no measurement: left out, and named in the same words, whatever its format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ekf_companion.core.memory.enums import Aid, Verdict
from ekf_companion.engine.health import Health
from ekf_companion.nav.held_heading import REPEATED
from ekf_companion.nav.held_heading import ZERO as ZERO_HEADING
from ekf_companion.nav.held_velocity import ALWAYS_ZERO, COURSE_HELD, HELD
from ekf_companion.nav.held_velocity import REPEATED as REPEATED_VELOCITY
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.repetition import AXIS, LIMITED, SPIKE, STUCK, ZERO
from ekf_companion.replay.screen import NO_FIELD, NO_PLACE, NO_PRESSURE, Screen

VELOCITIES = (ALWAYS_ZERO, COURSE_HELD, HELD, REPEATED_VELOCITY)
VERTICAL_ZERO, VERTICAL_HELD = f"vertical {ALWAYS_ZERO}", f"vertical {HELD}"
FROZEN = "those of a frozen receiver"
OFTEN = 0.2
"""Share of a sensor's measurements beyond which its verdict names it."""

_NAMES = {
    Kind.IMU: "inertial samples",
    Kind.GNSS: "fixes",
    Kind.HEADING: "headings",
    Kind.MAG: "magnetic fields",
    Kind.BARO: "barometer heights",
}
_NOTES = {
    STUCK: "{} of {} {} are of a sensor that is stuck: it says the same again and again, and they "
    "were not used; check the sensor",
    AXIS: "{} of {} {} are of a sensor with an axis that is stuck: it says the same while others "
    "turn, and the rotation about it, or the force along it, is not known; check the sensor",
    LIMITED: "{} of {} {} are of a sensor at the end of its range, or with an axis that is stuck: "
    "their noise counts as larger; check the sensor, its mounting and its range",
    SPIKE: "{} of {} {} leap by more than 10 rad/s or 32 g, and back: they are spikes, or of a "
    "crash, and were not used; check the sensor and what reads it",
    ZERO: "{} of {} {} are six zeros, as of a sensor that is absent: they were not used",
    ZERO_HEADING: "{} of {} {} are 0 where there is none: they were not used",
    NO_PRESSURE: "{} of {} {} are of a pressure that air has nowhere up to 11 km, and were not "
    "used; check its unit: 1013 hPa are 101300 Pa",
    REPEATED: "{} of {} {} repeat the one before while the vehicle turns, or within a second: they "
    "are held between updates, and were not used",
    ALWAYS_ZERO: "the velocity of {} of {} {} is 0 while the positions move: it is none, and was "
    "not used; check the receiver's settings, or leave it out",
    HELD: "the velocity of {} of {} {} repeats the one before while the positions move otherwise: "
    "it is held, and was not used",
    REPEATED_VELOCITY: "the velocity of {} of {} {} is that of the one before to the bit: it is "
    "held between updates, and was not used",
    COURSE_HELD: "the velocity of {} of {} {} has the course of the ones before to the bit: at low "
    "speed the receiver holds it, and it was not used",
    FROZEN: "{} of {} {} have the position of the ones before to the bit while the vehicle moves: "
    "the receiver is frozen, and they were not used",
    VERTICAL_ZERO: "the vertical velocity of {} of {} {} is 0 while the heights move: it is none, "
    "and was not used",
    VERTICAL_HELD: "the vertical velocity of {} of {} {} repeats the one before while the heights "
    "move otherwise: it is held, and was not used",
}
_WORDS = {
    STUCK: "the inertial sensor is stuck",
    AXIS: "the inertial sensor is stuck on an axis",
    LIMITED: "the inertial sensor is at the end of its range",
    SPIKE: "the inertial sensor has spikes",
    ZERO: "the inertial sensor is absent",
    ZERO_HEADING: "headings of 0 where there is none",
    NO_PLACE: "fixes without a place",
    NO_FIELD: "magnetic fields of zeros",
    NO_PRESSURE: "the barometer's pressure is none of the air",
    FROZEN: "the receiver is frozen",
    ALWAYS_ZERO: "the receiver's velocity is always 0",
    HELD: "the receiver's velocity is held",
    VERTICAL_ZERO: "the receiver's vertical velocity is always 0",
    VERTICAL_HELD: "the receiver's vertical velocity is held",
}
"""Held headings are not among them: slow receivers repeat theirs, and it does no harm."""


_LOST = (SPIKE, STUCK, ZERO, REPEATED, NO_FIELD, NO_PRESSURE)
"""Reasons for which a whole measurement is left out."""


class LeftOut(NamedTuple):
    """Measurements of a kind that were left out for one reason."""

    kind: Kind
    why: str
    number: int
    total: int
    """Of the kind, with those that were used."""

    @property
    def note(self) -> str:
        """A sentence of it."""
        words = _NOTES.get(self.why, "{} of {} {} are {}: they were not used")
        return words.format(self.number, self.total, _NAMES[self.kind], self.why)

    @property
    def words(self) -> str:
        """The same in a few words for a verdict; empty: it need not say so."""
        return _WORDS.get(self.why, "") if self.number > OFTEN * self.total else ""


def of_columns(screen: Screen) -> list[LeftOut]:
    """Return what the screen of a columnar log left out."""
    return [
        LeftOut(kind, why, count, screen.total[kind])
        for (kind, why), count in screen.left_out.items()
    ]


def of_frozen(health: Health, flagged: int, total: int) -> Iterator[LeftOut]:
    """Yield the fixes that the filter found to be of a frozen receiver.

    Args:
        health: Of the filter.
        flagged: Fixes that the receiver itself reports as jammed or spoofed.
        total: All fixes.
    """
    if (count := health.verdicts[Aid.POSITION][Verdict.SUSPECT] - flagged) > 0:
        yield LeftOut(Kind.GNSS, FROZEN, count, total)


def of_telemetry(refused: Mapping[str, int], counts: Mapping[Kind, int]) -> Iterator[LeftOut]:
    """Yield what the readers of messages left out, by their counts of what was refused.

    Args:
        refused: Numbers by ``refused: MESSAGE: why``.
        counts: Of what was used, by kind.
    """
    from ekf_companion.mavlink.decode.inertial import SOURCES

    receivers = ("GPS_RAW_INT", "GPS2_RAW")
    reasons = [
        *(
            (Kind.IMU, message, why, why)
            for message in SOURCES
            for why in (STUCK, LIMITED, AXIS, SPIKE, ZERO)
        ),
        *((Kind.GNSS, message, why, why) for message in receivers for why in VELOCITIES),
        (Kind.HEADING, receivers[0], f"yaw {REPEATED}", REPEATED),
        (Kind.MAG, "mag", NO_FIELD, NO_FIELD),
        (Kind.BARO, "baro", "no pressure of the air", NO_PRESSURE),
    ]
    found = [
        (kind, why, refused[name])
        for kind, message, said, why in reasons
        if refused.get(name := f"refused: {message}: {said}")
    ]
    for kind, why, count in found:
        # A fix is used without its velocity, and a sample at the end of its range
        lost = sum(n for one, of, n in found if one is kind and of in _LOST)
        yield LeftOut(kind, why, count, counts.get(kind, 0) + lost)
