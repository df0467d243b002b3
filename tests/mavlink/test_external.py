"""Poses and velocities of other components: frames, stamps, who counts."""

import math

import numpy as np
import pytest

from ekf_companion.mavlink.decode.external import RANGES
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.second_source import POSES
from ekf_companion.mavlink.session import Session, SessionOptions
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import AnchorSample, Kind, PoseSample, VelocitySample
from tests.mavlink.conversation import MS, SECOND, Voice, met

NAN = math.nan
COVARIANCE = [0.0] * 21
for place, value in ((0, 0.04), (6, 0.04), (11, 0.04), (20, 0.01)):
    COVARIANCE[place] = value
VISION = Voice(1, 197)
TURNED = tuple(so3.from_euler(0.0, 0.0, 0.5).tolist())
ODOMETRY = {
    "x": 1.0,
    "y": 2.0,
    "z": 3.0,
    "q": TURNED,
    "vx": 4.0,
    "vy": 5.0,
    "vz": 6.0,
    "pose_covariance": COVARIANCE,
    "velocity_covariance": COVARIANCE,
    "frame_id": 20,
    "child_frame_id": 12,
    "reset_counter": 7,
    "estimator_type": 2,
    "quality": 90,
}

TIME_USEC = ("ODOMETRY", "ATT_POS_MOCAP", "RANGING_BEACON", "VISION_POSITION_DELTA")
RANGE = {
    "beacon_id": 3,
    "range": 12_345,
    "range_accuracy": 80,
    "lat": 473_977_420,
    "lon": 85_455_940,
    "alt": 490.2,
    "alt_type": 1,
}
UNKNOWN = {"range_accuracy": 2**32 - 1, "lat": 2**31 - 1}


class Link:
    """A session that knows its autopilot's clock, at 10 s."""

    def __init__(self, reads_others=True):
        self.session, self.autopilot = met(reads_others=reads_others)
        self.now_ns = 10 * SECOND
        self.tell_time()

    def tell_time(self):
        sample = {"time_usec": self.now_ns // 1000, "zacc": -9.81, "fields_updated": 0x3F}
        self.session.receive(self.autopilot.say("HIGHRES_IMU", **sample), self.now_ns)

    def go(self, seconds):
        self.now_ns += round(seconds * SECOND)
        self.tell_time()

    def hear(self, name, voice=VISION, **fields):
        stamp = "time_usec" if name in TIME_USEC else "usec"
        said = voice.say(name, **({stamp: self.now_ns // 1000} | fields))
        return self.session.receive(said, self.now_ns)


def pose_and_velocity(**fields):
    found = Link().hear("ODOMETRY", **(ODOMETRY | fields))
    assert [type(one) for one in found] == [PoseSample, VelocitySample]
    return found


def test_odometry_is_a_pose_and_a_velocity_in_the_body():
    pose, velocity = pose_and_velocity()
    assert (pose.t_ns, pose.x, pose.y, pose.z, pose.counter) == (10 * SECOND, 1.0, 2.0, 3.0, 7)
    assert (pose.yaw, pose.std) == pytest.approx((0.5, 0.2), rel=1e-6)
    assert (velocity.x, velocity.y, velocity.z) == (4.0, 5.0, 6.0)
    assert velocity.std == pytest.approx(0.2, rel=1e-6)
    assert not velocity.is_level


@pytest.mark.parametrize(
    ("frame", "place", "yaw"),
    [
        *((frame, (1.0, 2.0, 3.0), 0.5) for frame in (1, 14, 16, 18, 20)),
        (21, (1.0, -2.0, -3.0), -0.5),
        *((frame, (2.0, 1.0, -3.0), math.pi / 2.0 - 0.5) for frame in (4, 15, 17, 19)),
    ],
)
def test_every_frame_becomes_one_whose_z_points_down(frame, place, yaw):
    pose, _ = pose_and_velocity(frame_id=frame)
    assert (pose.x, pose.y, pose.z) == place
    assert pose.yaw == pytest.approx(yaw, abs=1e-6)


@pytest.mark.parametrize(
    ("child", "found", "is_level"),
    [
        (8, (4.0, 5.0, 6.0), False),
        (12, (4.0, 5.0, 6.0), False),
        (13, (4.0, -5.0, -6.0), False),
        (1, (4.0, 5.0, 6.0), True),
        (21, (4.0, -5.0, -6.0), True),
    ],
)
def test_a_velocity_is_in_its_child_frame(child, found, is_level):
    _, velocity = pose_and_velocity(child_frame_id=child)
    assert (velocity.x, velocity.y, velocity.z, velocity.is_level) == (*found, is_level)


def triangle(way, turn=0.01):
    """Return the upper triangle of a covariance of a place, m^2, and of yaw, rad^2."""
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[5, 5] = way, turn
    return whole[np.triu_indices(6)].tolist()


def drifts(stated, **fields):
    """Return the covariance of the drift of each pose, and sigma of its yaw's; None: none."""
    link, found = Link(), []
    for k, (one, counter) in enumerate(stated):
        link.go(0.1)
        said = {"x": float(k), "pose_covariance": one, "reset_counter": counter, **fields}
        pose, *_ = link.hear("ODOMETRY", **ODOMETRY | said)
        P = None
        if pose.drift is not None:
            L = np.zeros((3, 3))
            L[np.tril_indices(3)] = pose.drift
            P = L @ L.T
        found.append((P, pose.yaw_drift))
    return found


def test_by_what_its_covariance_grows_a_source_may_have_drifted():
    first = np.diag([0.04, 0.04, 0.09])
    way = np.array([[0.02, 0.01, 0.0], [0.01, 0.03, -0.005], [0.0, -0.005, 0.001]])
    stated = [triangle(first), triangle(first + way, 0.0104), triangle(first + way, 0.0104)]
    begin, grown, same = drifts([(one, 7) for one in stated])
    assert begin == (None, None)
    np.testing.assert_allclose(grown[0], way, atol=1e-8)  # float32
    assert same[0] is None or np.abs(same[0]).max() < 1e-15
    assert same[1] is None
    assert grown[1] == pytest.approx(0.02, rel=1e-3)


def test_what_shrinks_between_does_not_count_twice():
    level = [0.04, 0.05, 0.045, 0.05, 0.06]
    found = drifts([(triangle(np.eye(3) * one), 7) for one in level])
    total = sum(P[0, 0] for P, _ in found if P is not None)
    assert total == pytest.approx(0.02, rel=1e-4)
    # along one axis it may grow while it shrinks along the others
    ways = [np.diag([1.0, 1.0, 1.0]), np.diag([2.0, 0.5, 0.5])]
    _, (P, _) = drifts([(triangle(way), 7) for way in ways])
    np.testing.assert_allclose(P, np.diag([1.0, 0.0, 0.0]), atol=1e-6)


def test_a_source_that_begins_anew_has_not_drifted():
    level = [(0.04, 7), (4.0, 8), (0.01, 8), (0.02, 8)]
    found = drifts([(triangle(np.eye(3) * one), counter) for one, counter in level])
    assert [P is None for P, _ in found] == [True, True, True, False]
    assert found[3][0][0, 0] == pytest.approx(0.01, rel=1e-4)


@pytest.mark.parametrize(
    "wrong", [[NAN] * 21, [0.0] * 21, triangle(np.eye(3))[:11] + [NAN] + [0.0] * 9]
)
def test_a_source_that_states_none_has_not_said_that_it_drifts(wrong):
    found = drifts([(wrong, 7), (wrong, 7), (triangle(np.eye(3)), 7)])
    assert found == [(None, None)] * 3


def test_the_drift_is_along_the_axes_of_a_frame_whose_z_points_down():
    ways = [np.eye(3), np.eye(3) + np.outer((3.0, 2.0, 1.0), (3.0, 2.0, 1.0))]
    _, (P, _) = drifts([(triangle(way), 7) for way in ways], frame_id=4)  # east, north, up
    np.testing.assert_allclose(P, np.outer((2.0, 3.0, -1.0), (2.0, 3.0, -1.0)), atol=1e-5)


@pytest.mark.parametrize("frame", [0, 3, 9])
def test_a_frame_that_is_none_of_them_is_refused(frame):
    link = Link()
    (velocity,) = link.hear("ODOMETRY", **ODOMETRY | {"frame_id": frame})
    assert type(velocity) is VelocitySample
    assert link.session.decoder.refused["odometry: a frame that moves, or is not known"] == 1


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"estimator_type": 4}, "has GNSS in it, or is the autopilot's own"),
        ({"estimator_type": 5}, "has GNSS in it, or is the autopilot's own"),
        ({"estimator_type": 8}, "has GNSS in it, or is the autopilot's own"),
        ({"quality": -1}, "failed, its source says"),
    ],
)
def test_what_has_our_sensors_in_it_or_has_failed_is_refused(fields, why):
    link = Link()
    assert link.hear("ODOMETRY", **ODOMETRY | fields) == []
    assert link.session.decoder.refused == {f"odometry: {why}": 1}


@pytest.mark.parametrize(
    ("fields", "known"),
    [
        ({"q": (NAN,) * 4}, {"yaw": None}),
        ({"q": (0.0,) * 4}, {"yaw": None}),
        ({"pose_covariance": [NAN] * 21}, {"std": None}),
        ({"pose_covariance": [0.0] * 21}, {"std": None}),
        ({"pose_covariance": [0.04, *[NAN] * 20]}, {"std": None}),
    ],
)
def test_what_it_does_not_know_is_none(fields, known):
    pose, _ = pose_and_velocity(**fields)
    assert {name: getattr(pose, name) for name in known} == known


def test_a_place_that_is_no_number_leaves_the_velocity():
    (found,) = Link().hear("ODOMETRY", **ODOMETRY | {"x": NAN})
    assert type(found) is VelocitySample


@pytest.mark.parametrize(
    "name",
    ["VISION_POSITION_ESTIMATE", "GLOBAL_VISION_POSITION_ESTIMATE", "VICON_POSITION_ESTIMATE"],
)
def test_euler_angles_and_a_place(name):
    fields = {"x": 1.0, "y": 2.0, "z": 3.0, "yaw": 0.5, "covariance": COVARIANCE}
    (pose,) = Link().hear(name, **fields)
    assert (pose.x, pose.y, pose.z, pose.yaw) == (1.0, 2.0, 3.0, 0.5)
    assert pose.std == pytest.approx(0.2)
    assert pose.counter == (None if name.startswith("VICON") else 0)


def test_a_pose_of_motion_capture():
    fields = {"x": 1.0, "y": 2.0, "z": 3.0, "q": TURNED, "covariance": [NAN] * 21}
    (pose,) = Link().hear("ATT_POS_MOCAP", **fields)
    assert (pose.x, pose.yaw, pose.std, pose.counter) == (1.0, pytest.approx(0.5), None, None)


def test_a_speed_is_in_a_level_frame():
    covariance = [0.09, 0, 0, 0, 0.09, 0, 0, 0, 0.09]
    fields = {"x": 1.0, "y": 2.0, "z": 3.0, "covariance": covariance}
    (found,) = Link().hear("VISION_SPEED_ESTIMATE", **fields)
    assert (found.x, found.y, found.z, found.is_level) == (1.0, 2.0, 3.0, True)
    assert found.std == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("voice", "is_read"),
    [
        (Voice(1, 197), True),
        (Voice(1, 1), False),  # the autopilot's own
        (Voice(1, 194), False),  # ours, that came back
        (Voice(245, 190), True),  # a ground station with motion capture
        (Voice(2, 197), False),  # another vehicle's
    ],
)
def test_who_is_listened_to(voice, is_read):
    assert bool(Link().hear("ODOMETRY", voice, **ODOMETRY)) is is_read


def test_nobody_is_listened_to_unless_told():
    link = Link(reads_others=False)
    assert link.hear("ODOMETRY", **ODOMETRY) == []
    assert link.session.decoder.refused == {}


def test_before_the_autopilots_clock_is_known_nothing_is_read():
    session, _ = met(reads_others=True)
    assert session.receive(VISION.say("ODOMETRY", time_usec=5, **ODOMETRY), 0) == []


def test_of_two_senders_the_first_counts_until_it_is_silent():
    link, other = Link(), Voice(1, 198)
    counted = []
    for k in range(200):
        link.go(0.05)
        for voice in [other] if k >= 100 else [VISION, other]:
            fields = {"x": float(k), "covariance": COVARIANCE}
            counted += [voice] * len(link.hear("VISION_POSITION_ESTIMATE", voice, **fields))
    assert counted[:100] == [VISION] * 100
    assert len(counted[100:]) == 100 - 60  # three seconds at 20 Hz
    assert link.session.decoder.external.used == {Kind.POSE: "1/198 VISION_POSITION_ESTIMATE"}


@pytest.mark.parametrize("offset_us", [0, -7_000_000, 1_780_000_000_000_000])
def test_stamps_of_another_clock_are_brought_to_the_autopilots(offset_us):
    """What comes late comes late: the least lag counts."""
    link, lags = Link(), [0.0, 0.03, 0.01, 0.2, 0.0]
    found = []
    for lag in lags * 10:
        for _ in range(5):
            link.go(0.05)
        stamp_us = link.now_ns // 1000 - round(lag * 1e6) + offset_us
        (pose,) = link.hear("VISION_POSITION_ESTIMATE", usec=stamp_us, x=1.0)
        found.append((link.now_ns - pose.t_ns) * 1e-9)
    assert found == pytest.approx(lags * 10, abs=1e-4)


def test_a_range_to_an_anchor_is_read_unasked():
    link = Link(reads_others=False)
    (found,) = link.hear("RANGING_BEACON", **RANGE)
    assert type(found) is AnchorSample
    assert (found.t_ns, found.anchor, found.range, found.std) == (link.now_ns, 3, 12.345, 0.08)
    lat, lon, alt = found.place
    assert (math.degrees(lat), math.degrees(lon)) == pytest.approx((47.397742, 8.545594))
    assert found.row()[2][:6] == (12.345, 3.0, lat, lon, alt, 1.0)
    assert alt == pytest.approx(490.2)
    assert link.session.decoder.external.used == {Kind.ANCHOR: "1/197 RANGING_BEACON"}


@pytest.mark.parametrize("fields", [UNKNOWN, {"alt": NAN}, {"alt_type": 0}, {"lon": 2**31 - 1}])
def test_an_anchor_whose_place_is_not_stated_is_that_of_the_configuration(fields):
    (found,) = Link().hear("RANGING_BEACON", **(RANGE | fields))
    assert found.place is None
    assert found.std == (None if "range_accuracy" in fields else 0.08)
    assert np.isnan(found.row()[2][2:6]).all()


@pytest.mark.parametrize("fields", [{"range": 2**32 - 1}, {"range": 0}, {"status": 1}])
def test_what_is_no_range_is_left_out(fields):
    assert Link().hear("RANGING_BEACON", **(RANGE | fields)) == []


def test_a_range_of_another_vehicle_is_refused_by_its_name():
    link = Link()
    assert link.hear("RANGING_BEACON", Voice(2, 25), **RANGE) == []
    assert link.session.decoder.refused == {"range to an anchor: of another vehicle": 1}


def test_a_stamp_of_zero_is_the_time_of_its_arrival():
    link = Link()
    (pose,) = link.hear("VISION_POSITION_ESTIMATE", usec=0)
    assert pose.t_ns == link.now_ns


def test_a_clock_that_leaps_is_another():
    link = Link()
    for k in range(40):
        link.go(0.05)
        base = 3_000_000 if k < 20 else -900_000_000
        (pose,) = link.hear("VISION_POSITION_ESTIMATE", usec=link.now_ns // 1000 - base)
        assert abs(pose.t_ns - link.now_ns) < 1 * MS


DELTA = {"time_delta_usec": 100_000, "position_delta": (0.1, 0.2, -0.3), "confidence": 100.0}


def test_what_was_travelled_is_the_mean_velocity_in_the_middle_of_its_span():
    (velocity,) = Link().hear("VISION_POSITION_DELTA", **DELTA)
    assert (velocity.t_ns, velocity.is_level) == (10 * SECOND - 50 * MS, False)
    assert [velocity.x, velocity.y, velocity.z] == pytest.approx([1.0, 2.0, -3.0])
    assert velocity.std == pytest.approx(0.1)


def test_what_was_travelled_in_a_turn_is_along_the_axes_of_its_middle():
    """On a circle to the right: by the axes at its end, the way is to the left."""
    turn, way = 0.4, 2.0 * 5.0 / 4.0 * math.sin(0.2)
    delta = (way * math.cos(0.2), -way * math.sin(0.2), 0.0)
    fields = {"time_delta_usec": 100_000, "position_delta": delta, "confidence": 50.0}
    (velocity,) = Link().hear("VISION_POSITION_DELTA", **fields, angle_delta=(0.0, 0.0, turn))
    mean = 10.0 * way
    assert [velocity.x, velocity.y, velocity.z] == pytest.approx([mean, 0.0, 0.0], abs=1e-6)
    assert velocity.std == pytest.approx(0.5)


@pytest.mark.parametrize(
    "fields",
    [
        {"confidence": 0.0},
        {"confidence": -1.0},
        {"confidence": NAN},
        {"time_delta_usec": 0},
        {"time_delta_usec": 1_000_001},
        {"time_delta_usec": 2**63},
        {"position_delta": (NAN, 0.0, 0.0)},
        {"angle_delta": (0.0, math.inf, 0.0)},
    ],
)
def test_a_way_that_cannot_be_is_refused(fields):
    assert not Link().hear("VISION_POSITION_DELTA", **(DELTA | fields))


def test_all_that_it_reads_is_a_message_that_an_autopilot_may_fuse():
    assert {*Link().session.decoder.external.readers} - RANGES <= POSES
    assert IDS["VISION_SPEED_ESTIMATE"] in POSES


# On this board


@pytest.mark.parametrize("age", [0.0, 0.08, 0.5])
def test_a_stamp_by_our_own_clock_keeps_its_age(age):
    """Unlike one by another clock, of which a constant age is not seen at first."""
    link = Link()
    unix_ns = 1_800_000_000 * SECOND
    for _ in range(40):
        link.now_ns += 50 * MS
        t_ns = link.now_ns
        # By the autopilot's clock; by ours all is 57 years later
        sample = {"time_usec": t_ns // 1000, "zacc": -9.81, "fields_updated": 0x3F}
        link.session.receive(link.autopilot.say("HIGHRES_IMU", **sample), t_ns + unix_ns)
        stamp = (t_ns + unix_ns) // 1000 - round(age * 1e6)
        said = VISION.say("VISION_POSITION_ESTIMATE", usec=stamp)
        ((pose,),) = link.session.steps_of_board(said, t_ns + unix_ns + 1 * MS)
    assert pose.t_ns == pytest.approx(t_ns - age * SECOND, abs=2 * MS)


def test_a_stamp_by_unix_time_from_elsewhere_is_by_another_clock():
    """That of a ground station may be half a second off: its age is not known."""
    link = Link()
    unix_us = 1_800_000_000_000_000
    for _ in range(20):
        link.go(0.05)
        stamp = unix_us + link.now_ns // 1000
        said = VISION.say("VISION_POSITION_ESTIMATE", usec=stamp)
        (pose,) = link.session.receive(said, link.now_ns + 1000 * (unix_us + 400_000))
    assert pose.t_ns == pytest.approx(link.now_ns, abs=1 * MS)


def test_samples_that_come_late_do_not_move_our_clock():
    link = Link()
    unix_ns = 1_800_000_000 * SECOND
    for k in range(60):
        link.now_ns += 50 * MS
        t_ns = link.now_ns
        late_ns = 0 if k < 30 else 200 * MS
        sample = {"time_usec": (t_ns - late_ns) // 1000, "zacc": -9.81, "fields_updated": 0x3F}
        link.session.receive(link.autopilot.say("HIGHRES_IMU", **sample), t_ns + unix_ns)
        said = VISION.say("VISION_POSITION_ESTIMATE", usec=(t_ns + unix_ns) // 1000)
        ((pose,),) = link.session.steps_of_board(said, t_ns + unix_ns)
        assert pose.t_ns == pytest.approx(t_ns, abs=1 * MS)


def beside(link, name, voice=VISION, **fields):
    """Send a message to the second port."""
    said = voice.say(name, **({"usec": link.now_ns // 1000} | fields))
    steps = link.session.steps_of_board(said, link.now_ns)
    return [one for found in steps for one in found]


def test_at_the_second_port_poses_and_velocities_are_read_and_recorded_and_nothing_else():
    link = Link()
    link.session.outbox._is_recording = True
    assert len(beside(link, "VISION_POSITION_ESTIMATE")) == 1
    assert len(beside(link, "VISION_SPEED_ESTIMATE", voice=Voice(240, 7))) == 0  # the first counts
    pose = {"usec": link.now_ns // 1000}
    for voice in (Voice(1, 1), Voice(1, 194)):
        assert not beside(link, "VISION_POSITION_ESTIMATE", voice=voice)
    steps = link.session.steps_of_board(VISION.heartbeat() + b"noise" * 3, link.now_ns)
    assert [one for found in steps for one in found] == []
    ignored = link.session.ignored
    assert ignored["aid port: the autopilot's ids, or ours"] == 2
    assert ignored["aid port: no pose or velocity"] >= 1
    # As of a link of its own, so that a replay takes it for what it was
    assert [stamp & 3 for stamp, _ in link.session.outbox.take_record()] == [3, 3]
    # It is no second source: the autopilot does not hear it
    for _ in range(10):
        link.go(0.1)
        beside(link, "VISION_POSITION_ESTIMATE", **(pose | {"usec": link.now_ns // 1000}))
        link.session.tick(link.now_ns)
    assert link.session.second_source.words == ""


def test_before_there_is_an_autopilot_the_second_port_reads_nothing():
    session = Session(SessionOptions(rates={}, reads_others=True))
    said = VISION.say("VISION_POSITION_ESTIMATE", usec=5)
    assert list(session.steps_of_board(said, 0)) == []
    assert session.ignored["aid port: not used, or no autopilot yet"] == 1


@pytest.mark.parametrize(
    ("voice", "fields"),
    [
        (Voice(1, 1), {"estimator_type": 8}),  # the autopilot's own, by a router
        (Voice(1, 194), {"estimator_type": 3}),  # ours to PX4, that comes back
        (Voice(100, 194), {"estimator_type": 5}),  # ours to a monitor under another system id
        (Voice(100, 194), {"estimator_type": 3}),
        (Voice(2, 197), {"estimator_type": 3}),  # of another vehicle
        (Voice(1, 195), {"estimator_type": 5}),  # another companion's, honest
        (Voice(240, 197), {"estimator_type": 4}),
        (VISION, {"estimator_type": 3, "quality": -1}),
    ],
)
def test_no_estimate_with_gnss_in_it_comes_back_by_the_second_port(voice, fields):
    link = Link()
    said = voice.say("ODOMETRY", **(ODOMETRY | fields | {"time_usec": link.now_ns // 1000}))
    assert [one for found in link.session.steps_of_board(said, link.now_ns) for one in found] == []
