"""What is wrong now in words: a fault that is suspected, one that was found, and its end."""

import itertools

import pytest

from ekf_companion.core.memory.enums import Aid, Fault, Source
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.engine.faults import ENDS, OF_NO_SIZE, SOURCES, FoundFault
from ekf_companion.engine.wrong import (
    LONGEST_WORDS,
    NAMES,
    Held,
    Hypothesis,
    wrong_now,
)

SECOND = 1_000_000_000
NONE = Held(0.0, 0.0, 0.0, 0.0, 0.0, (False, False))
TOLD = [
    kind
    for kind in Fault
    if kind not in ENDS and FAULTS[kind].source in NAMES and FAULTS[kind].rate > 0.0
]


def likely(kind, p=0.9, size=(3.0, 4.0, 0.0), ago=2.0):
    return Hypothesis(kind, p, round((100.0 - ago) * SECOND), size)


def found(kind, size=(3.0, 4.0, 0.0), ago=2.0, until=1.0):
    times = (round((100.0 - one) * SECOND) for one in (ago, until))
    return FoundFault(kind, *times, size, (0.1, 0.1, 0.1), 50.0)


def wrong(hypotheses=(), faults=(), held=NONE):
    return wrong_now(hypotheses, faults, held, 100 * SECOND)


@pytest.mark.parametrize("kind", TOLD)
def test_every_kind_has_words_that_fit_beside_what_follows(kind):
    for size in (0.0, 0.123, 1e9):
        (one,) = wrong([likely(kind, size=(size, 0.0, 0.0), ago=60.0)])
        assert len(one.words) <= LONGEST_WORDS
        assert one.words.startswith(NAMES[FAULTS[kind].source])
        assert one.sentence == f"suspected: {one.words}"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Fault.POSITION_STEP, "GNSS 5.0 m off"),
        (Fault.POSITION_RAMP, "GNSS slides, 10 m"),
        (Fault.DRAG, "GNSS led away, 10 m"),
        (Fault.DRAG_RAMP, "GNSS led away, 10 m"),
        (Fault.BARO_STEP, "barometer 3.0 m off"),
        (Fault.POSITION_WILD, "GNSS erratic"),
        (Fault.DELAY, "GNSS delay 3000 ms off"),
    ],
)
def test_its_size_is_that_of_now_by_its_own_components(kind, words):
    (one,) = wrong([likely(kind)])
    assert one.words == words
    assert not one.is_found


def test_what_is_as_likely_right_an_end_and_what_is_our_own_is_not_wrong():
    assert not wrong([likely(Fault.POSITION_STEP, 0.5)])
    for kind in (*ENDS, Fault.TILT, Fault.SETTLE, Fault.SETTLE_HEIGHT, Fault.ACCEL_NOISE):
        assert not wrong([likely(kind, 1.0)])


def test_two_that_share_it_are_both_named_and_neither_is_called_unused():
    height, baro = likely(Fault.HEIGHT_STEP, 0.4), likely(Fault.BARO_STEP, 0.45)
    (one,) = wrong([height, baro])
    assert one.words == "barometer or GNSS height"
    assert one.unused == ()
    (one,) = wrong([likely(Fault.HEIGHT_STEP, 0.3), likely(Fault.BARO_STEP, 0.6)])
    assert (one.words, one.unused) == ("barometer 3.0 m off", (Aid.BARO,))


@pytest.mark.parametrize("pair", list(itertools.permutations(NAMES, 2)))
def test_the_names_of_two_fit_too(pair):
    if SOURCES[pair[0]][0] == SOURCES[pair[1]][0]:
        assert len(f"{NAMES[pair[0]]} or {NAMES[pair[1]]}") <= LONGEST_WORDS


def test_what_is_held_is_wrong_until_it_is_right_again():
    fault = found(Fault.POSITION_STEP, ago=900.0, until=890.0)
    (one,) = wrong(faults=[fault], held=NONE._replace(position=59.8))
    assert (one.words, one.sentence) == ("GNSS 60 m off", "GNSS 60 m off, corrected")
    assert one.is_found
    assert not wrong(faults=[fault])
    slides = NONE._replace(height=7.0, is_sliding=(False, True))
    assert [one.words for one in wrong(held=slides)] == ["GNSS height slides, 7.0 m"]
    assert [one.words for one in wrong(held=NONE._replace(heading=0.5))] == ["heading 29 deg off"]


def test_what_was_found_once_for_all_is_neither_wrong_nor_suspected_of_not_being_there():
    (one,) = wrong([likely(Fault.BODY_FIELD)])
    assert one.words == "compass 5000 mgauss off"
    assert not wrong([likely(Fault.BODY_FIELD)], [found(Fault.BODY_FIELD)])
    assert wrong([likely(Fault.FIELD)], [found(Fault.BODY_FIELD)])


def test_a_velocity_that_was_found_is_wrong_while_its_slow_error_is_large():
    held = NONE._replace(velocity=2.9, climb=1.0)
    (one,) = wrong(faults=[found(Fault.VELOCITY_STEP, until=90.0)], held=held)
    assert one.sentence == "GNSS velocity 2.9 m/s off, corrected"
    assert not wrong(held=held)
    assert not wrong(faults=[found(Fault.VELOCITY_STEP)])


def test_what_nothing_shows_to_be_right_again_is_told_for_a_minute():
    for kind in (Fault.BARO_STEP, Fault.ACCEL_STEP, Fault.VELOCITY_TURN, Fault.FIELD):
        (one,) = wrong(faults=[found(kind, until=59.0)])
        assert one.is_found
        assert not wrong(faults=[found(kind, until=61.0)])
    known = Fault.DELAY, Fault.LEVER, Fault.BODY_FIELD, Fault.BARO_SCALE
    for kind in (*ENDS, *OF_NO_SIZE, *known, Fault.TILT, Fault.SETTLE):
        assert not wrong(faults=[found(kind)])


def test_a_found_fault_goes_on_beside_what_is_suspected_anew():
    held = NONE._replace(position=60.0)
    (one,) = wrong([likely(Fault.POSITION_STEP)], held=held)
    assert (one.words, one.is_found, one.unused) == ("GNSS 60 m off", True, (Aid.POSITION,))
    two = wrong([likely(Fault.VELOCITY_WILD)], held=held)
    assert [one.source for one in two] == [Source.POSITION, Source.VELOCITY]
    assert [one.unused for one in two] == [(), (Aid.VELOCITY,)]
