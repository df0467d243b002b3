"""The autopilot's clock out of its stamps: wraps, reboots, bases, and stamps that mean nothing."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.mavlink.timebase import LAST_US, SURE_US, UNIX_FROM_US, Step, TimeBase
from ekf_companion.nav.stamps import GAP_US

UNIX_US = 1_700_000_000_000_000
WRAP_MS = 1 << 32
MS = 1_000_000
SECOND_US = 1_000_000


def at(*stamps_us):
    """Return a clock that has followed stamps."""
    clock = TimeBase()
    assert [clock.advance(stamp_us) for stamp_us in stamps_us] == [Step.FOLLOWED] * len(stamps_us)
    return clock


def steps(clock, stamps):
    """Return what each stamp does: an int is microseconds, a tuple ("ms", milliseconds)."""
    return [
        clock.advance_boot_ms(stamp[1]) if isinstance(stamp, tuple) else clock.advance(stamp)
        for stamp in stamps
    ]


def ms(boot_ms):
    return ("ms", boot_ms)


def test_boot_stamps_of_every_width_fall_on_one_clock():
    clock = at(185_139_248)
    assert clock.from_us(184_973_000) == 184_973_000_000
    assert clock.from_boot_ms(185_139) == 185_139_000_000
    assert clock.latest_ns == 185_139_248_000


def test_packets_that_overtake_one_another_are_no_restart():
    clock = at(10_000_000, 11_000_000, 10_000_001, 11_000_000, 11_000_001)
    assert clock.latest_us == 11_000_001


# Rule 12, and what is none

NOW = 4000 * SECOND_US
"""The clock has come so far, us."""
REBOOTS = {
    "inertial stamps": [SECOND_US + 4000 * n for n in range(64)],
    "inertial stamps from zero on": [4000 * n + 1 for n in range(64)],
    "milliseconds": [ms(1000 + 50 * n) for n in range(6)],
    "both": [
        stamp for n in range(26) for stamp in (SECOND_US + 10_900 + n * 10_000, ms(1010 + n * 10))
    ],
    "one message a second": [ms(1000), ms(2000)],
    "an old packet among the new": [
        *(SECOND_US, SECOND_US + 4000, NOW - 1000),
        *(SECOND_US + 8000 + 4000 * n for n in range(64)),
    ],
    "a wild stamp before it": [
        *(3 * 10**15, SECOND_US + 2),
        *(SECOND_US + 4000 + 4000 * n for n in range(64)),
    ],
    "a base that changes (Rule 11)": [UNIX_US + 4000 * n for n in range(64)],
    "a leap of more than an hour": [NOW + 2 * GAP_US + 4000 * n for n in range(64)],
    "a unix clock among milliseconds": [
        stamp for n in range(6) for stamp in (UNIX_US + 50_000 * n, ms(NOW // 1000 + 50 * n))
    ],
    "microseconds many wraps on": [
        stamp
        for n in range(6)
        for stamp in (
            (2 * WRAP_MS + NOW // 1000 + 50 * n) * 1000 + 7,
            ms(NOW // 1000 + 50 * n),
        )
    ],
}
NO_REBOOTS = {
    "one wild stamp": [NOW + 4000, 77, NOW + 8000, NOW + 12_000],
    "wild stamps at every other message": [
        stamp
        for n in range(1, 200)
        for stamp in (NOW + 4000 * n, (n * 0x9E3779B97F4A7C15) % (LAST_US + 1))
    ],
    "wild milliseconds at every other message": [
        stamp for n in range(1, 200) for stamp in (NOW + 4000 * n, ms((n * 0x9E3779B1) % WRAP_MS))
    ],
    "the same wild stamp over and over": [NOW, *[77] * 50, NOW + 4000, *[77] * 50],
    "a second way that is slower": [
        stamp for n in range(400) for stamp in (NOW + 4000 * n, NOW + 4000 * n - 2 * SECOND_US)
    ],
    "a second way that is slower, in bunches": [
        stamp
        for n in range(40)
        for stamp in (
            *(NOW + 4000 * (10 * n + k) for k in range(10)),
            *(NOW + 4000 * (10 * n + k) - 2 * SECOND_US for k in range(10)),
        )
    ],
    "a way that is slower by half a second": [
        stamp for n in range(400) for stamp in (NOW + 4000 * n, NOW + 4000 * n - SECOND_US // 2)
    ],
    "a fifth of a second of packets that were overtaken": [
        NOW + SECOND_US,
        *(NOW + SECOND_US // 2 + 4000 * n for n in range(50)),
        NOW + SECOND_US + 4000,
        NOW + SECOND_US + 8000,
    ],
    "a link that was silent for half an hour": [NOW + GAP_US // 2 + 4000 * n for n in range(9)],
    "a link that was silent for nine seconds": [NOW + 9 * SECOND_US + 4000 * n for n in range(2)],
}


@pytest.mark.parametrize("case", REBOOTS)
def test_a_clock_that_began_anew_is_believed_within_a_second_and_once(case):
    """Rule 12."""
    clock = at(NOW)
    found = steps(clock, REBOOTS[case])
    assert found.count(Step.BEGUN) == 1
    assert set(found[: found.index(Step.BEGUN)]) <= {Step.HELD, Step.FOLLOWED}
    after = found[found.index(Step.BEGUN) + 1 :]
    assert after == [Step.FOLLOWED] * len(after)
    numbers = [stamp for stamp in REBOOTS[case] if isinstance(stamp, int)]
    newest = numbers[-1] if numbers else REBOOTS[case][-1][1] * 1000
    assert abs(clock.latest_us - newest) <= 1000  # of a millisecond


@pytest.mark.parametrize("back_us", [260_000, 500_000, 999_000, 1_200_000, 1_999_000])
def test_a_clock_that_is_set_back_by_less_than_two_seconds_is_found_out_once(back_us):
    """Rule 12: too little for a reboot, and too long for packets that overtook one another."""
    clock = at(NOW)
    new = [NOW - back_us + 4000 * n for n in range(1, 200)]
    found = steps(clock, new)
    assert found.count(Step.SET) == 1
    assert 0 <= found.index(Step.SET) * 4000 - SURE_US < 4000
    assert set(found) == {Step.FOLLOWED, Step.SET}
    first = found.index(Step.SET)
    assert steps(at(new[0] - 1), new[: first + 1]) == [Step.FOLLOWED] * (first + 1)


@pytest.mark.parametrize("case", NO_REBOOTS)
def test_what_is_no_reboot_is_taken_for_none(case):
    """Rule 12: neither one wild stamp nor a packet of a slower way is the autopilot's clock."""
    clock = at(NOW)
    found = steps(clock, NO_REBOOTS[case])
    assert not {Step.BEGUN, Step.SET} & set(found)
    assert found[-1] is Step.FOLLOWED or case.startswith(("wild", "the same", "a second"))
    true = [stamp for stamp in NO_REBOOTS[case] if isinstance(stamp, int)]
    true = [stamp for stamp in true if NOW <= stamp <= NOW + GAP_US]
    assert clock.latest_us == max(true)


@pytest.mark.parametrize("way", ["advance", "advance_boot_ms", "relate"])
@pytest.mark.parametrize("ahead", [1.1, 2.0, 5.0, 10.0])
def test_one_stamp_that_is_seconds_ahead_moves_nothing(way, ahead):
    """Rule 12: nor does the true clock after it look like a reboot."""
    clock = at(NOW)
    for n in range(1, 600):
        if n % 100 == 0:
            wild_us = NOW + 4000 * n + round(ahead * SECOND_US)
            stamp = {"advance": (wild_us,), "relate": (0, wild_us // 1000)}
            assert getattr(clock, way)(*stamp.get(way, (wild_us // 1000,))) is Step.HELD
        assert clock.advance(NOW + 4000 * n) is Step.FOLLOWED
    assert clock.latest_us == NOW + 4000 * 599


@pytest.mark.parametrize("silence", [1.5, 3.0, 9.0, 60.0])
def test_a_silence_of_the_link_costs_one_message(silence):
    """Rule 12: the first stamp behind it is held back, the second goes on from it."""
    first = NOW + round(silence * SECOND_US)
    clock = at(NOW)
    found = steps(clock, [first + 4000 * n for n in range(50)])
    assert found == [Step.HELD, *[Step.FOLLOWED] * 49]


@pytest.mark.parametrize("period", [0.9, 1.0, 1.7, 5.0, 9.0])
def test_a_stream_slower_than_once_a_second_is_followed(period):
    """Rule 12: and its clock that began anew is found too."""
    period_us = round(period * SECOND_US)
    jitter_us = [0, 40_000, -30_000, 50_000, -50_000]
    clock = at(NOW)
    stamps = [NOW + period_us * n + jitter_us[n % 5] for n in range(1, 60)]
    assert steps(clock, stamps).count(Step.HELD) <= 1
    assert clock.latest_us == stamps[-1]
    assert steps(clock, [period_us * n for n in range(1, 4)])[:2] == [Step.HELD, Step.BEGUN]


@given(st.lists(st.integers(0, 2**64 - 1), max_size=30))
@settings(deadline=None, max_examples=150)
def test_wild_stamps_between_true_ones_move_nothing(wild):
    """Rule 12: whatever a field may hold, as long as the true clock speaks in between."""
    clock = at(NOW)
    for n, stamp_us in enumerate(wild):
        if abs(stamp_us - NOW) > 2 * SECOND_US:
            assert clock.advance(stamp_us) is Step.HELD
        assert clock.advance(NOW + 4000 * (n + 1)) is Step.FOLLOWED
    assert NOW <= clock.latest_us <= NOW + 4000 * (len(wild) + 1)


@pytest.mark.parametrize("later_ms", [0, 100, 18_950])
@pytest.mark.parametrize("way", ["advance", "advance_boot_ms", "relate"])
def test_every_kind_of_stamp_tells_of_a_reboot(way, later_ms):
    """Rule 12: SYSTEM_TIME.time_boot_ms, or any boot stamp."""
    clock = at(279_401_607)
    tell = {
        "advance": lambda t_ms: clock.advance(t_ms * 1000),
        "advance_boot_ms": clock.advance_boot_ms,
        "relate": lambda t_ms: clock.relate(0, t_ms),
    }[way]
    assert tell(later_ms) is Step.HELD
    assert tell(later_ms + 250) is Step.BEGUN
    assert clock.latest_us == (later_ms + 250) * 1000
    assert tell(later_ms + 254) is Step.FOLLOWED


# Rule 11: wraps


def test_milliseconds_that_wrap_go_on():
    """Rule 11."""
    clock = TimeBase()
    assert clock.advance_boot_ms(WRAP_MS - 500) is Step.FOLLOWED
    assert clock.advance_boot_ms(300) is Step.FOLLOWED
    assert clock.from_boot_ms(300) == (WRAP_MS + 300) * MS
    assert clock.from_boot_ms(WRAP_MS - 500) == (WRAP_MS - 500) * MS


def test_a_vehicle_that_runs_across_the_wrap_keeps_all_its_stamps():
    """Rule 11: milliseconds wrap, microseconds do not, and unix time is where it was."""
    clock = TimeBase()
    for t_ms in range(WRAP_MS - 3000, WRAP_MS + 3000, 100):
        assert clock.advance(t_ms * 1000 + 123) is Step.FOLLOWED
        assert clock.advance_boot_ms(t_ms % WRAP_MS) is Step.FOLLOWED
        assert clock.from_boot_ms(t_ms % WRAP_MS) == t_ms * MS
        assert clock.relate(UNIX_US + t_ms * 1000, t_ms % WRAP_MS) is Step.FOLLOWED
        assert clock.from_us(UNIX_US + t_ms * 1000) == t_ms * MS


def test_milliseconds_after_many_wraps_are_placed_by_the_microseconds():
    boot_ms = 3 * WRAP_MS + 1234
    clock = at(boot_ms * 1000)
    assert clock.from_boot_ms(1234 + 20) == (boot_ms + 20) * MS


@pytest.mark.parametrize("days", [1, 20, 39, 48, 60])
def test_a_reboot_after_long_is_told_from_a_wrap(days):
    """Rule 12: from 39 days, milliseconds near zero look like ten days ahead, across the wrap."""
    clock = at(days * 86_400 * SECOND_US)
    found = [clock.advance_boot_ms(7000 + 50 * n) for n in range(6)]
    assert found == [Step.HELD] * 5 + [Step.BEGUN]
    assert clock.latest_us == 7_250_000


# Rule 11: bases


@pytest.mark.parametrize(("before", "after"), [(5_000_000, UNIX_US), (UNIX_US, 5_000_000)])
def test_a_change_of_base_is_a_restart_and_no_step_of_fifty_years(before, after):
    """Rule 11."""
    clock = at(before)
    assert clock.advance(after) is Step.HELD
    assert clock.advance(after + SURE_US) is Step.BEGUN
    assert clock.advance(after + SURE_US + 4000) is Step.FOLLOWED
    assert clock.is_unix == (after > UNIX_FROM_US)


def test_unix_stamps_move_to_a_boot_clock_by_system_time():
    clock = at(60_000_000)
    assert clock.from_us(UNIX_US) is None
    clock.relate(0, 60_000)
    assert clock.from_us(UNIX_US) is None
    clock.relate(UNIX_US, 60_000)
    assert clock.from_us(UNIX_US + 250_000) == 60_250_000_000


def test_boot_stamps_move_to_a_unix_clock_by_system_time_and_tell_of_a_reboot():
    """Rule 12: unix time does not go back at a reboot, SYSTEM_TIME.time_boot_ms does."""
    clock = at(UNIX_US)
    assert clock.from_boot_ms(60_000) is None
    clock.relate(UNIX_US, 60_000)
    assert clock.from_boot_ms(60_250) == (UNIX_US + 250_000) * 1000
    assert clock.relate(UNIX_US + 9_000_000, 1_000) is Step.HELD
    assert clock.relate(UNIX_US + 10_000_000, 2_000) is Step.BEGUN
    assert clock.from_boot_ms(2_000) == (UNIX_US + 10_000_000) * 1000


def test_one_wild_system_time_moves_no_stamp():
    clock = at(60_000_000)
    clock.relate(UNIX_US, 60_000)
    clock.relate(UNIX_US + 10**14, 60_100)
    assert clock.from_us(UNIX_US) == 60_000_000_000
    clock.relate(UNIX_US + 200_000, 60_200)
    assert clock.from_us(UNIX_US) == 60_000_000_000
    for n in range(2):  # the receiver found out better
        clock.relate(UNIX_US + 300_000 + 10_000_000 + n, 60_300)
    assert clock.from_us(UNIX_US + 10_300_000) == pytest.approx(60_300_000_000, abs=2000)


def test_what_related_unix_time_to_the_old_clock_does_not_to_the_new():
    clock = at(100_000_000)
    clock.relate(UNIX_US, 100_000)
    assert clock.from_us(UNIX_US + 5) == 100_000_005_000
    clock.advance(2_000_000)
    assert clock.advance(2_250_000) is Step.BEGUN
    assert clock.from_us(UNIX_US + 5) is None
