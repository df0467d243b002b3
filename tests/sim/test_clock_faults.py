import pytest

from sim_autopilot.faults.clock import Clock
from sim_autopilot.faults.fault import parse

S = 1_000_000_000
ZERO = 20 * S


def clock(*texts):
    return Clock([parse(text) for text in texts], ZERO)


def test_without_faults_it_shows_the_worlds_time():
    shown = clock()
    assert [shown.shown_ns(t) for t in (0, 7, 10**15)] == [0, 7, 10**15]
    assert shown.true_ns(5 * S, 6 * S) == 5 * S
    assert not shown.is_silent(0)


def test_a_reboot_is_silent_and_begins_at_zero():
    shown = clock("reboot:start=10,duration=4")
    assert shown.shown_ns(30 * S - 1) == 30 * S - 1
    assert (shown.boot(30 * S - 1), shown.boot(30 * S)) == (0, 1)
    assert shown.is_silent(30 * S)
    assert shown.is_silent(34 * S - 1)
    assert not shown.is_silent(34 * S)
    assert shown.shown_ns(34 * S) == 4 * S
    assert shown.shown_ns(100 * S) == 70 * S


def test_a_jump_stays():
    for by in (0.5, -0.5):
        shown = clock(f"clock-jump:start=10,by={by}")
        assert shown.shown_ns(30 * S - 1) == 30 * S - 1
        assert shown.shown_ns(30 * S) == 30 * S + round(by * S)
        assert shown.shown_ns(90 * S) == 90 * S + round(by * S)


def test_skew_ends_and_what_was_gained_stays():
    shown = clock("clock-skew:start=10,duration=20,ppm=100")
    assert shown.shown_ns(30 * S) == 30 * S
    assert shown.shown_ns(40 * S) == pytest.approx(40 * S + 1_000_000, abs=1)
    assert shown.shown_ns(50 * S) - 50 * S == pytest.approx(2_000_000, abs=1)
    assert shown.shown_ns(90 * S) - 90 * S == pytest.approx(2_000_000, abs=1)


@pytest.mark.parametrize(
    "texts",
    [
        ("reboot:start=10,duration=4",),
        ("clock-jump:start=10,by=0.5",),
        ("clock-jump:start=10,by=-0.5",),
        ("clock-skew:start=10,duration=20,ppm=500",),
        ("clock-jump:start=10,by=3", "reboot:start=20", "clock-skew:start=40", "reboot:start=50"),
    ],
)
def test_a_stamp_is_found_again_on_the_worlds_clock(texts):
    shown = clock(*texts)
    for t in range(21 * S, 120 * S, S // 7):
        found = shown.true_ns(shown.shown_ns(t), t + 5_000_000)
        assert abs(found - t) < 10, t


def test_what_was_stamped_before_a_reboot_and_comes_after_it_is_of_before():
    shown = clock("reboot:start=10,duration=4")
    assert shown.true_ns(30 * S - S // 100, 30 * S + S // 100) == 30 * S - S // 100
