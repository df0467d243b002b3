import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.core.memory.enums import E_BA, E_BARO, E_BG, E_DELAY, E_IRON, Mode, Reset
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.memory.scratch import OUT
from ekf_companion.core.order.timeline import Timeline
from ekf_companion.core.settings.from_settings import delays_ns, parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Arrival
from ekf_companion.nav.measurements import Events, Kind
from tests.core.flights import flight
from tests.core.interpreted import load

WINDOW_NS = 2_000_000_000


def a_timeline(kind=Timeline, **options) -> Timeline:
    told = FilterSettings()
    late = delays_ns(told, "unknown", 0.12)
    return kind(parameters(told, "unknown"), late, WINDOW_NS, **options)


def put(timeline, events: Events) -> list[Arrival]:
    return [
        Arrival(timeline.insert(t, kind, values))
        for t, kind, values in zip(
            events.t_ns.tolist(), events.kind.tolist(), events.values, strict=True
        )
    ]


def some_events(seconds: float = 6.0, rate: float = 100.0) -> Events:
    events, _ = flight("figure-eight", duration=12.0, rate=rate)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    return events.take(t < seconds)


def settled(timeline, events: Events) -> bytes:
    """Put events in, then one more sample so that all have been stepped through."""
    put(timeline, events)
    last = int(events.t_ns.max()) + 10_000_000
    timeline.insert(last, Kind.IMU, np.array([0.0] * 5 + [-9.8] + [0.0] * 7))
    return timeline.block().tobytes()


IN_ORDER = settled(a_timeline(), some_events())


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.0, 1.9))
def test_any_order_of_arrival_inside_the_window_gives_the_same_bits(seed, reach):
    events = some_events()
    delay = np.random.default_rng(seed).uniform(0.0, reach * 1e9, len(events))
    shuffled = events.take(np.argsort(events.t_ns + delay, kind="stable"))
    assert settled(a_timeline(), shuffled) == IN_ORDER


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), late=st.floats(0.02, 0.3), farther=st.floats(0.3, 1.7))
def test_a_late_stream_and_events_far_behind_it_give_the_same_bits(seed, late, farther):
    # Each kind comes steadily late: the next one is expected. Now and then one comes from far back.
    events = some_events()
    rng = np.random.default_rng(seed)
    delay = np.where(events.kind == Kind.IMU, 0.0, late) + rng.uniform(0.0, 0.012, len(events))
    delay[rng.choice(len(events), 30)] = farther
    shuffled = events.take(np.argsort(events.t_ns + delay * 1e9, kind="stable"))
    assert settled(a_timeline(), shuffled) == IN_ORDER


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_duplicates_change_nothing(seed):
    rng = np.random.default_rng(seed)
    events = some_events()
    again = rng.choice(len(events), 200)
    index = np.concatenate([np.arange(len(events)), again])
    arrival = np.concatenate([events.t_ns, events.t_ns[again] + rng.uniform(0.0, 1.5e9, 200)])
    assert settled(a_timeline(), events.take(index[np.argsort(arrival, kind="stable")])) == IN_ORDER


def test_small_memory_gives_the_same_bits():
    events = some_events()
    rng = np.random.default_rng(3)
    late = events.take(np.argsort(events.t_ns + rng.uniform(0.0, 1e9, len(events)), kind="stable"))
    assert settled(a_timeline(capacity=1024), late) == IN_ORDER


@pytest.mark.campaign
def test_interpreted_and_compiled_agree_to_the_last_bit():
    events = some_events(3.5, rate=50.0)
    rng = np.random.default_rng(4)
    late = events.take(np.argsort(events.t_ns + rng.uniform(0.0, 1e8, len(events)), kind="stable"))
    late = with_clock_set_back(with_stray(late, 300_000_000), 500_000_000)
    ends = []
    for kind in (Timeline, load().timeline.Timeline):
        timeline = a_timeline(kind)
        arrivals = put(timeline, late)
        ends.append((arrivals, timeline.block().tobytes(), timeline.describe().tobytes()))
    assert as_state(np.frombuffer(ends[0][1]).copy()).mode == Mode.NAVIGATE
    assert ends[0] == ends[1]


def with_stray(events: Events, ahead_ns: int) -> Events:
    """Return events of which an inertial sample after 2.5 s is stamped ahead."""
    stamps = events.t_ns.copy()
    stamps[stray(events)] += ahead_ns
    return Events(t_ns=stamps, kind=events.kind, values=events.values)


def stray(events: Events) -> int:
    """Return the row of that sample."""
    is_late = events.t_ns > events.t_ns.min() + 2_500_000_000
    return int(np.flatnonzero((events.kind == Kind.IMU) & is_late)[0])


def with_clock_set_back(events: Events, by_ns: int) -> Events:
    """Return events whose clock goes back once, in flight."""
    is_late = events.t_ns > events.t_ns[0] + 2_500_000_000
    return Events(t_ns=events.t_ns - by_ns * is_late, kind=events.kind, values=events.values)


@pytest.mark.parametrize("ahead_ns", [150_000_000, 900_000_000, 1_500_000_000])
def test_a_sample_that_is_stamped_ahead_is_as_good_as_lost(ahead_ns):
    events = some_events()
    without = events.take(np.arange(len(events)) != stray(events))
    timeline = a_timeline()
    assert settled(timeline, with_stray(events, ahead_ns)) == settled(a_timeline(), without)
    assert timeline.arrivals[Kind.IMU, Arrival.STRAY] == 1
    assert timeline.arrivals[Kind.IMU, Arrival.HELD] == 0


@pytest.mark.parametrize("by_ns", [100_000_000, 500_000_000, 1_500_000_000])
def test_a_clock_that_is_set_back_is_found_out_by_the_samples_themselves(by_ns):
    """Every sample is used, and old and new ones do not interleave."""
    events = some_events()
    timeline = a_timeline()
    arrivals = put(timeline, with_clock_set_back(events, by_ns))
    x = as_state(timeline.block())
    assert (x.resets, x.reset_reason) == (1.0, Reset.CLOCK)
    assert x.samples == np.count_nonzero(events.kind == Kind.IMU)
    # the last of eight that are behind tells
    held = [kind for kind, a in zip(events.kind, arrivals, strict=True) if a == Arrival.TAKEN]
    assert held.count(Kind.IMU) == 7


@pytest.mark.parametrize("slower_ns", [800_000_000, 1_600_000_000])
def test_samples_that_a_slower_path_has_between_those_that_were_heard_are_late(slower_ns):
    events = some_events(12.0)
    is_imu = events.kind == Kind.IMU
    own = is_imu & (np.cumsum(is_imu) % 2 == 0)
    change_ns = events.t_ns[0] + 9_000_000_000
    arrival = events.t_ns + slower_ns * own
    is_heard = np.where(own, arrival >= change_ns, ~is_imu | (events.t_ns < change_ns))
    order = np.argsort(arrival, kind="stable")
    timeline, direct = a_timeline(), a_timeline()
    put(timeline, events.take(order[is_heard[order]]))
    put(direct, events)
    x, y = as_state(timeline.block()), as_state(direct.block())
    assert timeline.resets == 0
    assert abs(np.array(x.pos_n) - np.array(y.pos_n)).max() < 0.1
    assert abs(np.array(x.q_nb) - np.array(y.q_nb)).max() < 0.005


def test_what_is_late_for_certain_sets_no_clock_however_alike_all_samples_are():
    timeline = a_timeline()
    at_rest = np.array([0.0] * 5 + [-9.8] + [0.0] * 7)
    for i in range(300):
        timeline.insert(10_000_000 * i, Kind.IMU, at_rest)
    at_rest[10] = 1.0
    for i in range(200, 300):
        timeline.insert(10_000_000 * i - 5_000_000, Kind.IMU, at_rest)
    assert timeline.resets == 0


def test_no_burst_of_late_samples_is_taken_for_a_clock_that_was_set_back():
    events = some_events()
    imu = np.flatnonzero(events.kind == Kind.IMU)
    arrival = events.t_ns.astype(float)
    arrival[imu[200:300:2]] += 1.1e9  # every other one, a second and a bunch later
    late = events.take(np.argsort(arrival, kind="stable"))
    timeline = a_timeline()
    assert settled(timeline, late) == IN_ORDER
    assert timeline.resets == 0


def test_a_table_and_one_event_at_a_time_give_the_same_estimates():
    events = some_events()
    whole, single = a_timeline(), a_timeline()
    samples = np.count_nonzero(events.kind == Kind.IMU)
    stamps, out = np.zeros(samples, dtype=np.int64), np.zeros((samples, OUT))
    assert whole.run_log(events.t_ns, events.kind, events.values, stamps, out) == samples
    rows = []
    for t, kind, values in zip(
        events.t_ns.tolist(), events.kind.tolist(), events.values, strict=True
    ):
        if single.insert(t, kind, values) == Arrival.ESTIMATED:
            rows.append(single.describe())
    assert np.array(rows).tobytes() == out.tobytes()


def test_too_small_a_memory_shortens_the_window_and_nothing_else():
    events = some_events()
    assert settled(a_timeline(capacity=128), events) == IN_ORDER


def test_what_is_older_than_the_window_is_stale_and_changes_nothing():
    events = some_events()
    timeline = a_timeline()
    put(timeline, events)
    before = timeline.block().tobytes()
    fix = events.take(events.kind == Kind.GNSS)
    assert timeline.insert(int(fix.t_ns[0]), Kind.GNSS, fix.values[0] + 1e-9) == Arrival.STALE
    assert timeline.block().tobytes() == before


def test_what_no_sensor_can_say_is_refused_and_changes_nothing():
    events = some_events()
    timeline = a_timeline()
    put(timeline, events)
    before = timeline.block().tobytes()
    now = int(events.t_ns[-1])
    for kind in Kind:
        if kind == Kind.RESTART:
            continue
        good = events.values[events.kind == kind]
        row = good[-1] if len(good) else np.array([1.0] + [0.0] * 12)
        for column in range(3 if kind in (Kind.MAG, Kind.GNSS) else 1):
            for bad in (np.nan, np.inf, -np.inf, 1e30):
                values = row.copy()
                values[column] = bad
                if kind == Kind.VEHICLE and bad is not np.nan:
                    continue
                assert timeline.insert(now, kind, values) == Arrival.MALFORMED, (kind, column, bad)
    assert timeline.insert(now, 99, events.values[-1]) == Arrival.MALFORMED
    assert timeline.insert(now, -1, events.values[-1]) == Arrival.MALFORMED
    assert timeline.block().tobytes() == before


def test_a_clock_that_went_back_is_found_out_by_the_samples_themselves():
    events = some_events()
    timeline = a_timeline()
    put(timeline, events)
    back = Events(t_ns=events.t_ns - 3_600_000_000_000, kind=events.kind, values=events.values)
    arrivals = put(timeline, back)
    assert Arrival.STALE in arrivals
    assert arrivals[-1] is not Arrival.STALE
    assert as_state(timeline.block()).resets >= 1


def test_a_restart_before_anything_was_learnt_forgets_all_but_the_count_of_resets():
    events = some_events(0.5)
    timeline = a_timeline()
    put(timeline, events)
    assert timeline.insert(0, Kind.RESTART, np.zeros(13)) == Arrival.RESTARTED
    fresh = a_timeline()
    assert settled(timeline, events) != settled(fresh, events)
    a, b = timeline.block(), fresh.block()
    for block in (a, b):
        as_state(block).resets = as_state(block).reset_reason = 0.0
    assert a.tobytes() == b.tobytes()


def test_a_clock_that_is_set_moves_the_stamps_and_counts_as_a_reset():
    """Whatever the clock shows from some sample on, the estimate is the same, and less sure."""
    events = some_events().take(np.flatnonzero(some_events().kind == Kind.IMU))
    regular = events.t_ns[0] + np.arange(len(events)) * 10_000_000
    half = len(events) // 2
    straight, moved = a_timeline(), a_timeline()
    for timeline, by in ((straight, 0), (moved, -500_000_000)):
        for n, values in enumerate(events.values):
            if n == half and by:
                goes_on = np.array([1.0] + [0.0] * 12)
                assert timeline.insert(0, Kind.RESTART, goes_on) == Arrival.RESTARTED
            stamp = int(regular[n]) + (by if n >= half else 0)
            arrival = timeline.insert(stamp, Kind.IMU, values)
            is_judged = by and half <= n < half + 7  # eight show that it is no second path
            assert arrival == (Arrival.TAKEN if is_judged else Arrival.ESTIMATED)
    told = moved.block()
    assert (as_state(told).resets, as_state(told).reset_reason) == (1.0, Reset.CLOCK)
    expected = as_state(straight.block())
    for name in ("resets", "reset_reason", "reset_t", "P", "proven_t"):
        setattr(as_state(told), name, getattr(expected, name))
    assert told.tobytes() == straight.block().tobytes()
    assert straight.stamp_ns - moved.stamp_ns == 500_000_000


@pytest.mark.parametrize("is_flown", [True, False])
@pytest.mark.parametrize("family", ["ardupilot", "px4"])
def test_what_did_not_reboot_is_known_after_it(family, is_flown):
    """The receiver and the vehicle's field; biases where the autopilot does not change them."""
    told = FilterSettings()
    events, _ = flight("figure-eight", duration=40.0, rate=100.0)
    timeline = Timeline(parameters(told, family), delays_ns(told, family), WINDOW_NS)
    put(timeline, events)
    armed = np.array([float(is_flown), 0.0] + [0.0] * 11)
    timeline.insert(int(events.t_ns.max()) + 1, Kind.VEHICLE, armed)
    sample = events.values[np.flatnonzero(events.kind == Kind.IMU)[-1]]
    timeline.insert(int(events.t_ns.max()) + 100_000_000, Kind.IMU, sample)
    before = timeline.block()
    timeline.insert(0, Kind.RESTART, np.zeros(13))
    after = timeline.block()
    learnt, guess = as_state(before), as_state(after)
    keeps_gyro = family == "ardupilot" and is_flown
    sigmas = {"gyro_bias": 0.02 * keeps_gyro, "accel_bias": 0.2, "hard_iron": 0.01}
    for name, sigma in sigmas.items():
        known = np.array(getattr(learnt, name))
        assert np.array_equal(getattr(guess, name), np.clip(known, -2 * sigma, 2 * sigma))
        assert known.any()
    assert guess.mode == Mode.INIT
    was, now = (np.diag(np.array(x.P)) for x in (learnt, guess))
    assert now[E_DELAY] == was[E_DELAY]
    assert np.array_equal(now[E_IRON : E_IRON + 3], was[E_IRON : E_IRON + 3])
    accel, gyro = slice(E_BA, E_BARO), slice(E_BG, E_BA)
    assert now[accel] == pytest.approx((was[accel] + 5e-3**2) * (family == "ardupilot"))
    assert now[gyro] == pytest.approx((was[gyro] + 1e-3**2) * keeps_gyro)
    assert np.count_nonzero(now) == 4 + 3 * (family == "ardupilot") + 3 * keeps_gyro
    assert guess.gnss_delay == learnt.gnss_delay
    assert list(guess.white_share) == list(learnt.white_share)


def test_events_that_wait_for_a_sample_do_not_fill_the_memory():
    events = some_events()
    timeline = a_timeline(capacity=512)
    put(timeline, events.take(events.kind == Kind.IMU).take(np.arange(300)))
    row = events.values[events.kind == Kind.BARO][0]
    start = int(events.t_ns[0]) + 3_000_000_000
    for i in range(5000):
        timeline.insert(start + i * 20_000_000, Kind.BARO, row + i * 1e-6)
    later = start + 5000 * 20_000_000
    sample = events.values[events.kind == Kind.IMU][-1]
    timeline.insert(later, Kind.IMU, sample)
    assert timeline.insert(later + 10_000_000, Kind.IMU, sample) == Arrival.ESTIMATED


def test_a_flood_of_one_kind_between_few_samples_does_not_fill_the_memory():
    events = some_events()
    timeline = a_timeline(capacity=64)
    sample = events.values[events.kind == Kind.IMU][-1]
    row = events.values[events.kind == Kind.BARO][0]
    start = int(events.t_ns[0])
    for i in range(1000):
        timeline.insert(start + i * 1_000_000, Kind.BARO, row + i * 1e-6)
        if i % 40 == 0:
            assert timeline.insert(start + i * 1_000_000, Kind.IMU, sample) == Arrival.ESTIMATED
