"""Reasons of a status: which comes first, and for how long."""

import numpy as np
import pytest

from ekf_companion.nav.reason import (
    NONE,
    ORDER,
    WORDS,
    add_seconds,
    foremost,
    foremost_of,
    from_names,
    names,
    seconds_by_reason,
    to_names,
    to_words,
)
from ekf_companion.nav.state import COLUMNS, Reason, Status, Table


def table(rows, step_ns=100_000_000):
    """Return estimates a tenth of a second apart, of pairs of status and reasons."""
    values = np.zeros((len(rows), len(COLUMNS) - 1))
    for name, column in zip(("status", "reasons"), zip(*rows, strict=True), strict=True):
        values[:, COLUMNS.index(name) - 1] = column
    return Table(stamp_ns=np.arange(len(rows)) * step_ns, values=values)


def test_every_reason_has_a_place_and_words_of_its_own():
    assert sorted(ORDER) == sorted(Reason)
    assert len(set(WORDS.values())) == len(Reason)


def test_what_is_wrong_comes_before_what_follows_from_it():
    held = Reason.UNAIDED | Reason.POSITION_REFUSED | Reason.HEIGHT_MISSING
    assert foremost(held) is Reason.POSITION_REFUSED
    assert foremost(0) == NONE
    expected = [0, Reason.POSITION_REFUSED, 0]
    assert foremost_of(np.array([0.0, float(held), np.nan])).tolist() == expected


@pytest.mark.parametrize("seed", range(5))
def test_the_reasons_of_a_status_add_up_to_its_seconds_however_they_overlap(seed):
    rng = np.random.default_rng(seed)
    status = rng.integers(Status.OK, Status.INVALID + 1, 2000)
    reasons = np.where(status == Status.OK, 0, rng.integers(1, 1 << len(Reason), 2000))
    given = table(list(zip(status, reasons, strict=True)))
    found = seconds_by_reason(given)
    for each in (Status.OK, Status.DEGRADED, Status.DEAD_RECKONING, Status.INVALID):
        assert sum(found[each].values()) == pytest.approx(
            0.1 * np.count_nonzero(status[1:] == each)
        )
    assert found[Status.OK].keys() == {NONE}
    assert NONE not in found[Status.DEGRADED]
    # block by block, as a log is read, one row of the last block before each
    total = {}
    for first in range(0, 2000, 300):
        add_seconds(total, seconds_by_reason(given, slice(max(first - 1, 0), first + 300)))
    for each, by_reason in found.items():
        assert total[each] == pytest.approx(by_reason)


def test_a_pause_and_a_step_back_are_charged_to_nothing():
    given = table([(Status.DEGRADED, Reason.GAP)] * 4)
    given.stamp_ns[:] = [0, 1_000_000_000, 9_000_000_000, 8_000_000_000]
    assert seconds_by_reason(given) == {Status.DEGRADED: {Reason.GAP: 1.0}}


def test_seconds_in_words_and_for_json():
    spent = {NONE: 3.0, Reason.COMPASS_MISSING: 3.04, Reason.CLIMB_BARO: 180.2}
    assert to_words(spent) == "barometer against GNSS height 180 s; no compass 3.0 s"
    assert to_words({NONE: 5.0}) == ""
    assert to_names(spent) == {"compass_missing": 3.04, "climb_baro": 180.2}


def test_a_set_of_reasons_is_text_and_back():
    held = Reason.HEIGHT_REFUSED | Reason.CLIMB_BARO
    assert names(held) == "climb_baro+height_refused"
    assert from_names(names(held)) == held
    assert from_names(names(0)) == 0
