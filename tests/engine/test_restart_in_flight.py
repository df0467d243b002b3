"""A restart in the air: what is sent goes on in the frame of before, or nothing is sent.

An uninterrupted companion is beside each, and what both send is compared at the same stamps.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.output.follower import Follower
from ekf_companion.core.settings.settings import GnssSettings
from ekf_companion.engine import checkpoint as checkpoint_bytes
from ekf_companion.engine.checkpoint import MOST_STARTS, decode, encode
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.warm_start import PATIENCE_NS
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig
from tests.engine.conversation import SECOND_NS, converse, messages, named
from tests.engine.test_warm_start import CLOCKS, INDEPENDENT, begun, flown, odometry

CUT = 9.0
"""When the companion ends, s since its start."""
SAME = 0.5
"""What a vehicle may move by when the frame changes, m."""
KINDS = (Kind.PX4, Kind.ARDUPILOT)


def whole(kind):
    """Return the cycles of the flight."""
    return flown(kind=kind, duration=32.0)


@cache
def uninterrupted(kind):
    """Return stamps (us) and positions that are sent without a restart, and what it left at CUT."""
    companion = Companion(INDEPENDENT)
    turns, data, sent = whole(kind), None, {}
    for t_ns, frames in turns:
        companion.receive(frames, t_ns)
        companion.tick(t_ns)
        sent |= {m.time_usec: (m.x, m.y, m.z) for m in named("ODOMETRY", messages(companion))}
        if data is None and t_ns - turns[0][0] >= CUT * SECOND_NS:
            data = companion.checkpoint(CLOCKS.later(t_ns))
    return np.array(list(sent)), np.array(list(sent.values())), data, companion.pipeline.origin


def after(dead, kind=Kind.PX4, lasting=9.0):
    """Return the cycles from some seconds after the end of the first companion."""
    first_ns = whole(kind)[0][0]
    begin, end = (first_ns + round((CUT + s) * SECOND_NS) for s in (dead, dead + lasting))
    return [turn for turn in whole(kind) if begin < turn[0] <= end]


def offsets(sent, kind=Kind.PX4):
    """Return by how much what was sent differs from what would have been, m, shape (n, 3)."""
    t, pos_n, _, _ = uninterrupted(kind)
    at = [message.time_usec for message in sent]
    would = np.stack([np.interp(at, t, pos_n[:, i]) for i in range(3)], axis=-1)
    return np.array([(m.x, m.y, m.z) for m in sent]) - would


def assert_same_frame(companion, sent, kind=Kind.PX4):
    # But for the noise of the fixes that it began with, which has gone after four seconds
    steady = [m for m in sent if m.time_usec * 1000 > sent[0].time_usec * 1000 + 4 * SECOND_NS]
    assert np.abs(offsets(steady, kind).mean(axis=0)).max() < SAME
    assert companion.pipeline.origin == pytest.approx(uninterrupted(kind)[3], abs=1e-12)


def other_version(data, monkeypatch):
    found = decode(data)
    monkeypatch.setattr(checkpoint_bytes, "__version__", "0.0.1")
    written = encode(found)
    monkeypatch.undo()
    return written


REFUSED = {
    "state too old": {"limit": 0.1},
    "other settings": {"config": replace(INDEPENDENT, gnss=GnssSettings(delay=0.1))},
    "clocks disagree": {"clocks": CLOCKS.later(60 * SECOND_NS)},
    "many restarts": {"data": lambda data, _: encode(replace(decode(data), starts=MOST_STARTS))},
    "another version": {"data": other_version},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dead", [0.3, 1.5, 5.0])
@pytest.mark.parametrize("why", REFUSED)
def test_an_origin_outlives_a_state_that_is_refused(why, dead, kind, monkeypatch):
    options = dict(REFUSED[why])
    data = uninterrupted(kind)[2]
    if "data" in options:
        data = options.pop("data")(data, monkeypatch)
    turns = after(dead, kind)
    companion = begun(turns, data=data, **options)
    said = converse(companion, turns)
    assert companion.pipeline.start.startswith("cold: ")
    assert_same_frame(companion, odometry(said), kind)
    texts = [m.text.decode() for m in named("STATUSTEXT", said)]
    assert f"Companion: restarted: {why}, same origin" in texts


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dead", [0.3, 0.94, 1.5, 3.0, 5.0])
def test_the_first_message_waits_for_a_fix_as_long_as_the_flight_allows(dead, kind):
    """A velocity known to 5 m/s with a moved counter ends a flight as a longer silence does."""
    turns = after(dead, kind)
    companion = begun(turns, data=uninterrupted(kind)[2])
    said = converse(companion, turns)
    sent = odometry(said)
    waited = (sent[0].time_usec * 1000 - turns[0][0]) / SECOND_NS
    assert dead + waited < (7.0 if kind is Kind.ARDUPILOT else 5.6)
    assert ground_speed_std(sent[0]) < 1.0  # COM_VEL_FS_EVH
    assert_same_frame(companion, sent, kind)
    texts = [m.text.decode() for m in named("STATUSTEXT", said)]
    assert f"Companion: restarted, going on from {dead:.1f} s ago" in texts
    assert not [text for text in texts if "GNSS" in text or "degraded" in text]


def ground_speed_std(m):
    """Return one sigma of the velocity over ground of a message, m/s."""
    pose = (m.x, m.y, m.z, *m.q, m.vx, m.vy, m.vz, m.rollspeed, m.pitchspeed, m.yawspeed)
    numbers = np.array([*pose, *m.pose_covariance, *m.velocity_covariance], dtype="<f4")
    if m.child_frame_id == m.frame_id:  # along the local axes already
        numbers[3:7] = 1.0, 0.0, 0.0, 0.0
    follower = Follower()
    follower.look(0, numbers.tobytes(), (0.0, 0.0, 0.0))
    return follower.std_ground_speed()


@pytest.mark.parametrize("behind", [0.2, 2.9, 4.9])
@pytest.mark.parametrize("each_ns", [0, SECOND_NS // 2000])
def test_what_waited_in_a_buffer_is_no_older_checkpoint(behind, each_ns):
    """A vehicle climbed 12 m, twice: a port gave out what was 2.9 s old."""
    turns = after(0.1, lasting=10.0)
    open_ns = turns[0][0] + round(behind * SECOND_NS)
    burst = [turn for turn in turns if turn[0] < open_ns]
    # Old frames come faster than they were measured, then the others as they are
    late = [(open_ns + i * each_ns, data) for i, (_, data) in enumerate(burst)]
    live = [(max(t_ns, late[-1][0]), data) for t_ns, data in turns[len(burst) :]]
    companion = begun([(open_ns, b"")], data=uninterrupted(Kind.PX4)[2])
    said = converse(companion, late + live)
    assert companion.pipeline.start.startswith("warm: 0.1")
    assert_same_frame(companion, odometry(said))


def test_frames_of_before_the_checkpoint_are_no_reboot():
    first_ns = whole(Kind.PX4)[0][0]
    old = [turn for turn in whole(Kind.PX4) if 0 <= turn[0] - first_ns - 8 * SECOND_NS < SECOND_NS]
    turns = after(0.5)
    companion = begun(turns, data=uninterrupted(Kind.PX4)[2])
    said = converse(companion, [(turns[0][0], data) for _, data in old[:200]] + turns)
    assert companion.pipeline.start.startswith("warm: 0.5")
    assert_same_frame(companion, odometry(said))


def test_clocks_that_go_on_to_differ_are_found_out_in_time():
    turns = after(1.0)
    companion = begun(turns, data=uninterrupted(Kind.PX4)[2], clocks=CLOCKS.later(9 * SECOND_NS))
    converse(companion, [turn for turn in turns if turn[0] - turns[0][0] < PATIENCE_NS])
    assert "10.5 s by ours" in companion.pipeline.start


def test_a_simulator_faster_than_time_is_not_waited_for_for_ever():
    turns = after(1.0)
    fast = [(turns[0][0] + (t_ns - turns[0][0]) // 2, data) for t_ns, data in turns]
    companion = begun(fast, data=uninterrupted(Kind.PX4)[2], clocks=CLOCKS.later(9 * SECOND_NS))
    converse(companion, fast)
    assert companion.pipeline.start.startswith("cold: ")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limit", [0.1, 30.0])
def test_ten_kills_leave_the_frame_where_it_was(limit, kind):
    """Whether each goes on from the state, or none does; some end before they have a position."""
    data, begin = uninterrupted(kind)[2], 0.2
    for lasting in (0.5, 0.7, 0.3, 0.6, 0.4, 0.9, 0.5, 0.3, 0.8):
        turns = after(begin, kind, lasting)
        companion = begun(turns, data=data, limit=limit)
        converse(companion, turns)
        data = companion.checkpoint(CLOCKS.later(turns[-1][0])) or data
        begin += lasting + 0.12
    turns = after(begin, kind, 9.0)
    companion = begun(turns, data=data, limit=limit)
    assert_same_frame(companion, odometry(converse(companion, turns)), kind)


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_frame_is_lost_nothing_is_sent_until_it_has_landed(kind):
    turns = after(0.5, kind)
    companion = begun(turns, data=uninterrupted(kind)[2][:-1])
    said = converse(companion, turns)
    assert not odometry(said)
    texts = [m.text.decode() for m in named("STATUSTEXT", said)]
    assert "Companion: no ODOMETRY: began anew in the air" in texts
    assert "Companion: restarted: damaged state, new origin" in texts
    assert "land: " in companion.session.stream_state.remedy
    # Nor does a second restart forget that
    assert companion.checkpoint(CLOCKS) is None
    autopilot = Autopilot(SimConfig(), kind)
    autopilot.heartbeat()
    landed = turns[-1][0] + SECOND_NS
    companion.receive(b"".join(autopilot.data_to_send()), landed)
    for seconds in (0, 1, 2):
        companion.tick(landed + seconds * SECOND_NS)
    assert companion.session.may_stream
    assert companion.checkpoint(CLOCKS) is not None


def test_an_autopilot_that_has_rebooted_gets_a_new_origin():
    turns = whole(Kind.PX4)[:1500]
    data = uninterrupted(Kind.PX4)[2]
    found = decode(data)
    block = found.state.block.copy()
    as_state(block).origin.alt += 100.0
    elsewhere = encode(replace(found, state=replace(found.state, block=block)))
    companion = begun(turns, data=elsewhere, clocks=CLOCKS.later(60 * SECOND_NS))
    said = converse(companion, turns)
    assert companion.session.may_stream
    assert odometry(said)
    assert companion.pipeline.origin[2] < as_state(block).origin.alt - 50.0
    assert "the autopilot has rebooted" in companion.pipeline.start


def test_another_vehicle_gets_none_of_it():
    turns = after(0.5, Kind.ARDUPILOT)
    companion = begun(turns, data=uninterrupted(Kind.PX4)[2], limit=0.1)
    converse(companion, turns)
    assert companion.pipeline.origin != decode(uninterrupted(Kind.PX4)[2]).remains.origin[:3]
