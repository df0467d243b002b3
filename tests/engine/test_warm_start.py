"""From one companion to the next, without a file and without a clock."""

import logging
from dataclasses import replace
from functools import cache

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig, OdometryConfig, OutputConfig
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.settings.settings import GnssSettings
from ekf_companion.engine.checkpoint import MOST_STARTS, Clocks, Vehicle, decode, encode
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.warm_start import WarmStart
from ekf_companion.nav.state import Status
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig
from tests.engine.conversation import SECOND_NS, converse, cycles, named

INDEPENDENT = Config(output=OutputConfig(odometry=OdometryConfig(independent=True)))
"""Where nobody answers what the guard asks."""
CLOCKS = Clocks(1_800_000_000 * SECOND_NS, 7 * SECOND_NS, bytes(range(16)))


@cache
def flown(kind=Kind.PX4, system_id=1, duration=20.0):
    """Return time and bytes of each cycle of an autopilot's loop."""
    return list(cycles(duration, "figure-eight", kind=kind, system_id=system_id))


def part(begin, end=99.0, **which):
    """Return the cycles of some seconds of it."""
    first_ns = flown(**which)[0][0]
    return [cycle for cycle in flown(**which) if begin <= (cycle[0] - first_ns) * 1e-9 < end]


def odometry(said):
    return named("ODOMETRY", said)


@cache
def left(seconds=10.0):
    """Return what a companion leaves that ends after so long, and its last ODOMETRY."""
    companion = Companion(INDEPENDENT)
    turns = part(0.0, seconds)
    said = converse(companion, turns)
    return companion.checkpoint(CLOCKS.later(turns[-1][0])), odometry(said)[-1]


def begun(turns, data=None, config=None, clocks=CLOCKS, **options):
    """Return a companion that begins before the first of some turns, with what another left."""
    now_ns = turns[0][0] - SECOND_NS // 10
    data = left()[0] if data is None else data
    warm_start = WarmStart(data, clocks.later(now_ns), now_ns, **options)
    return Companion(config or INDEPENDENT, warm_start=warm_start)


@pytest.mark.parametrize("lost", [0.1, 1.4, 2.4, 5.0])
def test_it_estimates_from_its_first_sample_on_without_waiting_for_a_heartbeat(lost, caplog):
    before = left()[1]
    caplog.set_level(logging.INFO)
    turns = part(10.0 + lost)
    companion = begun(turns)
    said = converse(companion, turns)
    first = odometry(said)[0]
    # After a long gap it waits for a fix, which comes five times a second
    waited = first.time_usec * 1000 - turns[0][0]
    assert waited == 0 if lost < 1.0 else 0 < waited < SECOND_NS // 2
    assert first.quality >= 50
    assert before.reset_counter < first.reset_counter <= before.reset_counter + 2
    health = companion.pipeline.health()
    assert health.start == f"warm: {lost + 0.004:.2f} s lost"
    assert health.status is Status.OK
    assert caplog.text.count("Autopilot found: system 1, component 1, px4") == 1
    assert caplog.text.count("Going on from a checkpoint that is") == 1
    assert caplog.text.count(f"Reset {health.resets - (lost > 1.0)}: restart") == 1
    assert "ALIGNING" not in caplog.text
    # Everything is asked of the autopilot again
    assert named("COMMAND_LONG", said)


def test_a_restart_tells_what_it_has_moved_and_not_what_the_reset_before_it_had():
    """A pilot read 13 degrees where the heading had stayed: those of a reset long before."""
    found = decode(left()[0])
    block = found.state.block.copy()
    moved = as_state(block).moved
    moved.pos_n[:], moved.yaw = (100.0, 0.0, 0.0), 0.23
    data = encode(replace(found, state=replace(found.state, block=block)))
    companion = begun(part(10.3), data=data)
    assert companion.pipeline is None
    converse(companion, part(10.3, 10.35))
    health = companion.pipeline.health()
    assert health.reset_reason == "restart"
    assert health.reset_delta == (0.0,) * 7


def assert_cold(companion, said, reason, caplog):
    assert companion.pipeline.start.startswith("cold: ")
    assert reason in companion.pipeline.start
    assert caplog.text.count("The checkpoint is not used: ") == 1
    assert reason in caplog.text
    # It aligns as it would have
    assert companion.pipeline.health().status is Status.OK
    assert odometry(said)[0].time_usec * 1000 > said[0].t_ns + SECOND_NS
    assert companion.pipeline.health().start == companion.pipeline.start


@pytest.mark.parametrize(
    "which",
    [
        {"config": replace(INDEPENDENT, gnss=GnssSettings(delay=0.1))},
        {"limit": 1.0},
        {"clocks": CLOCKS.later(60 * SECOND_NS)},
        {"data": lambda: encode(replace(decode(left()[0]), starts=MOST_STARTS))},
    ],
)
def test_a_cold_start_in_flight_counts_resets_on_where_it_knows_them(which):
    """Rule 23: its origin is another, and whoever listens must see that."""
    given = {name: value() if callable(value) else value for name, value in which.items()}
    companion = begun(part(12.1), **given)
    said = odometry(converse(companion, part(12.1)))
    assert companion.pipeline.start.startswith("cold: ")
    assert said[0].reset_counter == left()[1].reset_counter + 1
    assert decode(companion.checkpoint(CLOCKS)).state.next_reset == said[-1].reset_counter


REFUSALS = {
    "it had not found its attitude yet": {"data": lambda: left(0.5)[0]},
    "the estimator's settings are others": {
        "config": replace(INDEPENDENT, gnss=GnssSettings(delay=0.1))
    },
    "checkpoint.limit is 1 s": {"limit": 1.0},
    "by the autopilot's clock, 62.6 s by ours": {"clocks": CLOCKS.later(60 * SECOND_NS)},
    "5 restarts came within seconds": {
        "data": lambda: encode(replace(decode(left()[0]), starts=MOST_STARTS))
    },
}


@pytest.mark.parametrize("reason", REFUSALS)
def test_what_may_not_be_gone_on_from_is_said_and_it_begins_cold(reason, caplog, monkeypatch):
    caplog.set_level(logging.INFO)
    if "not found" in reason:
        monkeypatch.setitem(REFUSALS, reason, {"data": lambda: aligning()})
    options = dict(REFUSALS[reason])
    if "data" in options:
        options["data"] = options["data"]()
    turns = part(12.1)
    companion = begun(turns, **options)
    assert_cold(companion, converse(companion, turns), reason, caplog)


def aligning():
    companion = Companion(INDEPENDENT)
    turns = part(0.0, 0.5)
    converse(companion, turns)
    return companion.checkpoint(CLOCKS.later(turns[-1][0]))


def test_an_autopilot_that_has_rebooted_is_aligned_with_anew(caplog):
    caplog.set_level(logging.INFO)
    turns = part(0.0, 6.0)
    companion = begun(turns)
    assert_cold(companion, converse(companion, turns), "rebooted since", caplog)
    assert "WARNING" not in caplog.text  # so it is at every start of the day


def test_another_vehicle_is_aligned_with_anew(caplog):
    turns = part(12.0, system_id=9)
    companion = begun(turns)
    said = converse(companion, turns)
    assert_cold(companion, said, "system 1, component 1; this is px4, system 9", caplog)


def test_a_heartbeat_that_gives_the_lie_to_what_was_expected_begins_anew(caplog):
    """Another make of autopilot under the same numbers: its samples come before its name."""
    turns = part(12.2, kind=Kind.ARDUPILOT)
    companion = begun(turns)
    said = converse(companion, turns)
    assert companion.pipeline.start.startswith("cold: it is of another vehicle (px4")
    assert companion.pipeline.health().status is Status.OK
    assert companion.pipeline.health().reset_reason == "none"
    last = decode(companion.checkpoint(CLOCKS))
    assert last.vehicle == Vehicle("ardupilot", 1, 1)
    assert {message.estimator_type for message in odometry(said)[-10:]} == {5}


def test_the_one_autopilot_to_listen_to_is_not_another_that_was_left():
    turns = part(12.0)
    companion = begun(turns, config=replace(INDEPENDENT, link=LinkConfig(autopilot=9)))
    assert not odometry(converse(companion, turns[:500]))
    assert companion.pipeline is None


def test_nothing_is_left_before_there_is_anything_to_leave():
    companion = Companion(INDEPENDENT)
    assert companion.checkpoint(CLOCKS) is None
    assert companion.resets == 0
    autopilot = Autopilot(SimConfig())
    autopilot.heartbeat()
    companion.receive(b"".join(autopilot.data_to_send()), 0)
    assert companion.pipeline is not None
    assert companion.checkpoint(CLOCKS) is None


def test_what_was_found_is_not_replaced_before_it_is_judged():
    autopilot = Autopilot(SimConfig())
    autopilot.heartbeat()
    turns = part(12.0)
    companion = begun(turns)
    companion.receive(b"".join(autopilot.data_to_send()), turns[0][0])
    assert companion.pipeline is not None
    assert companion.checkpoint(CLOCKS) is None


def test_restarts_are_counted_until_one_has_lasted_three_seconds():
    data = left()[0]
    for starts in (1, 2, 3):
        turns = part(10.0 + 0.5 * starts, 10.5 + 0.5 * starts)
        companion = begun(turns, data=data)
        converse(companion, turns)
        data = companion.checkpoint(CLOCKS.later(turns[-1][0]))
        assert decode(data).starts == starts
    turns = part(12.0)
    companion = begun(turns, data=data)
    converse(companion, turns[:700])
    assert decode(companion.checkpoint(CLOCKS)).starts == 4
    converse(companion, turns[700:])
    assert decode(companion.checkpoint(CLOCKS)).starts == 0


def test_the_count_of_resets_never_goes_back():
    counts = [left()[1].reset_counter]
    data = left()[0]
    for begin in (10.5, 11.5, 13.5):
        turns = part(begin, begin + 0.9)
        companion = begun(turns, data=data)
        counts += [message.reset_counter for message in odometry(converse(companion, turns))]
        data = companion.checkpoint(CLOCKS.later(turns[-1][0]))
    assert counts == sorted(counts)
    assert counts[-1] >= counts[0] + 3 + 1  # and one gap of more than a second
