"""Messages of ROS 2 as they come: units and times are those by which a bag would be read."""

from __future__ import annotations

from zlib import crc32

import numpy as np
import pytest

from ekf_companion.lidar.live import Live
from ekf_companion.lidar.messages import SAMPLES, SCANS, Messages
from ekf_companion.lidar.recording import Mounting
from ekf_companion.lidar.settings import Settings
from ekf_companion.nav.earth import STANDARD_GRAVITY
from tests.lidar.recordings import DIALECTS, after, cloud, imu, points, small
from tests.lidar.test_live import error

EPOCH_NS = 1_700_000_000_000_000_000


def ns(seconds):
    return EPOCH_NS + round(float(seconds) * 1e9)


@pytest.mark.parametrize("dialect", [*DIALECTS])
def test_scans_are_those_that_were_sent_by_each_dialect_of_time(dialect):
    flown, messages = small(), Messages()
    found = [
        messages.scans(cloud(flown, k, 0, dialect, 1.7e9), ns(flown.stamp[k])) for k in range(8)
    ]
    assert [len(one) for one in found] == [*[0] * SCANS, 1, 1, 1]
    for k in range(SCANS, 8):
        one = found[k][0]
        begin = flown.stamp[k] if dialect != "none" else flown.stamp[k] + 0.05
        # a double of seconds since 1970 has steps of 0.2 us, a float32 of seconds of 7 ns
        assert one.t_ns == pytest.approx(ns(begin), abs=1000 if dialect != "none" else 2_000_000)
        assert np.allclose(one.scan.points, points(flown, k), atol=1e-5)
        times = after(flown, k) if dialect != "none" else np.zeros(len(one.scan.times))
        assert np.allclose(one.scan.times, times, atol=1e-6)
    assert any("times of points" in words or "no time" in words for words in messages.decisions())
    assert messages.decisions() == []


@pytest.mark.parametrize("unit", [1.0, STANDARD_GRAVITY], ids=["m/s2", "g"])
def test_specific_force_in_g_is_known_by_its_size(unit):
    """Livox' driver publishes g."""
    flown, messages, found = small(), Messages(), []
    for k in range(SAMPLES + 3):
        data = b"%d" % k
        found += messages.samples(imu(flown, k, 0, unit), ns(flown.imu_stamp[k]), data)
    assert len(found) == 3
    assert np.allclose([one.accel for one in found], flown.accel[SAMPLES:][:3])
    assert np.array_equal([one.gyro for one in found], flown.gyro[SAMPLES:][:3])
    assert [one.t_ns for one in found] == [ns(t) for t in flown.imu_stamp[SAMPLES:][:3]]
    assert found[2].check == crc32(b"%d" % (SAMPLES + 2))


def test_what_cannot_be_used_is_counted_by_its_reason():
    flown, messages = small(), Messages()
    broken = imu(flown, 0, 0)
    broken.angular_velocity.x = np.nan
    assert messages.samples(broken, EPOCH_NS, b"") == []
    cut = cloud(flown, 0, 0)
    cut.data = cut.data[:-9]
    assert messages.scans(cut, EPOCH_NS) == []
    for _ in range(SCANS):  # no stamps: nothing says how far apart they are
        assert messages.scans(cloud(flown, 0, 0), 0) == []
    assert list(messages.refused.values()) == [1, 1, SCANS]
    assert any("different stamps" in words for words in messages.refused)
    # And those that follow decide
    found = [messages.scans(cloud(flown, k, 0), ns(flown.stamp[k])) for k in range(SCANS + 1)]
    assert len(found[-1]) == 1


def rows(flown, last):
    """Return messages in the order of their ends: when each can be sent."""
    found = [(float(t), "imu", k) for k, t in enumerate(flown.imu_stamp) if t < last]
    ends = [(float(t + after(flown, k).max()), "cloud", k) for k, t in enumerate(flown.stamp)]
    return sorted(found + [row for row in ends if row[0] < last])


def fly(flown, change=lambda row: [row], last=7.0):
    lidar = flown.lidar
    live, messages = Live(Mounting(lidar.rotation, lidar.position), Settings()), Messages()
    poses = []
    for _, kind, k in (one for row in rows(flown, last) for one in change(row)):
        if kind == "imu":
            t_ns = ns(flown.imu_stamp[k])
            found = messages.samples(imu(flown, k, 0, STANDARD_GRAVITY), t_ns, b"%d" % k)
        else:
            t_ns = ns(flown.stamp[k])
            found = messages.scans(cloud(flown, k, 0), t_ns)
        for one in found:
            live.take_in(one, t_ns - EPOCH_NS + 1_000_000)
        while (job := live.take()) is not None:
            poses += live.process(job)
    return poses, live


def test_its_poses_are_those_of_the_truth():
    flown = small()
    poses, live = fly(flown)
    assert len(poses) > 60
    assert {one.world for one in poses} == {1}
    assert error(poses, EPOCH_NS - 7_000_000_000) < 0.02
    assert sum(live.dropped.values()) == live.collector.late == 0
    assert {one.ours_ns - one.t_ns for one in poses} == {1_000_000 - EPOCH_NS}


def test_messages_that_come_twice_or_late_cost_nothing():
    def change(row):
        _, kind, k = row
        again = [row, row] if k % 7 == 3 else [row]
        return again if kind == "imu" or k % 9 else [row, (0.0, "cloud", max(k - 2, 0))]

    poses, live = fly(small(), change)
    assert live.collector.late > 5
    assert live.collector.repeated > 50
    assert len(poses) > 60
    assert error(poses, EPOCH_NS - 7_000_000_000) < 0.02


def test_a_driver_that_restarts_begins_another_world():
    def change(row):
        return [] if 3.5 < row[0] < 4.2 else [row]

    poses, live = fly(small(), change)
    assert {one.world for one in poses} == {1, 2}
    assert live.collector.run == 2
