"""The autopilot's clock out of its stamps, and TIMESYNC between two clocks that differ."""

import numpy as np
import pytest

from ekf_companion.mavlink.clock import TimeBase, Timesync, TimesyncOptions

UNIX_US = 1_700_000_000_000_000
WRAP_MS = 1 << 32
MS = 1_000_000


def test_boot_stamps_of_every_width_fall_on_one_clock():
    clock = TimeBase()
    assert not clock.advance(185_139_248)
    assert clock.from_us(184_973_000) == 184_973_000_000
    assert clock.from_boot_ms(185_139) == 185_139_000_000
    assert clock.latest_ns == 185_139_248_000


def test_packets_that_overtake_one_another_are_no_restart():
    clock = TimeBase()
    for stamp_us in (10_000_000, 12_000_000, 11_000_001, 12_000_000):
        assert not clock.advance(stamp_us)
    assert clock.latest_us == 12_000_000


@pytest.mark.parametrize("later_ms", [0, 100, 18_950])
def test_a_clock_that_goes_back_by_more_than_a_second_began_anew(later_ms):
    for restart in ("advance", "advance_boot_ms", "relate"):
        clock = TimeBase()
        clock.advance(279_401_607)
        is_new = {
            "advance": lambda c=clock: c.advance(later_ms * 1000),
            "advance_boot_ms": lambda c=clock: c.advance_boot_ms(later_ms),
            "relate": lambda c=clock: c.relate(0, later_ms),
        }[restart]()
        assert is_new
        assert clock.latest_us == later_ms * 1000
        assert not clock.advance(later_ms * 1000 + 4000)


def test_milliseconds_that_wrap_go_on():
    clock = TimeBase()
    assert not clock.advance_boot_ms(WRAP_MS - 500)
    assert not clock.advance_boot_ms(300)
    assert clock.from_boot_ms(300) == (WRAP_MS + 300) * MS
    assert clock.from_boot_ms(WRAP_MS - 500) == (WRAP_MS - 500) * MS


def test_milliseconds_after_many_wraps_are_placed_by_the_microseconds():
    clock = TimeBase()
    boot_ms = 3 * WRAP_MS + 1234
    clock.advance(boot_ms * 1000)
    assert clock.from_boot_ms(1234 + 20) == (boot_ms + 20) * MS


def test_a_restart_after_a_wrap_is_told_from_the_next_wrap():
    clock = TimeBase()
    clock.advance((WRAP_MS + 50_000) * 1000)
    assert clock.advance_boot_ms(7_000)
    assert clock.latest_us == 7_000_000


@pytest.mark.parametrize(("before", "after"), [(5_000_000, UNIX_US), (UNIX_US, 5_000_000)])
def test_a_change_of_base_is_a_restart_and_no_step_of_fifty_years(before, after):
    clock = TimeBase()
    clock.advance(before)
    assert clock.advance(after)
    assert not clock.advance(after + 4000)


def test_unix_stamps_move_to_a_boot_clock_by_system_time():
    clock = TimeBase()
    clock.advance(60_000_000)
    assert clock.from_us(UNIX_US) is None
    clock.relate(0, 60_000)
    assert clock.from_us(UNIX_US) is None
    clock.relate(UNIX_US, 60_000)
    assert clock.from_us(UNIX_US + 250_000) == 60_250_000_000


def test_boot_stamps_move_to_a_unix_clock_by_system_time():
    clock = TimeBase()
    clock.advance(UNIX_US)
    assert clock.from_boot_ms(60_000) is None
    clock.relate(UNIX_US, 60_000)
    assert clock.from_boot_ms(60_250) == (UNIX_US + 250_000) * 1000
    assert clock.relate(UNIX_US + 9_000_000, 1_000)


def exchange(ours, offset_at, at_ns, there_ns, back_ns):
    """Ask at a time of ours if it is due; the answer comes after the way there and back."""
    ts1 = ours.request(at_ns)
    if ts1 is not None:
        ours.receive(
            at_ns + there_ns + offset_at(at_ns + there_ns), ts1, at_ns + there_ns + back_ns
        )
    return ts1


def test_two_clocks_that_drift_are_compared_to_the_delay_of_the_link():
    rng = np.random.default_rng(5)
    offset, skew = -123_456_789_012, 40e-6

    def offset_at(now_ns):
        return offset + round(skew * now_ns)

    ours = Timesync()
    for at_ns in range(0, 120_000 * MS, 50 * MS):
        there, back = (int(ns) for ns in 200_000 + rng.exponential(300_000, 2))
        exchange(ours, offset_at, at_ns, there, back)
    assert ours.is_locked
    assert abs(ours.skew - skew) < 5e-6  # 0.1 ms over half a minute
    assert abs(ours.peer_ns(at_ns) - at_ns - offset_at(at_ns)) < 150_000  # the jitter of the way


def test_answers_that_waited_on_one_way_do_not_move_the_offset():
    rng = np.random.default_rng(6)
    ours = Timesync()
    for at_ns in range(0, 60_000 * MS, 50 * MS):
        waited = 8 * MS if rng.random() < 0.3 else 0
        exchange(ours, lambda _: 77 * MS, at_ns, MS // 2, MS // 2 + waited)
    assert ours.peer_ns(at_ns) == at_ns + 77 * MS


def test_it_asks_ten_times_a_second_until_locked_then_once():
    ours = Timesync()
    asked = [
        at_ns
        for at_ns in range(0, 10_000 * MS, 10 * MS)
        if exchange(ours, lambda _: 5, at_ns, MS, MS) is not None
    ]
    assert ours.is_locked
    assert np.diff(asked)[:19].tolist() == [100 * MS] * 19
    assert np.diff(asked)[20:].tolist() == [1000 * MS] * (len(asked) - 21)


def test_nothing_is_answered_before_the_lock_and_then_in_the_autopilots_time():
    ours = Timesync()
    assert ours.answer(77, 5 * MS) is None
    for at_ns in range(0, 3000 * MS, 100 * MS):
        exchange(ours, lambda _: 1_000_000_007, at_ns, MS, MS)
    assert ours.answer(77, 4000 * MS) == 4000 * MS + 1_000_000_007
    silent = Timesync(TimesyncOptions(respond=False))
    assert silent.answer(77, 4000 * MS) is None


def test_answers_to_others_and_slow_ones_are_counted_and_left():
    ours = Timesync()
    ours.receive(1, 12345, 10)
    assert ours.foreign == 1
    ts1 = ours.request(0)
    ours.receive(1, ts1, 11 * MS)
    assert ours.slow == 1
    ours.receive(1, ts1, 1 * MS)
    assert ours.foreign == 2
    assert not ours.is_locked


def test_an_answer_that_holds_no_time_is_left():
    ours = Timesync()
    for at_ns in range(0, 4000 * MS, 100 * MS):
        exchange(ours, lambda _: 2**63 - 10**11, at_ns, MS, MS)
    assert not ours.is_locked
    assert ours.foreign == 40


def test_no_more_than_sixteen_questions_are_open():
    ours = Timesync()
    asked = [ours.request(n * 100 * MS) for n in range(20)]
    ours.receive(1, asked[3], asked[3] + MS)
    assert ours.foreign == 1
    ours.receive(1, asked[4], asked[4] + MS)
    assert ours.foreign == 1


def test_a_peers_clock_that_jumps_is_learned_anew_after_five_answers():
    ours = Timesync()
    for at_ns in range(0, 3000 * MS, 100 * MS):
        exchange(ours, lambda _: 0, at_ns, MS, MS)
    for at_ns in range(4000 * MS, 8000 * MS, 1000 * MS):
        exchange(ours, lambda _: 900 * MS, at_ns, MS, MS)
        assert ours.peer_ns(at_ns) == at_ns
    for at_ns in range(8000 * MS, 15_000 * MS, 100 * MS):
        exchange(ours, lambda _: 900 * MS, at_ns, MS, MS)
    assert ours.peer_ns(at_ns) == at_ns + 900 * MS


def test_what_related_unix_time_to_the_old_clock_does_not_to_the_new():
    clock = TimeBase()
    unix_us = 1_700_000_000_000_000
    clock.advance(100_000_000)
    clock.relate(unix_us, 100_000)
    assert clock.from_us(unix_us + 5) == 100_000_005_000
    assert clock.advance(2_000_000)
    assert clock.from_us(unix_us + 5) is None
