"""What an autopilot makes of the stamps of another computer."""

import random

from sim_autopilot.arrival import LeastDelay, Timesync

MS = 1000


def delays(delay_us, count=300):
    """Return how late ArduPilot takes messages for true that come so late, in us."""
    arrival, found = LeastDelay(), []
    for k in range(count):
        stamp = k * 33 * MS
        found.append(arrival.stamp_us(stamp, stamp + delay_us(k)) - stamp)
    return found


def test_a_constant_delay_goes_unnoticed():
    assert set(delays(lambda k: 200 * MS)) == {200 * MS}


def test_of_an_uneven_delay_the_least_is_taken():
    rng = random.Random(1)
    late = delays(lambda k: 20 * MS + rng.randrange(50 * MS))
    assert max(late[20:]) < 30 * MS


def test_what_is_older_than_half_a_second_is_taken_for_half_a_second_old():
    late = delays(lambda k: 10 * MS * k)
    # Each hundred messages it takes the least of them for none
    assert late[99] == 990 * MS - 500 * MS
    assert late[250] > 1500 * MS


def test_px4_takes_the_arrival_until_it_has_learnt_the_clock():
    arrival = Timesync()
    assert arrival.stamp_us(1000, 77_000) == 77_000
    for k in range(500):
        now = k * 100 * MS
        arrival.answer(now, now + 2 * MS + 5_000_000, now + 4 * MS)
    assert arrival.stamp_us(5_060_000, 77_000) == 60_000


def test_px4_learns_nothing_from_a_slow_answer():
    arrival = Timesync()
    for k in range(600):
        now = k * 100 * MS
        arrival.answer(now, now, now + 10 * MS)
    assert arrival.count == 0
