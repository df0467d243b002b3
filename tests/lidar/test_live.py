"""The odometry of a lidar while it flies, without sockets: what its network and clock may do."""

from __future__ import annotations

import itertools
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.errors import LogError
from ekf_companion.lidar.heard import Heard
from ekf_companion.lidar.live import MOST_WAITING, Live
from ekf_companion.lidar.motion import prepare
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.recording import InertialSamples, Mounting
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.solution import solve
from sim_autopilot.lidar.livox import LivoxFaults, datagrams, write_pcap
from tests.lidar.recordings import small
from tests.lidar.test_livox import packet

BEGIN_NS = 7_000_000_000
LAG_NS = 123_456_789_000
"""Our clock less the lidar's."""


def mounting():
    lidar = small().lidar
    return Mounting(lidar.rotation, lidar.position)


def fly(rows, every=1, delay=lambda k: 300_000):
    """Let datagrams arrive, and take scans after each so many of them; return poses and all."""
    live, poses = Live(mounting(), Settings()), []
    for k, (t_ns, _, data) in enumerate(rows):
        live.receive(data, t_ns + LAG_NS + delay(k))
        if k % every == 0:
            while (job := live.take()) is not None:
                poses += live.process(job)
    return poses, live


def error(poses, shift_ns=0):
    """Return how far the last pose is off, m, in its own frame, by the way since the first one."""
    flown = small()
    t = np.array([one.t_ns - BEGIN_NS - shift_ns for one in poses]) * 1e-9
    way = flown.motion.position(t[-1:])[0] - flown.motion.position(t[:1])[0]
    C = flown.motion.rotation(t[:1])[0] @ poses[0].C.T
    return float(np.linalg.norm(C @ (poses[-1].pos - poses[0].pos) - way))


@pytest.fixture(scope="module")
def rows():
    return [row for row in datagrams(small(), BEGIN_NS) if row[0] < BEGIN_NS + 6_000_000_000]


@pytest.fixture(scope="module")
def clean(rows):
    return fly(rows)


def same(one, other):
    return (
        one.t_ns == other.t_ns
        and np.array_equal(one.pos, other.pos)
        and np.array_equal(one.C, other.C)
        and np.array_equal(one.P, other.P)
        and np.array_equal(one.estimate.P, other.estimate.P)
    )


def test_its_poses_are_those_of_the_truth(clean):
    poses, live = clean
    assert len(poses) == live.processed == 59
    assert error(poses) < 0.02
    assert sum(live.dropped.values()) == live.collector.lost == 0
    # Our clock, by the fastest sample
    assert {one.ours_ns - one.t_ns for one in poses} == {LAG_NS + 300_000}


def test_a_capture_gives_the_same_bits(rows, clean, tmp_path):
    write_pcap(tmp_path / "flight.pcap", iter(rows))
    recording = read(tmp_path / "flight.pcap", mounting=mounting())
    track = solve(recording, Settings()).track
    poses = clean[0]
    assert np.array_equal(track.pos_w, [one.estimate.state.pos_w for one in poses])
    assert np.array_equal(track.attitude, [one.estimate.state.C_wb for one in poses])
    P = np.array([np.triu(one.estimate.P[:9, :9]) for one in poses])
    assert np.array_equal(np.triu(track.covariance), P)
    relatives = [one.estimate.relative for one in poses if one.estimate.relative is not None]
    assert np.array_equal(track.relatives[:, 2:5], [one.pos for one in relatives])
    assert len(relatives) >= 4


@pytest.mark.parametrize("how", ["in bursts", "samples later", "points later"])
def test_when_datagrams_come_changes_no_bit(rows, clean, how):
    """Sockets are read by turns, and a busy computer reads them late."""
    if how == "in bursts":
        poses, _ = fly(rows, every=37)
    else:
        port = 56401 if how == "samples later" else 56301
        late = sorted(rows, key=lambda row: row[0] + 25_000_000 * (row[1] == port))
        poses, _ = fly(late)
    for one, other in zip(poses, clean[0], strict=False):
        assert same(one, other)
    assert len(poses) >= len(clean[0]) - 2


def test_what_is_judged_as_it_comes_is_judged_as_a_whole_one_would_be():
    """But for the largest reading by now, and one of the noise that looks like it."""
    rng = np.random.default_rng(3)
    t = 0.005 * np.arange(9000)
    values = rng.normal(0.0, 0.3, (9000, 6)) + 2.0 * np.sin(t)[:, None]
    values[:, 3:] *= 10.0
    values[:, 0] = np.clip(values[:, 0], -1.5, 1.5)
    whole = prepare(InertialSamples(t, values[:, :3], values[:, 3:]))
    heard = Heard()
    for stamp, row in zip(t.tolist(), values, strict=True):
        heard.add(stamp, row[:3], row[3:])
        heard.forget(stamp - 10.0)
    found = heard.samples()
    assert len(heard) < 5000
    assert found.step == pytest.approx(whole.step, rel=1e-9)
    kept = whole.is_clipped[-len(heard) :]
    assert kept[:, 0].sum() > 100
    assert (found.is_clipped != kept).sum() <= 2
    np.testing.assert_allclose(found.vibration[:-1], whole.vibration[-len(heard) : -1], rtol=1e-6)


def with_faults(**faults):
    flown = small()
    found = datagrams(flown, BEGIN_NS, LivoxFaults(**faults))
    return [row for row in found if row[0] < BEGIN_NS + 8_000_000_000]


def test_twice_exchanged_and_damaged_datagrams_cost_nothing():
    poses, live = fly(with_faults(times=2, exchanged=0.02, damaged=0.002))
    collector = live.collector
    assert collector.repeated > 2000
    assert collector.refused["wrong CRC"] > 0
    assert 0 < collector.lost < 20
    assert {one.world for one in poses} == {1}
    assert error(poses) < 0.03


def test_a_tenth_of_the_datagrams_is_lost():
    poses, live = fly(with_faults(lost=0.1))
    assert 60 < live.collector.lost < 140
    assert {one.world for one in poses} == {1}
    assert error(poses) < 0.05


@pytest.mark.parametrize(
    ("faults", "shift"),
    [
        ({"silent": (4.0, 5.5)}, 0.0),  # the cable is out
        ({"leap": (4.0, 1.79e9)}, 1.79e9),  # from its own clock to that of PTP
        ({"leap": (4.0, -3.0)}, -3.0),  # switched off and on, or set back
        ({"leap": (4.0, 0.3)}, 0.3),
        ({"without_imu": (4.0, 4.6)}, 0.0),
    ],
)
def test_where_nobody_knows_the_way_another_world_begins(faults, shift):
    poses, live = fly(with_faults(**faults))
    assert live.collector.run == 2
    first, second = ([one for one in poses if one.world == world] for world in (1, 2))
    assert error(first) < 0.03
    assert error(second, round(shift * 1e9)) < 0.03
    assert np.linalg.norm(second[0].pos) < 0.1
    assert np.trace(second[0].P) < 1e-3
    # Our clock goes on whatever the lidar's does
    ours = np.array([one.ours_ns for one in poses]) - LAG_NS - BEGIN_NS
    assert (np.diff(ours) > 0).all()
    assert ours[-1] < 8_000_000_000


@pytest.mark.parametrize("faults", [{"leap": (4.0, 0.15)}, {"silent": (4.0, 4.19)}])
def test_what_is_short_is_bridged(faults):
    poses, live = fly(with_faults(**faults))
    assert live.collector.run == 1
    assert error(poses, round(faults.get("leap", (0, 0))[1] * 1e9)) < 0.05


def test_without_inertial_samples_scans_are_dropped_not_kept():
    live = Live(mounting(), Settings())
    for t_ns, port, data in with_faults():
        if port == 56301:
            live.receive(data, t_ns)
    assert live.take() is None
    assert live.collector.run == 0
    assert live.dropped["no inertial samples"] == 0  # nothing has begun
    _, live = fly(with_faults(without_imu=(3.0, 3.6)))
    assert live.dropped["no inertial samples"] == 4


def test_a_computer_that_is_three_times_too_slow_drops_scans_and_keeps_few(rows):
    """Of three scans in 0.3 s it takes one; the rest is counted, and what it says is of now."""
    live, poses, free_ns, ages = Live(mounting(), Settings()), [], 0, []
    for t_ns, _, data in rows:
        live.receive(data, t_ns)
        assert len(live._waiting) <= MOST_WAITING
        if t_ns >= free_ns and (job := live.take()) is not None:
            free_ns = t_ns + 300_000_000
            found = live.process(job)
            poses += found
            ages += [t_ns - one.t_ns for one in found[-1:]]
    assert 30 < live.dropped["too slow"] < 45
    assert max(ages[1:]) < 350_000_000
    assert error(poses) < 0.1


@pytest.mark.parametrize(("seconds", "worlds"), [(7.0, {1}), (11.0, {1, 2})])
def test_seconds_without_points_are_bridged_as_long_as_samples_are_kept(seconds, worlds):
    flown = small(16.0)
    rows = [
        row
        for row in datagrams(flown, BEGIN_NS)
        if not (row[1] == 56301 and 2e9 < row[0] - BEGIN_NS < (2.0 + seconds) * 1e9)
    ]
    poses, live = fly(rows)
    assert {one.world for one in poses} == worlds
    assert live.collector.run == 1
    assert len(live.collector.heard) < 5000


def test_the_way_is_as_sure_as_its_relative_poses(clean):
    """The covariance of the way is the sum of theirs, and grows along what nothing holds."""
    poses = clean[0]
    P = np.array([one.P for one in poses])
    size = np.trace(P[:, :3, :3], axis1=1, axis2=2)
    assert (np.linalg.eigvalsh(P)[:, 0] > -1e-12).all()
    total = sum(np.trace(one.estimate.relative.P) for one in poses if one.estimate.relative)
    # The rest is height, by the tilt of the world
    assert size[-1] > 0.8 * total
    assert np.sqrt(size[-1]) < 0.2


def test_a_capture_of_several_lidars_is_that_of_the_one_that_sent_most(tmp_path):
    flown = small()
    many = [row for row in datagrams(flown, BEGIN_NS) if row[0] < BEGIN_NS + 3_000_000_000]
    write_pcap(tmp_path / "one.pcap", iter(many))
    write_pcap(tmp_path / "two.pcap", itertools.islice(many, 500), "192.168.1.160")
    second = (tmp_path / "two.pcap").read_bytes()[24:]
    both = (tmp_path / "one.pcap").read_bytes() + second
    (tmp_path / "both.pcap").write_bytes(both[:-10])  # and cut off
    recording = read(tmp_path / "both.pcap")
    assert "a Livox at 192.168.1.150" in recording.decisions[0]
    assert any("1 other lidars" in words for words in recording.decisions)
    assert len(list(recording.scans)) == len(list(recording.scans)) == 29
    points = [row for row in many if row[1] == 56301]
    write_pcap(tmp_path / "points.pcap", iter(points))
    with pytest.raises(LogError, match="no scan beside inertial samples"):
        read(tmp_path / "points.pcap")
    (tmp_path / "none.pcap").write_bytes(b"no capture")
    with pytest.raises(LogError, match=r"no \.pcap that can be read"):
        read(tmp_path / "none.pcap")


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(-3, 40), st.integers(0, 60)), max_size=80))
def test_whatever_the_stamps_do_samples_are_in_order_and_what_is_kept_is_bounded(steps):
    """Steps of 5 ms on, back or far, with points or samples, as nobody has planned them."""
    live, t_ns = Live(mounting(), Settings()), 10**10
    for k, (is_imu, step, leap) in enumerate(steps):
        t_ns = max(t_ns + 5_000_000 * step + (10**11 if leap == 60 else 0), 1)
        data = struct.pack("<6f", 0.1, 0.2, 0.3, 0.0, 0.0, 1.0) if is_imu else bytes(14)
        live.receive(packet(0 if is_imu else 1, data, t_ns=t_ns, number=k), 10**12 + t_ns)
        assert len(live._waiting) <= MOST_WAITING
        while (job := live.take()) is not None:
            assert (np.diff(job.samples.stamp) > 0).all()
            assert job.packed.end <= live.collector.heard.judged
        assert (np.diff(live.collector.heard.samples().stamp) > 0).all()


def test_samples_that_are_judged_already_stay_as_they_are(clean):
    heard = clean[1].collector.heard.samples()
    assert prepare(heard) is heard
    assert prepare(replace(heard)) is not heard
