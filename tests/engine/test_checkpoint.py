"""A state as bytes: there and back to the bit, and refused wherever it may not be gone on from."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ekf_companion.core.memory import enums
from ekf_companion.core.memory.bank import Bank
from ekf_companion.core.memory.enums import Fault, Mode
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.memory.state import BLOCK
from ekf_companion.core.order.timeline import Timeline
from ekf_companion.core.settings.settings import FilterSettings, GateSettings, GnssSettings
from ekf_companion.engine import checkpoint
from ekf_companion.engine.checkpoint import (
    Checkpoint,
    Clocks,
    Refusal,
    SentFrame,
    Sources,
    Vehicle,
    Why,
    decode,
    encode,
)
from ekf_companion.engine.health import Aid, Arrival, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import COLUMNS, Status
from tests.core.flights import between, flight
from tests.core.interpreted import load
from tests.core.test_timeline import a_timeline, put, some_events
from tests.engine.estimation import KNOWN, deviations, run

SECOND_NS = 1_000_000_000
BOOT = bytes(range(16))
VEHICLE = Vehicle("px4", 7, 1)
CLOCKS = Clocks(1_800_000_000 * SECOND_NS, 300 * SECOND_NS, BOOT)
EVENTS, TRUTH = flight("figure-eight", duration=12.0)
RESETS = COLUMNS.index("reset_count") - 1  # among the numbers of an estimate


def a_pipeline(events=EVENTS):
    pipeline = Pipeline(KNOWN)
    pipeline.run(events)
    return pipeline


PIPELINE = a_pipeline(EVENTS.take(np.arange(len(EVENTS)) < len(EVENTS) - 2))
GOOD = Checkpoint(
    state=PIPELINE.state(), vehicle=VEHICLE, clocks=CLOCKS, sources=Sources(1, 1, 1, 2), starts=3
)
BYTES = encode(GOOD)
STAMP = GOOD.state.stamp_ns


def with_block(**changes):
    """Return the good one with some numbers of its block changed, by their names."""
    block = GOOD.state.block.copy()
    x = as_state(block)
    for name, value in changes.items():
        field = getattr(x, name)
        if np.ndim(field):
            np.ctypeslib.as_array(field).flat[0] = value
        else:
            setattr(x, name, value)
    return replace(GOOD, state=replace(GOOD.state, block=block))


def test_what_is_encoded_is_decoded_to_the_bit():
    found = decode(BYTES)
    assert isinstance(found, Checkpoint)
    assert (found.vehicle, found.clocks, found.sources, found.starts) == (
        VEHICLE,
        CLOCKS,
        Sources(1, 1, 1, 2),
        3,
    )
    for name in ("epoch_ns", "stamp_ns", "settings"):
        assert getattr(found.state, name) == getattr(GOOD.state, name)
    assert found.state.block.tobytes() == GOOD.state.block.tobytes()
    assert found.state.waiting.tobytes() == GOOD.state.waiting.tobytes()
    assert not found.sent.has_origin
    assert encode(found) == BYTES
    assert len(found.state.waiting) > 0
    state = sum(part.nbytes for part in (GOOD.state.block, GOOD.state.waiting, GOOD.state.bank))
    assert len(BYTES) < state + 1024


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ((0.8, -3.1, 4.0), (0.8, -3.1, 4.0)),
        ((0.8, 3.2, 4.0), (math.nan, math.nan, 4.0)),
        ((math.nan, math.nan, 1e6), (math.nan, math.nan, math.nan)),
    ],
)
def test_what_the_autopilot_is_sent_by_is_kept_where_it_is_a_place(sent, kept):
    found = decode(encode(replace(GOOD, sent=SentFrame(*sent))))
    assert found.sent == pytest.approx(kept, nan_ok=True)
    assert found.remains.sent == pytest.approx(kept, nan_ok=True)
    assert found.sent.has_origin is (kept[0] == 0.8)


def test_the_inertial_unit_in_use_is_kept_with_what_is_added_to_its_readings():
    offset = (0.01, -0.02, 0.03, 0.1, -0.2, 0.3)
    found = decode(encode(replace(GOOD, unit=2, unit_offset=offset)))
    assert isinstance(found, Checkpoint)
    assert (found.unit, found.unit_offset) == (2, offset)
    assert refused(encode(replace(GOOD, unit_offset=(*offset[:5], 1e9)))).why is Why.DAMAGED


# What is refused by the bytes alone


def refused(data):
    found = decode(data)
    assert isinstance(found, Refusal)
    assert len(found.words) > 30
    return found


@given(st.integers(0, len(BYTES) - 1))
def test_a_truncated_one_is_refused(length):
    assert refused(BYTES[:length]).why is Why.DAMAGED


@given(st.lists(st.integers(0, 8 * len(BYTES) - 1), min_size=1, max_size=3, unique=True))
def test_one_with_flipped_bits_is_refused(places):
    data = bytearray(BYTES)
    for place in places:
        data[place // 8] ^= 1 << place % 8
    assert refused(bytes(data)).why is Why.DAMAGED


@given(st.binary(max_size=300), st.booleans())
def test_any_other_bytes_are_refused(data, has_magic):
    assert refused(checkpoint.MAGIC + data if has_magic else data).why is Why.DAMAGED


@given(st.integers(0, len(BYTES) // 8 - 2), st.floats(allow_nan=True, allow_infinity=True))
def test_no_number_that_a_writer_may_have_got_wrong_raises(place, number):
    """Where the checksum is right and the content is not, it is refused, or filtered as it is."""
    block = GOOD.state.block.copy()
    block[place % BLOCK] = number
    data = encode(replace(GOOD, state=replace(GOOD.state, block=block)))
    found = decode(data)
    if isinstance(found, Refusal):
        return
    pipeline = Pipeline(KNOWN)
    pipeline.restore(found.state)
    later = EVENTS.take(EVENTS.t_ns >= STAMP)
    pipeline.run(replace(later, t_ns=later.t_ns + 2 * SECOND_NS))
    x = as_state(block := pipeline.state().block)
    assert block.size == BLOCK
    for name in (
        "q_nb",
        "vel_n",
        "pos_n",
        "gyro_bias",
        "accel_bias",
        "gnss_offset",
        "hard_iron",
        "P",
    ):
        assert np.isfinite(np.array(getattr(x, name))).all(), name
    assert np.isfinite([x.baro_offset, x.gnss_delay, x.heading_offset]).all()
    pipeline.health()


@pytest.mark.parametrize(
    "changes",
    [
        {"vel_n": np.nan},
        {"P": np.nan},
        {"P": -1.0},
        {"q_nb": 2.0},
        {"gnss_delay": np.inf},
        {"mode": 17.0},
        {"resets": np.nan},
        {"reset_reason": 99.0},
        {"t": 1.0},
    ],
)
def test_a_state_that_cannot_be_is_refused(changes):
    assert refused(encode(with_block(**changes))).why is Why.DAMAGED


@pytest.mark.parametrize("mode", [Mode.INIT, Mode.LEVEL])
def test_a_state_without_an_attitude_is_refused(mode):
    assert refused(encode(with_block(mode=mode))).why is Why.ALIGNING


def test_any_change_of_the_layout_refuses_what_was_written_before(monkeypatch):
    monkeypatch.setattr(enums, "YAW_FILTERS", enums.YAW_FILTERS + 1)
    assert checkpoint.layout_fingerprint() != checkpoint.LAYOUT
    monkeypatch.setattr(checkpoint, "LAYOUT", checkpoint.layout_fingerprint())
    assert refused(BYTES).why is Why.VERSION


def test_another_version_of_the_package_is_refused_by_its_name(monkeypatch):
    monkeypatch.setattr(checkpoint, "__version__", "9.9.9")
    refusal = refused(BYTES)
    assert refusal.why is Why.VERSION
    assert "9.9.9" in refusal.words


def test_a_message_rank_or_family_that_there_is_not_is_refused():
    assert refused(encode(replace(GOOD, sources=Sources(imu=5)))).why is Why.DAMAGED
    strange = VEHICLE._replace(family="paparazzi")
    assert refused(encode(replace(GOOD, vehicle=strange))).why is Why.DAMAGED


def test_a_restart_that_comes_again_and_again_is_refused():
    assert isinstance(decode(encode(replace(GOOD, starts=checkpoint.MOST_STARTS - 1))), Checkpoint)
    assert refused(encode(replace(GOOD, starts=checkpoint.MOST_STARTS))).why is Why.LOOP


# What is refused by whose and how old it is


@pytest.mark.parametrize("change", [{"family": "ardupilot"}, {"system_id": 8}, {"component_id": 2}])
def test_another_vehicle_is_refused(change):
    other = VEHICLE._replace(**change)
    refusal = GOOD.refuse_vehicle(other, GOOD.state.settings)
    assert refusal.why is Why.FOREIGN
    assert str(other) in refusal.words
    assert str(VEHICLE) in refusal.words


def test_other_settings_are_refused_and_the_same_are_not():
    assert GOOD.refuse_vehicle(VEHICLE, Pipeline(KNOWN).fingerprint) is None
    for settings in (
        FilterSettings(gnss=GnssSettings(delay=0.121, delay_std=0.02)),
        replace(KNOWN, gnss=replace(KNOWN.gnss, lever_arm=(0.1, 0.0, 0.0))),
        replace(KNOWN, gate=GateSettings(probability=0.999)),
    ):
        refusal = GOOD.refuse_vehicle(VEHICLE, Pipeline(settings).fingerprint)
        assert refusal.why is Why.SETTINGS
    other = Pipeline(KNOWN, "ardupilot").fingerprint
    assert GOOD.refuse_vehicle(VEHICLE, other).why is Why.SETTINGS


def judged(lost, passed=None, **clocks):
    """Judge by a first sample ``lost`` seconds later, ``passed`` seconds later by our clocks."""
    now = CLOCKS.later(round((lost if passed is None else passed) * SECOND_NS))
    return GOOD.refuse_time(STAMP + round(lost * SECOND_NS), now._replace(**clocks))


@pytest.mark.parametrize("lost", [0.004, 1.0, 10.0, 29.9])
def test_one_that_is_fresh_by_all_clocks_is_used(lost):
    assert judged(lost) is None


@pytest.mark.parametrize("lost", [0.0, -0.001, -5.0, -3600.0])
def test_a_clock_that_went_back_tells_of_a_reboot(lost):
    assert judged(lost, passed=3.0).why is Why.REBOOTED


def test_one_older_than_the_limit_is_refused_and_the_limit_is_named():
    refusal = judged(30.1)
    assert refusal.why is Why.STALE
    assert "30.1 s" in refusal.words
    assert "checkpoint.limit is 30 s" in refusal.words
    later = CLOCKS.later(2 * SECOND_NS)
    assert GOOD.refuse_time(STAMP + 2 * SECOND_NS, later, limit=1.0).why is Why.STALE


def test_an_autopilot_that_rebooted_and_ran_past_is_found_out_by_our_clock():
    refusal = judged(5.0, passed=25.0)
    assert refusal.why is Why.CLOCKS
    assert "5.0 s" in refusal.words
    assert "25.0 s" in refusal.words
    assert judged(5.0, passed=6.5) is None


def test_within_one_boot_a_wall_clock_that_was_set_changes_nothing():
    years = 50 * 365 * 86400 * SECOND_NS
    assert judged(2.0, unix_ns=CLOCKS.unix_ns - years) is None
    assert judged(2.0, unix_ns=CLOCKS.unix_ns + years) is None


@pytest.mark.parametrize("boot_id", [bytes(16), BOOT[::-1]])
def test_after_another_boot_the_wall_clock_decides(boot_id):
    assert judged(9.0, boot_ns=0, boot_id=boot_id) is None
    wrong = CLOCKS.unix_ns - 86400 * SECOND_NS
    assert judged(9.0, boot_ns=0, boot_id=boot_id, unix_ns=wrong).why is Why.CLOCKS


def test_a_boot_that_is_not_known_is_no_boot_in_common():
    unknown = replace(GOOD, clocks=Clocks(CLOCKS.unix_ns))
    assert unknown.refuse_time(STAMP + SECOND_NS, Clocks(CLOCKS.unix_ns + SECOND_NS)) is None
    late = Clocks(CLOCKS.unix_ns + 9 * SECOND_NS)
    assert unknown.refuse_time(STAMP + SECOND_NS, late).why is Why.CLOCKS


# Going on


def told(timeline):
    """Return a timeline's state but for what a restart itself writes down."""
    block = timeline.block()
    x = as_state(block)
    x.resets = x.reset_reason = 0.0
    return block.tobytes()


@pytest.mark.parametrize(("kind", "every"), [(Timeline, 17), (load().timeline.Timeline, 102)])
def test_where_nothing_is_lost_it_goes_on_to_the_bit(kind, every):
    """Cut behind any event that no late fix reaches over; plain Python is slow, so rarely there."""
    events = some_events(4.0)
    lag = np.where(events.kind == Kind.GNSS, 120_000_000, 0)
    true_ns = events.t_ns - lag
    cuts = [
        cut
        for cut in range(150, len(events) - 1, every)
        if true_ns[cut:].min() > events.t_ns[:cut][events.kind[:cut] == Kind.IMU].max()
    ]
    assert len(cuts) * every > 170
    whole = a_timeline()
    put(whole, events)
    waiting = 0
    for cut in cuts:
        before, after = a_timeline(kind), a_timeline(kind)
        put(before, events.take(np.arange(cut)))
        waiting += len(before.waiting())
        after.restore(
            before.block(), before.waiting(), before.epoch_ns, before.stamp_ns, before.bank()
        )
        assert after.stamp_ns == before.stamp_ns
        arrivals = put(after, events.take(np.arange(cut, len(events))))
        assert Arrival.STALE not in arrivals
        assert told(after) == told(whole), cut
        a, b = (np.delete(one.describe(), RESETS) for one in (after, whole))
        assert a.tobytes() == b.tobytes()
        assert after.resets == whole.resets + 1
    assert waiting > 0


def test_a_pipeline_goes_on_from_the_bytes_of_another_to_the_bit():
    pipeline = Pipeline(KNOWN)
    pipeline.restore(decode(BYTES).state)
    whole = a_pipeline()
    pipeline.run(EVENTS.take(np.arange(len(EVENTS)) >= len(EVENTS) - 2))
    assert pipeline.stamp_ns == whole.stamp_ns
    a, b = pipeline.values(), whole.values()
    assert np.delete(a, RESETS).tobytes() == np.delete(b, RESETS).tobytes()
    assert pipeline.resets == whole.resets + 1
    health = pipeline.health()
    assert (health.reset_reason, health.start) == ("restart", "warm")


FAULTY, _ = flight("figure-eight", duration=20.0)
FAULTY.values[(FAULTY.kind == Kind.BARO) & between(FAULTY, 12.0, 20.0), 0] += 8.0


def weighing(mode, until=20.0):
    """Return a pipeline that weighs faults, run so far over a flight whose barometer jumps."""
    pipeline = Pipeline(replace(KNOWN, weigh_faults=mode))
    pipeline.run(FAULTY.take(np.arange(whole_cut(until))))
    return pipeline


def whole_cut(after):
    """Return the first event after a time, s, behind which no late fix reaches over."""
    true_ns = FAULTY.t_ns - np.where(FAULTY.kind == Kind.GNSS, 120_000_000, 0)
    samples = np.maximum.accumulate(np.where(FAULTY.kind == Kind.IMU, FAULTY.t_ns, 0))
    later = np.minimum.accumulate(true_ns[::-1])[::-1]
    fits = later[1:] > samples[:-1]
    behind = FAULTY.t_ns[1:] >= FAULTY.t_ns[0] + after * SECOND_NS
    found = np.flatnonzero(fits & behind)
    return int(found[0]) + 1 if len(found) else len(FAULTY)


@pytest.mark.parametrize("mode", ["report", "act"])
@pytest.mark.parametrize("cut", [10.0, 12.9, 17.0], ids=["quiet", "jumped", "named"])
def test_fault_hypotheses_go_on_to_the_bit(mode, cut):
    before, whole = weighing(mode, cut), weighing(mode)
    state = before.state()
    found = decode(encode(replace(GOOD, state=state))).state
    assert len(state.bank) > 10_000
    assert found.bank.tobytes() == state.bank.tobytes()
    after = Pipeline(replace(KNOWN, weigh_faults=mode))
    after.restore(found)
    after.run(FAULTY.take(np.arange(whole_cut(cut), len(FAULTY))))
    assert after._timeline.hypotheses() == whole._timeline.hypotheses()
    assert after.found_faults() == whole.found_faults()
    assert [one.kind for one in whole.found_faults()] == [Fault.BARO_STEP]
    a, b = after.values(), whole.values()
    assert np.delete(a, RESETS).tobytes() == np.delete(b, RESETS).tobytes()


def test_fault_hypotheses_are_read_by_a_process_that_has_just_begun(tmp_path):
    """Its memory goes back to the system as soon as nothing refers to it."""
    state = weighing("report", 17.0).state()
    (tmp_path / "checkpoint").write_bytes(encode(replace(GOOD, state=state)))
    code = (
        "import sys; from ekf_companion.engine.checkpoint import decode\n"
        "print(len(decode(open(sys.argv[1], 'rb').read()).state.bank))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "checkpoint")]
    read = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    assert int(read.stdout) == len(state.bank)


@pytest.mark.parametrize("change", ["none", "layout", "kind", "count", "number", "cut"])
def test_without_fault_hypotheses_that_fit_they_begin_anew(change, monkeypatch):
    state = weighing("report", 17.0).state()
    bank = state.bank.copy()
    if change == "none":
        bank = np.zeros(0)
    elif change == "kind":
        bank[Bank.instance.offset // 8 :].view(np.int64)[0] = 99
    elif change == "count":
        bank.view(np.int64)[Bank.n.offset // 8] = 999
    elif change == "number":
        bank[Bank.nothing.offset // 8] = np.inf
    elif change == "cut":
        bank = bank[:-1]
    data = encode(replace(GOOD, state=replace(state, bank=bank)))
    if change == "layout":
        monkeypatch.setattr(checkpoint, "BANK_LAYOUT", bytes(8))
    found = decode(data)
    assert isinstance(found, Checkpoint)
    assert len(found.state.bank) == 0
    after = Pipeline(replace(KNOWN, weigh_faults="report"))
    after.restore(found.state)
    assert after._timeline.hypotheses() == []
    after.run(FAULTY.take(between(FAULTY, 17.0, 20.0)))
    assert len(after._timeline.hypotheses()) > 50


def test_a_restart_and_a_reboot_of_the_autopilot_both_count_on():
    pipeline = Pipeline(KNOWN)
    pipeline.restore(GOOD.state)
    resets = pipeline.resets
    pipeline.process_row((0, Kind.RESTART, (0.0,) * 13))
    assert pipeline.resets == resets + 1
    again, fresh = pipeline.run(EVENTS).values[-1], a_pipeline().values()
    # what was known of sensors and receiver lives on, so it is the same flight but not to the bit
    place = slice(3, 6)
    assert again[place] == pytest.approx(fresh[place], abs=0.5)


def test_what_was_true_while_nobody_listened_is_stale():
    """A fix of the lost time would be judged by a state that knows nothing of that time."""
    pipeline = Pipeline(KNOWN)
    pipeline.restore(GOOD.state)
    fix = EVENTS.take(EVENTS.kind == Kind.GNSS)
    sample = EVENTS.take(EVENTS.kind == Kind.IMU)
    first = STAMP + 3 * SECOND_NS

    def insert(kind, t_ns, values):
        pipeline.process_row((t_ns, kind, tuple(values)))
        return pipeline.arrival

    assert insert(Kind.GNSS, first - SECOND_NS, fix.values[-1]) is Arrival.TAKEN
    assert insert(Kind.IMU, first, sample.values[-1]) is Arrival.ESTIMATED
    health = pipeline.health()
    assert health.gaps == PIPELINE.health().gaps + 1
    assert health.verdicts == PIPELINE.health().verdicts
    assert health.status is Status.DEAD_RECKONING
    assert insert(Kind.GNSS, first + 10_000_000, fix.values[-2]) is Arrival.STALE
    assert insert(Kind.GNSS, first + 130_000_000, fix.values[-1]) is Arrival.TAKEN
    assert insert(Kind.IMU, first + 10_000_000, sample.values[-1]) is Arrival.ESTIMATED
    assert insert(Kind.IMU, first + 20_000_000, sample.values[-1]) is Arrival.ESTIMATED
    assert pipeline.health().reset_reason == "inertial gap"  # of the fix


@pytest.mark.parametrize("lost", [0.5, 1.4, 2.4, 5.0, 10.0])
@pytest.mark.parametrize("name", ["figure-eight", "loiter", "hover"])
def test_after_lost_seconds_the_estimate_is_honest_and_no_good_fix_is_refused(name, lost):
    for seed, cut in ((1, 20.0), (2, 23.3)):
        events, truth = flight(name, duration=40.0, seed=seed)
        _, before = run(events.take(between(events, 0.0, cut)))
        state = decode(encode(replace(GOOD, state=before.state()))).state
        pipeline = Pipeline(KNOWN)
        pipeline.restore(state)
        table = pipeline.run(events.take(between(events, cut + lost, 99.0)))
        error, sigma = deviations(table, truth)
        assert table.column("reset_count")[0] == before.resets + 1
        assert table.column("status")[0] >= Status.OK
        assert (np.abs(error[0]) < 3.0 * sigma[0]).all()
        assert (np.abs(error) < 3.0 * sigma).mean() > 0.9
        # In less than two seconds there is an attitude again, and everything is aided
        t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
        assert (table.column("status")[t > 1.8] == Status.OK).all()
        assert np.degrees(np.abs(error[t > 2.5, 3:5])).max() < 8.0
        assert np.abs(error[t > 2.5, :3]).max() < 1.0
        gated = [
            pipeline.health().verdicts[aid][Verdict.GATED]
            - before.health().verdicts[aid][Verdict.GATED]
            for aid in Aid
        ]
        assert sum(gated) == 0, (seed, gated)


def test_doubt_grows_with_the_time_lost():
    sample = EVENTS.values[EVENTS.kind == Kind.IMU][-1]
    last = PIPELINE.health()
    previous = (last.std_horizontal, last.std_vertical)
    for lost in (0.3, 0.8, 2.0, 5.0, 15.0):
        pipeline = Pipeline(KNOWN)
        pipeline.restore(GOOD.state)
        pipeline.process_row((STAMP + round(lost * SECOND_NS), Kind.IMU, tuple(sample)))
        health = pipeline.health()
        assert health.std_horizontal > previous[0]
        assert health.std_vertical > previous[1]
        previous = (health.std_horizontal, health.std_vertical)
        assert health.std_horizontal > 0.5 * lost * min(2.0 * lost, 20.0)  # 2 m/s^2, and more
