"""Of several clocks in a log the one with most rows is read; a damaged stamp costs its own row."""

import numpy as np
import pytest

from ekf_companion.logs import clock_run
from ekf_companion.mavlink.timebase import Step, TimeBase

SECOND = 1_000_000_000
WRAP_US = 1 << 32
STEADY = np.arange(1, 30_000, dtype=np.int64) * SECOND // 100
"""Five minutes at 100 Hz."""


def moved(by_s, begin=15_000, end=None):
    """Return the steady clock with some of its stamps moved."""
    t_ns = STEADY.copy()
    t_ns[begin:end] += round(by_s * SECOND)
    return t_ns


def test_a_steady_clock_is_one_run():
    t_ns = np.arange(100, dtype=np.int64) * SECOND
    mask, spans = clock_run.of_stamps(t_ns)
    assert mask.all()
    assert spans == [(0, 99 * SECOND)]


def test_single_wild_stamps_are_left_out_and_the_rest_stays_whole():
    t_ns = np.arange(1000, dtype=np.int64) * SECOND
    t_ns[100], t_ns[500] = 10**17, -(10**17)
    mask, _ = clock_run.of_stamps(t_ns)
    assert np.flatnonzero(~mask).tolist() == [100, 500]


def test_after_a_reboot_the_longer_run_counts():
    first, second = np.arange(100), np.arange(300)
    t_ns = np.concatenate([first, second]).astype(np.int64) * SECOND
    mask, spans = clock_run.of_stamps(t_ns)
    assert not mask[:100].any()
    assert mask[100:].all()
    assert spans == [(0, 299 * SECOND)]


def test_a_long_gap_does_not_end_the_run():
    t_ns = np.concatenate([np.arange(100), 5000 + np.arange(100)]).astype(np.int64) * SECOND
    mask, spans = clock_run.of_stamps(t_ns)
    assert mask.all()
    assert len(spans) == 2


def test_stamps_all_over_the_place_leave_something_and_end_soon():
    t_ns = np.random.default_rng(1).integers(0, 2**62, 100_000)
    mask, _ = clock_run.of_stamps(t_ns)
    assert 0 < mask.sum() < 1000


def test_no_rows_have_no_run():
    mask, spans = clock_run.of_stamps(np.zeros(0, dtype=np.int64))
    assert len(mask) == 0
    assert spans == []


def test_many_pieces_between_silences_are_one_run():
    """Each holds less than a hundredth of the rows."""
    pieces = [STEADY[:300] + piece * 100 * SECOND for piece in range(150)]
    mask, spans = clock_run.of_stamps(np.concatenate(pieces))
    assert mask.all()
    assert spans == [(int(pieces[0][0]), int(pieces[-1][-1]))]


@pytest.mark.parametrize("place", [0, 15_000, -1])
@pytest.mark.parametrize("by_s", [-2000, 30, 1200, 4000])
def test_one_row_far_from_all_others_is_damage_wherever_it_stands(place, by_s):
    t_ns = STEADY + 3000 * SECOND
    t_ns[place] += by_s * SECOND
    mask, spans = clock_run.of_stamps(t_ns)
    assert np.flatnonzero(~mask).tolist() == [place % len(t_ns)]
    assert spans == [(int(t_ns[mask][0]), int(t_ns[mask][-1]))]


@pytest.mark.parametrize("rows", [20, 250, 2000])
@pytest.mark.parametrize("by_s", [-100, 5, 30, 1200, 10**6])
def test_rows_that_are_wrong_alike_cost_themselves(rows, by_s):
    mask, _ = clock_run.of_stamps(moved(by_s, 15_000, 15_000 + rows))
    assert np.flatnonzero(~mask).tolist() == [*range(15_000, 15_000 + rows)]


@pytest.mark.parametrize("each", [2, 5, 50, 400])
@pytest.mark.parametrize("by_s", [-100, 30, 10**6])
def test_rows_that_are_wrong_alike_again_and_again_cost_themselves(each, by_s):
    """They cost 95 of 100 right ones: each of them went on from the last, over the right ones."""
    t_ns = STEADY + 200 * SECOND
    t_ns[1000::each] += by_s * SECOND
    mask, _ = clock_run.of_stamps(t_ns)
    assert np.flatnonzero(~mask).tolist() == [*range(1000, len(t_ns), each)]


def test_a_third_of_the_rows_of_a_long_log_may_be_wrong_alike():
    t_ns = np.arange(1, 300_000, dtype=np.int64) * SECOND // 400
    is_wrong = np.arange(len(t_ns)) % 3 == 1
    t_ns[is_wrong] += 10**6 * SECOND
    mask, _ = clock_run.of_stamps(t_ns)
    assert np.array_equal(mask, ~is_wrong)


def test_of_two_boots_with_silences_no_mixture_is_read():
    first = np.concatenate([STEADY[:2000], STEADY[:1000] + 40 * SECOND])
    second = np.concatenate([STEADY[:600], STEADY[:2000] + 70 * SECOND])
    mask, _ = clock_run.of_stamps(np.concatenate([first, second]))
    assert np.flatnonzero(mask).tolist() == [*range(3000)]


@pytest.mark.parametrize("period", [15, 45, 600])
def test_rows_that_come_seldom_are_all_of_the_run(period):
    mask, spans = clock_run.of_stamps(np.arange(1, 300, dtype=np.int64) * period * SECOND)
    assert mask.all()
    assert len(spans) == 1


@pytest.mark.parametrize(
    ("by_s", "clocks"),
    [(-1.9, 1), (-2.1, 2), (-149, 2), (0.5, 1), (9, 1), (60, 1), (3500, 1), (3700, 2), (1e9, 2)],
)
def test_a_log_is_cut_where_the_live_clock_begins_anew(by_s, clocks):
    """One rule: but what lies later is kept, for a log that was switched off went on."""
    t_ns = moved(by_s)
    live = TimeBase()
    found = [live.advance(t_us) for t_us in (t_ns // 1000).tolist()]
    assert found.count(Step.BEGUN) == clocks - 1
    mask, spans = clock_run.of_stamps(t_ns)
    assert mask.all() == (clocks == 1 or by_s > 0)
    assert len(spans) == (clocks if by_s > 0 else 1)


@pytest.mark.parametrize("per_count", [1000, 1_000_000])
@pytest.mark.parametrize("parts", [1, 7])
def test_a_counter_of_32_bits_that_goes_round_goes_on(per_count, parts):
    period = WRAP_US * per_count
    t_ns = 3 * period - 150 * SECOND + STEADY
    t_ns[14_990:15_010] = t_ns[14_990:15_010][::-1]  # late ones at the wrap
    unwinder = clock_run.Unwinder(per_count)
    found = np.concatenate([unwinder.take(one) for one in np.array_split(t_ns % period, parts)])
    assert np.array_equal(found, t_ns - 2 * period)


@pytest.mark.parametrize(
    "t_ns",
    [
        moved(-149),
        moved(4200),
        moved(WRAP_US * 1e-6 + 100.0),
        np.append(STEADY + 5000 * SECOND, STEADY + 705 * SECOND),
        np.random.default_rng(1).integers(0, 2**62, 1000),
    ],
    ids=["reboot", "gap", "beyond 32 bits", "reboot after more than 32 bits", "wild"],
)
def test_other_steps_are_no_turn_of_a_counter(t_ns):
    assert np.array_equal(clock_run.Unwinder(1000).take(t_ns), t_ns)
