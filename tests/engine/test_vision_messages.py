"""VISION_POSITION_ESTIMATE and VISION_SPEED_ESTIMATE for firmware that knows no ODOMETRY."""

import math

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import knows_odometry
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import parse
from sim_autopilot.flight import Flight

POSE, SPEED = "VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE"
MASK = "px4-1.8:EKF2_AID_MASK=24"


def flown(personality, seconds=9.0, **odometry):
    """Return an autopilot, a companion and what that sent, by name."""
    firmware = parse(personality)
    config = firmware.suited(SimConfig())
    autopilot = Autopilot(config, firmware)
    odometry = {"mode": "always"} | odometry
    companion = Companion(Config(output=OutputConfig(odometry=OdometryConfig(**odometry))))
    sent = []
    for cycle in Flight.plan("figure-eight", config, duration=seconds).cycles():
        autopilot.cycle(cycle)
        companion.receive(b"".join(autopilot.data_to_send()), cycle.t_ns)
        companion.tick(cycle.t_ns)
        for data in companion.data_to_send():
            sent += Splitter().feed(data)
            autopilot.receive(data, cycle.t_ns)

    def of(name):
        return [unpack(frame) for frame in sent if frame.message_id == IDS[name]]

    return autopilot, companion, of


@pytest.mark.parametrize(
    ("family", "version", "known"),
    [
        (Family.PX4, "1.8.2", False),
        (Family.PX4, "1.9.0", True),
        (Family.PX4, "1.16.0", True),
        (Family.ARDUPILOT, "4.0.7", False),
        (Family.ARDUPILOT, "3.6.12", False),
        (Family.ARDUPILOT, "4.1.0", True),
        (Family.UNKNOWN, "0.1.0", True),
        (Family.PX4, "", True),
    ],
)
def test_which_firmware_knows_odometry(family, version, known):
    assert knows_odometry(family, version) is known


@pytest.mark.parametrize("personality", ["px4", "ardupilot", "ardupilot-old", "px4-1.13"])
def test_newer_firmware_is_sent_odometry_alone(personality):
    *_, of = flown(personality)
    assert of("ODOMETRY")
    assert not of(POSE) + of(SPEED)


def test_an_old_ardupilot_takes_pose_and_velocity():
    autopilot, companion, of = flown("ardupilot-4.0:EK2_GPS_TYPE=3")
    poses, speeds = of(POSE), of(SPEED)
    assert len(poses) == len(speeds) > 50
    assert [m.usec for m in poses] == [m.usec for m in speeds]
    reception = autopilot.reception
    assert reception.accepted == reception.fused == len(poses)
    # What went before its version was known, it has ignored
    assert set(reception.refused) <= {"this firmware does not know ODOMETRY"}
    assert sum(reception.refused.values()) == len(of("ODOMETRY"))
    assert all(message.time_usec < poses[0].usec for message in of("ODOMETRY"))
    # What its parameters do not show: its position may be ours
    assert companion.session.decoder.is_ours
    assert companion.session.decoder.is_yaw_ours


def test_an_old_px4_takes_the_pose_and_is_sent_no_velocity():
    autopilot, _, of = flown(MASK)
    assert len(of(POSE)) > 50
    assert not of(SPEED)
    assert autopilot.reception.accepted == len(of(POSE))
    assert len(of(POSE)) - autopilot.reception.fused <= 2


def test_the_guard_withholds_it_as_it_does_odometry():
    _, companion, of = flown("px4-1.8:EKF2_AID_MASK=25", mode="auto")
    assert not of(POSE)
    assert companion.session.outbox.withheld[POSE] > 50
    assert companion.session.stream_state.remedy.startswith("set EKF2_AID_MASK to 24")


def test_it_can_be_asked_for_whatever_the_firmware():
    *_, of = flown("ardupilot", message="vision_position_estimate")
    assert of(POSE)
    assert not of("ODOMETRY")
    *_, of = flown("ardupilot-4.0", message="odometry")
    assert of("ODOMETRY")
    assert not of(POSE)


def test_it_says_the_numbers_of_odometry():
    *_, of = flown("ardupilot-4.0", message="vision_position_estimate", covariance="whole")
    *_, as_odometry = flown("ardupilot-4.0", message="odometry", covariance="whole")
    twins = {m.time_usec: m for m in as_odometry("ODOMETRY")}
    pairs = [(p, s, twins[p.usec]) for p, s in zip(of(POSE), of(SPEED), strict=True)]
    assert len(pairs) > 50
    for pose, speed, twin in pairs:
        assert (pose.x, pose.y, pose.z) == (twin.x, twin.y, twin.z)
        euler = so3.to_euler(np.array(twin.q))
        assert [pose.roll, pose.pitch, pose.yaw] == pytest.approx(euler, abs=1e-6)
        assert pose.covariance == twin.pose_covariance
        assert pose.reset_counter == speed.reset_counter == twin.reset_counter
        # North, east and down, and its covariance likewise
        vel_n = so3.rotate(np.array(twin.q), [twin.vx, twin.vy, twin.vz])
        assert [speed.x, speed.y, speed.z] == pytest.approx(vel_n, abs=1e-5)
        C = np.zeros((3, 3))
        C[np.triu_indices(3)] = [twin.velocity_covariance[k] for k in (0, 1, 2, 6, 7, 11)]
        C = C + np.triu(C, 1).T
        R = np.column_stack([so3.rotate(np.array(twin.q), axis) for axis in np.eye(3)])
        P = np.reshape(speed.covariance, (3, 3))
        assert pytest.approx(R @ C @ R.T, rel=1e-3, abs=1e-6) == P
    assert max(abs(pose.yaw) for pose, *_ in pairs) > 0.5
    assert not any(math.isnan(one) for pose, *_ in pairs for one in pose.covariance)
