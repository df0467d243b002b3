"""What is wrong now, where the fault hypotheses decide: for the pilot, the messages, preflight.

A source is wrong as long as it is more likely wrong than right, and once that was beyond doubt,
until it is known to be right again. The words have 28 characters at most: a pilot's text has 50.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from ekf_companion.core.memory.constants import FADES
from ekf_companion.core.memory.enums import Aid, Fault, Source
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.engine.faults import ENDS, EVEN, OF_NO_SIZE, SOURCES, FoundFault

LONGEST_WORDS = 28
"""Characters: of 50, without ``Companion: `` and ``suspected: `` or ``, corrected``."""
_DEG = math.degrees(1.0)

NAMES: Mapping[Source, str] = {
    Source.POSITION: "GNSS",
    Source.DRAG: "GNSS",
    Source.VELOCITY: "GNSS velocity",
    Source.HEIGHT: "GNSS height",
    Source.FALL: "GNSS height",
    Source.CLIMB: "GNSS climb",
    Source.BARO: "barometer",
    Source.COMPASS: "compass",
    Source.HEADING: "heading",
    Source.ACCEL: "accelerometer",
    Source.GYRO: "gyro",
    Source.DELAY: "GNSS delay",
    Source.LEVER: "antenna",
}
"""Sources that may be wrong, in a pilot's words. An error of our own state is in the status, and
that a receiver settles after its first fix is no fault."""
RECEIVER = (Source.POSITION, Source.DRAG, Source.VELOCITY, Source.HEIGHT, Source.FALL, Source.CLIMB)
PLACE = (Source.POSITION, Source.DRAG)
"""Of the receiver, and of that the horizontal position."""
_PASSING = (
    *(Fault.BARO_STEP, Fault.BARO_RAMP, Fault.ACCEL_STEP, Fault.GYRO_STEP),
    *(Fault.FIELD, Fault.VELOCITY_TURN),
)
"""Faults that may pass, and whose end nothing shows, unlike that of what is :class:`Held`. They
are told for as long as it takes to be forgotten that a source has failed."""
_CALIBRATED = (
    *(Fault.DELAY, Fault.LEVER, Fault.BODY_FIELD, Fault.VELOCITY_SCALE, Fault.VELOCITY_LAG),
    *(Fault.BARO_SPEED, Fault.BARO_SCALE),
)
"""What is known once it was found, as a calibration is."""
_AIDS: Mapping[Aid, tuple[Source, ...]] = {
    Aid.POSITION: (Source.POSITION,),
    Aid.HEIGHT: (Source.HEIGHT, Source.FALL),
    Aid.VELOCITY: (Source.VELOCITY,),
    Aid.BARO: (Source.BARO,),
}
"""Sources whose aid corrects nothing while they are suspected."""
_SIZES: Mapping[Fault, tuple[str, float, int]] = {
    Fault.POSITION_STEP: ("{} m off", 1.0, 0),
    Fault.POSITION_RAMP: ("slides, {} m", 1.0, 1),
    Fault.DRAG: ("led away, {} m", 1.0, 1),
    Fault.DRAG_RAMP: ("led away, {} m", 1.0, 2),
    Fault.VELOCITY_STEP: ("{} m/s off", 1.0, 0),
    Fault.VELOCITY_SCALE: ("{} % off", 100.0, 0),
    Fault.VELOCITY_LAG: ("{} s late", 1.0, 0),
    Fault.VELOCITY_TURN: ("{} deg off", _DEG, 0),
    Fault.CLIMB_STEP: ("{} m/s off", 1.0, 0),
    Fault.HEIGHT_STEP: ("{} m off", 1.0, 0),
    Fault.HEIGHT_RAMP: ("slides, {} m", 1.0, 1),
    Fault.FALL: ("led away, {} m", 1.0, 1),
    Fault.FALL_RAMP: ("led away, {} m", 1.0, 2),
    Fault.BARO_STEP: ("{} m off", 1.0, 0),
    Fault.BARO_RAMP: ("slides, {} m", 1.0, 1),
    Fault.BARO_SPEED: ("off by the air", 1.0, 0),
    Fault.BARO_SCALE: ("{} % off", 100.0, 0),
    Fault.ACCEL_STEP: ("{} m/s2 off", 1.0, 0),
    Fault.GYRO_STEP: ("{} deg/s off", _DEG, 0),
    Fault.FIELD: ("{} mgauss off", 1000.0, 0),
    Fault.BODY_FIELD: ("{} mgauss off", 1000.0, 0),
    Fault.HEADING_STEP: ("{} deg off", _DEG, 0),
    Fault.DELAY: ("{} ms off", 1000.0, 0),
    Fault.LEVER: ("{} m off", 1.0, 0),
    **dict.fromkeys(OF_NO_SIZE, ("erratic", 1.0, 0)),
    Fault.ALIGNMENT: ("off by any angle", 1.0, 0),
}
"""What each kind does in words, its scale to their unit, and how often it has added up over time.
"""


class Hypothesis(NamedTuple):
    """A fault that may be there now."""

    kind: Fault
    probability: float
    onset_ns: int
    size: tuple[float, float, float]
    """By component, in the fault's unit."""


class Held(NamedTuple):
    """By how much sources are off that were declared and are not right again.

    0: by no more than is not known of them anyway.
    """

    position: float
    """m."""
    height: float
    """m."""
    velocity: float
    """In the level, m/s."""
    climb: float
    """m/s."""
    heading: float
    """rad."""
    is_sliding: tuple[bool, bool]
    """Whether position and height go on to slide."""


class Wrong(NamedTuple):
    """A source that is wrong now."""

    source: Source
    """The most probable one."""
    words: str
    """Which, and how far it is off by now: ``GNSS 60 m off``."""
    probability: float
    """That it is wrong, or another one that shows in the same."""
    is_found: bool
    """It was beyond doubt: what it is off by is taken off its readings, and these are used."""
    unused: tuple[Aid, ...]
    """Aids that correct nothing meanwhile."""

    @property
    def name(self) -> str:
        """The source in a pilot's words."""
        return NAMES[self.source]

    @property
    def sentence(self) -> str:
        """What it is, and what follows: ``GNSS 60 m off, corrected``, ``suspected: ...``."""
        return f"{self.words}, corrected" if self.is_found else f"suspected: {self.words}"


def wrong_now(
    hypotheses: Sequence[Hypothesis], found: Iterable[FoundFault], held: Held, now_ns: int
) -> tuple[Wrong, ...]:
    """Return what is wrong now, each source once; the receiver's position first."""
    found = list(found)
    wrong = {one.name: one for one in (*_lately(found, now_ns), *_held(held, found))}
    # that a calibration was none is no fault
    calibrated = {one.kind for one in found} & set(_CALIBRATED)
    for one in _suspected([h for h in hypotheses if h.kind not in calibrated], now_ns):
        # what was found goes on to be corrected, whatever is suspected beside it
        was = wrong.get(one.name, one)
        wrong[one.name] = was._replace(unused=one.unused)
    return tuple(sorted(wrong.values(), key=lambda one: _ORDER.index(one.name)))


_ORDER = tuple(dict.fromkeys(NAMES.values()))
_SUBJECTS = tuple(dict.fromkeys(what for what, _ in SOURCES.values()))


def _held(held: Held, found: Iterable[FoundFault]) -> Iterable[Wrong]:
    """Find what was declared and is not right again."""
    kinds = {one.kind for one in found}
    steps = Fault.VELOCITY_STEP in kinds, Fault.CLIMB_STEP in kinds
    for source, size, unit, slides in (
        (Source.POSITION, held.position, "m", held.is_sliding[0]),
        (Source.HEIGHT, held.height, "m", held.is_sliding[1]),
        (Source.VELOCITY, held.velocity * steps[0], "m/s", False),
        (Source.CLIMB, held.climb * steps[1], "m/s", False),
        (Source.HEADING, held.heading * _DEG, "deg", False),
    ):
        if size:
            text = f"slides, {_number(size)} {unit}" if slides else f"{_number(size)} {unit} off"
            yield Wrong(source, f"{NAMES[source]} {text}", 1.0, True, ())


def _lately(found: Iterable[FoundFault], now_ns: int) -> Iterable[Wrong]:
    """Find what was declared lately of sources that nothing shows to be right again."""
    for one in found:
        if one.kind in _PASSING and (now_ns - one.until_ns) * 1e-9 <= FADES:
            words = _in_words(one.kind, one.size, (now_ns - one.onset_ns) * 1e-9)
            yield Wrong(one.source, words, 1.0, True, ())


def _suspected(hypotheses: Sequence[Hypothesis], now_ns: int) -> list[Wrong]:
    """Return what is more likely wrong than right; the end of a fault is none."""
    sources: dict[Source, float] = {}
    for one in hypotheses:
        source = FAULTS[one.kind].source
        if source in NAMES and one.kind not in ENDS:
            sources[source] = sources.get(source, 0.0) + one.probability
    suspected = []
    for subject in _SUBJECTS:
        mine = {one: p for one, p in sources.items() if SOURCES[one][0] == subject}
        if (total := sum(mine.values())) <= EVEN:
            continue
        first, *others = sorted(mine, key=lambda one: -mine[one])
        unused = tuple(
            aid for aid, of in _AIDS.items() if sum(mine.get(one, 0.0) for one in of) > EVEN
        )
        alike = [one for one in others if NAMES[one] != NAMES[first]]
        if mine[first] > EVEN or not alike:
            best = max(
                (one for one in hypotheses if FAULTS[one.kind].source == first),
                key=lambda one: one.probability * (one.kind not in ENDS),
            )
            words = _in_words(best.kind, best.size, (now_ns - best.onset_ns) * 1e-9)
        else:
            words = f"{NAMES[first]} or {NAMES[alike[0]]}"
        suspected.append(Wrong(first, words, min(total, 1.0), False, unused))
    return suspected


def _in_words(kind: Fault, size: Sequence[float], seconds: float) -> str:
    """Return what a fault is, and how large it is after some seconds."""
    text, scale, times = _SIZES[kind]
    rows = 1 if kind is Fault.DELAY else FAULTS[kind].rows
    grown = seconds**times / (2.0 if times == 2 else 1.0)
    number = _number(math.hypot(*size[:rows]) * scale * grown)
    return f"{NAMES[FAULTS[kind].source]} {text.format(number)}"


def _number(size: float) -> str:
    """Return a size with two digits or more, and no more than four characters."""
    return f"{min(size, 9999.0):.{0 if size >= 9.95 else 1}f}"
