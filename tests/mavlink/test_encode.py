"""What we say, read back by pymavlink, against the rules of those who listen."""

from array import array

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import Sender, pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import EstimatorType, Frame, SystemStatus
from ekf_companion.mavlink.messages import by_name
from ekf_companion.nav import so3
from ekf_companion.nav.state import Odometry, Status

NUMBERS = [float(n) for n in range(55)]


def read(name, payload):
    """Return the message as pymavlink reads it off the wire."""
    return dialect.MAVLink(None).decode(bytearray(Sender(1, 194).frame(name, payload)))


def estimate(**changes):
    values = {
        "t_ns": 123_456_789_000,
        "numbers": array("f", NUMBERS).tobytes(),
        "reset_count": 0,
        "quality": 80,
    }
    return Odometry(**(values | changes))


def odometry(said=None, **options):
    return read("ODOMETRY", encode.odometry(said or estimate(), **options))


def test_odometry_says_its_numbers_in_their_order():
    m = odometry()
    assert m.time_usec == 123_456_789
    assert (m.frame_id, m.child_frame_id) == (20, 12)
    said = [m.x, m.y, m.z, *m.q, m.vx, m.vy, m.vz, m.rollspeed, m.pitchspeed, m.yawspeed]
    assert said + m.pose_covariance + m.velocity_covariance == NUMBERS
    assert (m.reset_counter, m.estimator_type, m.quality) == (1, 5, 80)


def test_px4_is_told_north_and_ardupilot_what_it_takes():
    assert encode.label(Family.PX4, "auto", "auto").frame is Frame.LOCAL_NED
    assert encode.label(Family.ARDUPILOT, "auto", "auto").frame is Frame.LOCAL_FRD
    assert encode.label(Family.UNKNOWN, "auto", "auto").frame is Frame.LOCAL_FRD
    assert encode.label(Family.PX4, "LOCAL_FRD", "auto").frame is Frame.LOCAL_FRD


@pytest.mark.parametrize(
    ("family", "frame", "velocity"),
    [
        (Family.PX4, "auto", Frame.LOCAL_NED),
        (Family.PX4, "LOCAL_FRD", Frame.BODY_FRD),
        (Family.PX4, "continuous", Frame.BODY_FRD),
        (Family.ARDUPILOT, "auto", Frame.BODY_FRD),
        (Family.UNKNOWN, "LOCAL_NED", Frame.BODY_FRD),
    ],
)
def test_the_velocity_has_the_axes_of_a_frame_that_points_north_towards_px4(
    family, frame, velocity
):
    assert encode.label(family, frame, "auto").velocity is velocity
    assert odometry(velocity=velocity).child_frame_id == velocity


def test_its_payload_is_what_the_definition_says():
    assert len(encode.odometry(estimate())) == by_name("ODOMETRY").size


def test_a_monitor_gets_the_north_east_down_frame():
    assert odometry(frame=Frame.LOCAL_NED).frame_id == 1


def test_the_reset_counter_starts_at_one_and_never_says_zero():
    """Rule 23: one more at each jump, and after 255 it is 1."""
    said = [odometry(estimate(reset_count=count)).reset_counter for count in range(600)]
    assert said[0] == 1
    assert said[253:257] == [254, 255, 1, 2]
    assert set(said) == set(range(1, 256))


@pytest.mark.parametrize(("quality", "said"), [(-7, -1), (-1, -1), (0, 0), (100, 100), (300, 100)])
def test_quality_keeps_to_its_range(quality, said):
    assert odometry(estimate(quality=quality)).quality == said


def test_no_autopilot_is_told_a_type_that_it_refuses():
    assert encode.label(Family.PX4, "LOCAL_FRD", "auto").estimator is EstimatorType.VIO
    assert encode.label(Family.ARDUPILOT, "LOCAL_FRD", "auto").estimator is EstimatorType.GPS_INS
    assert encode.label(Family.UNKNOWN, "LOCAL_FRD", "auto").estimator is EstimatorType.GPS_INS
    assert (EstimatorType.VIO, EstimatorType.GPS_INS) == (
        dialect.MAV_ESTIMATOR_TYPE_VIO,
        dialect.MAV_ESTIMATOR_TYPE_GPS_INS,
    )


def test_the_numbers_of_the_protocol_are_its_own():
    for ours, prefix in (
        (Frame, "MAV_FRAME_"),
        (EstimatorType, "MAV_ESTIMATOR_TYPE_"),
        (SystemStatus, "MAV_STATE_"),
    ):
        for member in ours:
            assert member.value == getattr(dialect, prefix + member.name)
    assert encode.SET_MESSAGE_INTERVAL == dialect.MAV_CMD_SET_MESSAGE_INTERVAL


def test_the_heartbeat_is_an_onboard_controllers():
    m = read("HEARTBEAT", encode.heartbeat(SystemStatus.ACTIVE))
    assert m.type == dialect.MAV_TYPE_ONBOARD_CONTROLLER
    assert m.autopilot == dialect.MAV_AUTOPILOT_INVALID
    assert (m.base_mode, m.system_status, m.mavlink_version) == (0, 4, 3)


def test_every_status_has_a_word_in_the_heartbeat():
    assert set(encode.SYSTEM_STATUS) == set(Status)


@pytest.mark.parametrize(("rate", "interval_us"), [(250.0, 4000.0), (3.0, 333333.0), (0.0, -1.0)])
def test_a_message_is_asked_for_by_its_interval(rate, interval_us):
    payload = encode.request_message(105, rate, target_system=3, target_component=1, confirmation=2)
    m = read("COMMAND_LONG", payload)
    assert (m.target_system, m.target_component, m.confirmation) == (3, 1, 2)
    assert (m.command, m.param1, m.param2) == (511, 105.0, interval_us)


def test_timesync_carries_its_targets_in_18_bytes():
    """Rule 27."""
    payload = pack("TIMESYNC", tc1=5, ts1=-7, target_system=1, target_component=1)
    assert len(payload) == 18
    assert payload[16:] == b"\x01\x01"
    m = read("TIMESYNC", payload)
    assert (m.tc1, m.ts1) == (5, -7)


def test_estimator_status_says_ratios_and_accuracies():
    flags = encode.StatusFlag.ATTITUDE | encode.StatusFlag.POS_HORIZ_ABS
    payload = encode.estimator_status(5_000_000, flags, (0.25, 0.5, 0.75, 1.5), (2.0, 3.0))
    m = read("ESTIMATOR_STATUS", payload)
    assert (m.time_usec, m.flags) == (5_000, 17)
    assert (m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio) == (0.25, 0.5, 0.75, 1.5)
    assert (m.pos_horiz_accuracy, m.pos_vert_accuracy) == (2.0, 3.0)
    for flag in set(encode.StatusFlag) - {encode.StatusFlag.NONE}:  # Python 3.10 lists it too
        assert flag.value == getattr(dialect, f"ESTIMATOR_{flag.name}")


def test_a_position_is_told_as_maps_of_ground_stations_read_it():
    place, velocity = (47.3977419, 8.5455938, 488.25), (1.5, -2.25, 400.0)
    payload = encode.global_position(123_456_789_000, place, 12.5, velocity, -0.5)
    m = read("GLOBAL_POSITION_INT", payload)
    assert m.time_boot_ms == 123_456
    assert (m.lat, m.lon, m.alt, m.relative_alt) == (473977419, 85455938, 488_250, 12_500)
    # Beyond what the field holds, the largest; a heading from north, clockwise, 0.01 deg
    assert (m.vx, m.vy, m.vz) == (150, -225, 32767)
    assert m.hdg == 33135


def test_what_old_firmware_reads_says_the_numbers_of_odometry():
    q = so3.from_euler(0.1, -0.2, 0.7)
    numbers = array("f", [1.0, 2.0, 3.0, *q, 4.0, 5.0, 6.0, *NUMBERS[10:]]).tobytes()
    said = estimate(numbers=numbers, reset_count=255)
    pose = read("VISION_POSITION_ESTIMATE", encode.vision_position_estimate(said))
    assert (pose.usec, pose.x, pose.y, pose.z) == (123_456_789, 1.0, 2.0, 3.0)
    assert [pose.roll, pose.pitch, pose.yaw] == pytest.approx([0.1, -0.2, 0.7], abs=1e-6)
    assert pose.covariance == NUMBERS[13:34]
    speed = read("VISION_SPEED_ESTIMATE", encode.vision_speed_estimate(said))
    assert (speed.usec, speed.x, speed.y, speed.z) == (123_456_789, 4.0, 5.0, 6.0)
    # The triangle of six rows begins at 34: its first three rows and columns, whole
    assert speed.covariance == [34.0, 35.0, 36.0, 35.0, 40.0, 41.0, 36.0, 41.0, 45.0]
    assert pose.reset_counter == speed.reset_counter == 1
