"""The tape: what becomes of a record by what was drawn anew since the one before."""

import ctypes

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_ATT, E_BARO, E_VEL, Link, Mode
from ekf_companion.core.memory.scratch import Scratch, TapeRecord
from tests.core.interpreted import load
from tests.core.states import a_state


def a_tape(length: int = 8):
    """Return working memory with an empty tape, and the records that it is written to."""
    records = (TapeRecord * length)()
    w = Scratch()
    w.tape.record = ctypes.cast(records, ctypes.POINTER(TapeRecord))
    w.tape.is_on = 1
    return w, records


@pytest.mark.parametrize(
    ("redrawn", "before", "link"),
    [
        ([], Mode.NAVIGATE, Link.SAME),
        ([E_BARO], Mode.NAVIGATE, Link.FRESH),
        ([E_VEL, E_BARO], Mode.NAVIGATE, Link.FRESH),
        ([E_ATT + 2], Mode.NAVIGATE, Link.CUT),
        ([E_BARO, E_ATT], Mode.NAVIGATE, Link.CUT),
        ([], Mode.LEVEL, Link.CUT),
    ],
)
def test_the_link_says_what_can_be_told_backwards(redrawn, before, link):
    w, records = a_tape()
    x, tape = a_state(1), load().tape
    x.mode = before
    tape.record_event(x, w)
    x.mode = Mode.NAVIGATE
    for place in redrawn:
        x.redrawn[place] += 1.0
    tape.record_sample(x, w)
    assert w.tape.length == 2
    assert [records[0].link, records[1].link] == [Link.CUT, link]
    assert [records[0].is_sample, records[1].is_sample] == [0.0, 1.0]


def test_a_record_keeps_the_state_of_its_time():
    w, records = a_tape()
    x, tape = a_state(1), load().tape
    north = x.pos_n[0]
    tape.record_event(x, w)
    x.pos_n[0] += 5.0
    tape.record_event(x, w)
    assert [records[0].state.pos_n[0], records[1].state.pos_n[0]] == [north, north + 5.0]


def test_a_gap_moves_nothing():
    w, records = a_tape()
    load().tape.record_gap(a_state(1), w)
    assert records[0].link == Link.MOVED
    np.testing.assert_array_equal(np.array(records[0].Phi), np.eye(len(records[0].Phi)))
