"""Stamps of sending brought back to the loop's turns; ArduPilot's scheduler is drawn here."""

from itertools import pairwise

import numpy as np
import pytest

from ekf_companion.mavlink.dejitter import LOOPS_US, Dejitter

SETTLED = 2000
"""Messages until it is judged: period and lateness are known."""
MS_US = 1000


def scheduled(seed, loop_us, interval_ms, mean_late_us, *, lost=0.0, overrun=0.0, count=8000):
    """Return stamps of sending and times of sampling, us, as ArduPilot's scheduler makes them.

    A turn takes its sample at its beginning and sends, later in it, what is due by whole
    milliseconds; an overrun moves all turns after it.
    """
    rng = np.random.default_rng(seed)
    begin, due = 100e6, 100_000
    stamps, samples = [], []
    while len(stamps) < count:
        begin += loop_us + (rng.uniform(0.0, loop_us) if rng.random() < overrun else 0.0)
        sent = begin + min(rng.exponential(mean_late_us), 0.96 * loop_us) if mean_late_us else begin
        if sent // MS_US >= due:
            due = max(due + interval_ms, int(sent // MS_US))
            if rng.random() >= lost:
                stamps.append(int(sent))
                samples.append(begin)
    return np.array(stamps), np.array(samples)


def smoothed(stamps, resolution_us=1):
    """Return the times of the stamps, us."""
    one = Dejitter(resolution_us)
    t_ns = [one.smooth(int(stamp)) for stamp in stamps]
    return np.array([t / 1000 for t in t_ns]), one


LOOPS = {
    "400 Hz, every second turn": (2500.0, 5, 300.0),
    "400 Hz, every fourth turn": (2500.0, 10, 400.0),
    "400 Hz, 250 Hz asked: one turn or two": (2500.0, 4, 300.0),
    "400 Hz, 83 Hz: four turns or five": (2500.0, 12, 400.0),
    "300 Hz, 200 Hz asked": (1e4 / 3.0, 5, 300.0),
    "400 Hz, 1.5 per thousand too slow a clock": (2503.75, 5, 300.0),
}


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("lost", [0.0, 0.03])
def test_samples_lie_on_the_cycles_of_the_loop(loop, lost):
    loop_us, interval_ms, late_us = LOOPS[loop]
    stamps, samples = scheduled(1, loop_us, interval_ms, late_us, lost=lost)
    t, one = smoothed(stamps)
    assert one.is_active
    assert np.diff(t).min() > 0.0
    raw, left = (stamps - samples)[SETTLED:], (t - samples)[SETTLED:]
    assert raw.std() > 0.9 * late_us * 0.8
    assert left.std() < 0.7 * raw.std()
    assert abs(left.mean()) < 0.25 * raw.mean()


@pytest.mark.parametrize("overrun", [0.001, 0.003, 0.01, 0.05])
def test_a_loop_that_overruns_is_made_no_worse(overrun):
    raw, left = [], []
    for seed in range(4):
        stamps, samples = scheduled(seed, 2500.0, 4, 300.0, overrun=overrun)
        t, _ = smoothed(stamps)
        assert np.diff(t).min() > 0.0
        raw.append((stamps - samples)[SETTLED:].std())
        left.append((t - samples)[SETTLED:].std())
    # Until the line has followed, some stamps after an overrun are set too early
    assert np.mean(left) < 1.05 * np.mean(raw)


def test_where_nothing_is_to_be_gained_no_stamp_is_touched():
    for stamps in (
        scheduled(1, 2500.0, 5, 0.0)[0],
        scheduled(1, 2500.0, 4, 0.0)[0],
        scheduled(1, 2500.0, 5, 3.0)[0],
    ):
        t, one = smoothed(stamps)
        assert not one.is_active
        assert np.array_equal(t, stamps)


@pytest.mark.parametrize("seed", range(5))
def test_where_there_is_no_period_no_stamp_is_touched(seed):
    rng = np.random.default_rng(seed)
    stamps = 10**8 + np.cumsum(rng.uniform(1000.0, 9000.0, 8000)).astype(np.int64)
    t, _ = smoothed(stamps)
    assert np.array_equal(t, stamps)


def test_whole_milliseconds_are_set_on_the_line_of_their_period():
    # As of PX4's SCALED_IMU at 225 Hz: steps of 4 and 5 ms
    samples = 1e8 + 4444.0 * np.arange(8000)
    stamps = samples // MS_US * MS_US
    t, one = smoothed(stamps, MS_US)
    assert one.is_active
    assert (stamps - samples)[SETTLED:].std() > 280.0
    left = (t - samples)[SETTLED:]
    assert left.std() < 60.0
    assert abs(left.mean() + 450.0) < 100.0  # the line goes through the ones cut down most


def test_whole_milliseconds_of_sending_are_set_on_the_loops_cycles():
    stamps, samples = scheduled(3, 2500.0, 20, 400.0)
    cut = stamps // MS_US * MS_US
    t, one = smoothed(cut, MS_US)
    assert one.is_active
    assert (t - samples)[SETTLED:].std() < 0.7 * (cut - samples)[SETTLED:].std()


@pytest.mark.parametrize("loop", LOOPS)
def test_no_stamp_is_moved_by_more_than_a_turn_nor_ahead(loop):
    loop_us, interval_ms, late_us = LOOPS[loop]
    stamps, _ = scheduled(4, loop_us, interval_ms, late_us, lost=0.05, overrun=0.002)
    t, _ = smoothed(stamps)
    moved = stamps - t
    assert moved.min() >= -0.001 * len(stamps)  # a stamp after another by a nanosecond at least
    assert moved.max() <= 1.01 * max(LOOPS_US)


def test_it_goes_on_after_a_gap_a_burst_another_rate_and_a_silence():
    parts = [
        scheduled(seed, 2500.0, interval_ms, 300.0, count=4000)
        for seed, interval_ms in ((1, 5), (2, 4), (3, 10))
    ]
    ends = [0.0, 21.0e6, 60.0e6]  # 1 s and 23 s of silence between them
    stamps = np.concatenate([part[0] + round(end) for part, end in zip(parts, ends, strict=True)])
    samples = np.concatenate([part[1] + end for part, end in zip(parts, ends, strict=True)])
    t, one = smoothed(stamps)
    assert one.is_active
    assert np.diff(t).min() > 0.0
    for begin in (0, 4000, 8000):
        settled = slice(begin + SETTLED, begin + 4000)
        raw, left = (stamps - samples)[settled], (t - samples)[settled]
        assert left.std() < 0.7 * raw.std()


def test_a_sample_that_comes_late_lies_on_the_cycle_that_it_would_have_had_in_time():
    stamps, _ = scheduled(1, 2500.0, 5, 300.0)
    one = Dejitter()
    assert one.smooth(10**8) == 10**11
    assert one.smooth(10**8 - 5) == (10**8 - 5) * 1000  # none is moved yet
    in_time = [one.smooth(stamp) for stamp in stamps.tolist()]
    assert one.is_active
    late = [one.smooth(stamp) for stamp in stamps.tolist()[-500:]]
    assert np.abs(np.subtract(late, in_time[-500:])).max() < 300_000  # as they are sent late
    assert one.smooth(stamps[-1] + 5000) > in_time[-1]


def test_stamps_depend_on_the_stamps_before_them_alone():
    stamps, _ = scheduled(1, 2500.0, 4, 300.0)
    whole = smoothed(stamps)[0]
    assert np.array_equal(whole, smoothed(stamps)[0])
    assert np.array_equal(whole[:5000], smoothed(stamps[:5000])[0])


def test_whatever_comes_it_goes_on():
    rng = np.random.default_rng(8)
    one, last = Dejitter(), -1
    for step in rng.choice([0, 1, 3, 2500, 5000, 10**6, 10**12, -(10**9)], 5000).tolist():
        stamp = max(one.last // 1000 + step, 0)
        t_ns = one.smooth(stamp)
        if t_ns is not None and step > 0:
            assert t_ns > last
            last = t_ns


def test_steps_that_were_uneven_are_even():
    """What an integral over the steps sees: dt of 5 ms and 1 in place of 5 ms."""
    stamps, _ = scheduled(6, 2500.0, 5, 300.0)
    t, _ = smoothed(stamps)
    uneven, even = (np.std([b - a for a, b in pairwise(x[SETTLED:])]) for x in (stamps, t))
    assert even < 0.75 * uneven
