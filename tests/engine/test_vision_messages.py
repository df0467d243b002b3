"""VISION_POSITION_ESTIMATE and VISION_SPEED_ESTIMATE for firmware that knows no ODOMETRY."""

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
        (Family.PX4, "0.3.1", True),
        (Family.ARDUPILOT, "1.16.0", True),
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


def test_its_velocity_is_north_east_and_down_and_its_pose_is_where_it_flies():
    name, seconds = "ardupilot-4.0", 22.0
    *_, of = flown(name, seconds, message="vision_position_estimate")
    flight = Flight.plan("figure-eight", parse(name).suited(SimConfig()), duration=seconds)
    truth = {cycle.t_ns // 1000: cycle.estimate for cycle in flight.cycles()}
    stamps = np.array(sorted(truth))
    speeds, start = of(SPEED), None
    for pose, speed in zip(of(POSE), speeds, strict=True):
        true = truth[int(stamps[np.abs(stamps - pose.usec).argmin()])]
        assert [speed.x, speed.y, speed.z] == pytest.approx(true.vel_n, abs=1.0)
        assert so3.wrap(pose.yaw - true.euler[2]) == pytest.approx(0.0, abs=0.2)
        apart = np.array([pose.x, pose.y, pose.z]) - true.pos_n
        start = apart if start is None else start
        assert apart == pytest.approx(start, abs=2.0)
    # So fast, and both ways, that axes of the body would show
    north = [speed.x for speed in speeds]
    assert min(north) < -3.0 < 3.0 < max(north)
