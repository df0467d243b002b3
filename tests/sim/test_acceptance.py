"""The oracle of what the autopilots do with ODOMETRY: one rule of theirs at a time."""

import math

import pytest

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import Sender, pack, unpack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.frame import Splitter
from sim_autopilot.acceptance import DEFAULTS, Reception, judge, would_accept
from sim_autopilot.judgement import Quantity, Stack

ALL = frozenset(Quantity)
PERIOD_US = 33_333
FUSING = {
    Stack.PX4: {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0},
    Stack.PX4_OLD: {"EKF2_AID_MASK": 8 | 16 | 256, "EKF2_HGT_MODE": 3},
    Stack.ARDUPILOT: {
        "VISO_TYPE": 1,
        **{f"EK3_SRC1_{part}": 6 for part in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")},
    },
}
FIELDS = {
    "frame_id": 20,
    "child_frame_id": 12,
    "q": (1.0, 0.0, 0.0, 0.0),
    "pose_covariance": (0.01, *(0.0,) * 20),
    "velocity_covariance": (0.01, *(0.0,) * 20),
    "reset_counter": 1,
    "estimator_type": 3,
    "quality": 100,
}


def frame(time_us, **fields):
    return Sender(1, 194).message("ODOMETRY", **{**FIELDS, "time_usec": time_us, **fields})


def stream(*changes, period_us=PERIOD_US):
    """Return the bytes of one message for each set of changed fields."""
    return b"".join(frame(10**6 + k * period_us, **fields) for k, fields in enumerate(changes))


def judged(stack, *changes, parameters=(), period_us=PERIOD_US, **options):
    """Return the judgement of the last of two good messages and the changed ones."""
    data = stream({}, {}, *changes, period_us=period_us)
    return would_accept(data, stack, {**FUSING[stack], **dict(parameters)}, **options)


@pytest.mark.parametrize("stack", Stack)
def test_a_good_stream_is_fused_whole_where_the_parameters_ask_for_it(stack):
    judgement = judged(stack)
    assert (judgement.is_accepted, judgement.fused, judgement.reason) == (True, ALL, "")


@pytest.mark.parametrize("stack", Stack)
def test_nothing_is_fused_by_default(stack):
    judgement = would_accept(stream({}, {}), stack)
    assert not judgement.fused
    assert judgement.reason


@pytest.mark.parametrize("kind", [4, 5, 7, 8])
def test_px4_refuses_a_type_with_a_critical_text_each_time(kind):
    judgement = judged(Stack.PX4, {"estimator_type": kind})
    assert not judgement.is_accepted
    assert judgement.text == f"ODOMETRY: estimator_type {kind} unsupported"
    assert not judged(Stack.PX4_OLD, {"estimator_type": kind}).is_accepted
    assert judged(Stack.ARDUPILOT, {"estimator_type": kind}).fused == ALL


def test_the_types_that_we_send_are_refused_by_nobody():
    """Rule 24."""
    for stack, family in (
        (Stack.PX4, Family.PX4),
        (Stack.PX4_OLD, Family.PX4),
        (Stack.ARDUPILOT, Family.ARDUPILOT),
    ):
        ours = encode.label(family, "LOCAL_FRD", "auto")
        judgement = judged(stack, {"estimator_type": ours.estimator, "frame_id": ours.frame})
        assert judgement.fused == ALL
        assert judgement.text == ""


def test_motion_capture_reaches_no_filter():
    assert not judged(Stack.PX4, {"estimator_type": 6}).fused


@pytest.mark.parametrize(("pose", "twist"), [(1, 12), (20, 8), (21, 12), (18, 12), (20, 1)])
def test_ardupilot_takes_one_pair_of_frames_and_drops_others_without_a_word(pose, twist):
    judgement = judged(Stack.ARDUPILOT, {"frame_id": pose, "child_frame_id": twist})
    assert not judgement.is_accepted
    assert judgement.text == ""


@pytest.mark.parametrize(
    ("change", "lost"),
    [
        ({"frame_id": 18}, {Quantity.POSITION, Quantity.HEIGHT}),
        ({"child_frame_id": 18}, {Quantity.VELOCITY, Quantity.CLIMB}),
        ({"x": math.nan}, {Quantity.POSITION, Quantity.HEIGHT}),
        ({"vz": math.inf}, {Quantity.VELOCITY, Quantity.CLIMB}),
        ({"q": (math.nan, 0.0, 0.0, 0.0)}, {Quantity.YAW}),
        ({"q": (1.0 + 2e-5, 0.0, 0.0, 0.0)}, {Quantity.YAW}),
        ({"q": (1.0 + 5e-6, 0.0, 0.0, 0.0)}, set()),
    ],
)
def test_px4_drops_the_part_that_it_cannot_use(change, lost):
    assert judged(Stack.PX4, change).fused == ALL - lost


@pytest.mark.parametrize(
    ("bits", "fused"),
    [
        (0, set()),
        (1, {Quantity.POSITION}),
        (2, {Quantity.HEIGHT}),
        (4, {Quantity.VELOCITY, Quantity.CLIMB}),
        (8, {Quantity.YAW}),
    ],
)
def test_each_bit_of_px4_asks_for_its_part(bits, fused):
    assert judged(Stack.PX4, parameters={"EKF2_EV_CTRL": bits}).fused == fused


def test_beside_gnss_px4_takes_yaw_from_a_frame_aligned_with_north_only():
    both = {"EKF2_GPS_CTRL": 7}
    assert judged(Stack.PX4, parameters=both).fused == ALL - {Quantity.YAW}
    assert judged(Stack.PX4, {"frame_id": 1}, parameters=both).fused == ALL


@pytest.mark.parametrize(("quality", "is_fused"), [(49, False), (50, True)])
@pytest.mark.parametrize("stack", [Stack.PX4, Stack.ARDUPILOT])
def test_poor_quality_is_left_out(stack, quality, is_fused):
    least = {"EKF2_EV_QMIN": 50, "VISO_QUAL_MIN": 50}
    judgement = judged(stack, {"quality": quality}, parameters=least)
    assert bool(judgement.fused) is is_fused


def test_px4_begins_below_200_ms_and_goes_on_up_to_400():
    assert not judged(Stack.PX4, period_us=200_000).fused
    assert judged(Stack.PX4, period_us=199_999).fused
    message = unpack(Splitter().feed(frame(2 * 10**6))[0])
    history = judged(Stack.PX4).history
    for gap_us, is_fused in ((400_000, True), (400_001, False)):
        later = message._replace(time_usec=history.time_us + gap_us)
        assert bool(judge(Stack.PX4, later, FUSING[Stack.PX4], history).fused) is is_fused


def test_px4_fuses_none_before_the_second():
    assert not would_accept(stream({}), Stack.PX4, FUSING[Stack.PX4]).fused


@pytest.mark.parametrize("stack", Stack)
def test_a_new_reset_counter_moves_the_filter(stack):
    assert judged(stack, {"reset_counter": 2}).is_reset
    assert not judged(stack, {"reset_counter": 1}).is_reset


def test_a_t265_is_ignored_for_a_second_after_a_reset():
    asked = {"VISO_TYPE": 2}
    assert not judged(Stack.ARDUPILOT, {"reset_counter": 2}, parameters=asked).fused
    after = [{"reset_counter": 2}] * 32
    assert judged(Stack.ARDUPILOT, *after, parameters=asked).fused


def test_ardupilot_throws_away_what_exceeds_50_hz():
    assert judged(Stack.ARDUPILOT, period_us=20_000).fused
    assert not judged(Stack.ARDUPILOT, period_us=19_000).fused


def test_a_source_set_counts_when_it_is_switched_to():
    second = {"EK3_SRC1_POSXY": 3, "EK3_SRC2_POSXY": 6, "EK3_SRC_OPTIONS": 0}
    second |= {f"EK3_SRC1_{part}": 0 for part in ("VELXY", "POSZ", "VELZ", "YAW")}
    assert not judged(Stack.ARDUPILOT, parameters=second).fused
    assert judged(Stack.ARDUPILOT, parameters=second, source_set=2).fused == {Quantity.POSITION}


def test_ardupilot_fuses_velocities_of_sets_that_are_not_in_use_unless_an_option_is_cleared():
    sets = {f"EK3_SRC1_{part}": 3 for part in ("POSXY", "VELXY", "POSZ", "VELZ")}
    sets |= {"EK3_SRC1_YAW": 1, "EK3_SRC2_VELXY": 6, "EK3_SRC2_VELZ": 6}
    both = judged(Stack.ARDUPILOT, parameters={**sets, "EK3_SRC_OPTIONS": 1})
    assert both.fused == {Quantity.VELOCITY, Quantity.CLIMB}
    assert not judged(Stack.ARDUPILOT, parameters={**sets, "EK3_SRC_OPTIONS": 0}).fused


def test_ardupilot_makes_neither_a_variance_nor_a_deviation_of_the_covariance():
    covariance = [0.0] * 21
    covariance[0] = covariance[6] = covariance[11] = 8.0
    covariance[15] = covariance[18] = covariance[20] = 10.0
    judgement = judged(Stack.ARDUPILOT, {"pose_covariance": covariance})
    assert judgement.std_position == pytest.approx((3 * 64.0) ** (1 / 3))
    assert judgement.std_yaw == 1.5
    covariance[0] = math.nan
    judgement = judged(Stack.ARDUPILOT, {"pose_covariance": covariance})
    assert (judgement.std_position, judgement.std_yaw) == (0.2, 0.2)


def test_the_old_px4_takes_the_height_where_its_mode_says_vision():
    assert Quantity.HEIGHT not in judged(Stack.PX4_OLD, parameters={"EKF2_HGT_MODE": 0}).fused
    lone = {"EKF2_HGT_MODE": 3, "EKF2_AID_MASK": 1}
    assert not judged(Stack.PX4_OLD, parameters=lone).fused


def test_bytes_without_odometry_are_said_to_be_so():
    with pytest.raises(ValueError, match="no ODOMETRY"):
        would_accept(b"\xfd", "px4")
    other = Sender(1, 194).frame("HEARTBEAT", pack("HEARTBEAT", type=18))
    with pytest.raises(ValueError, match="no ODOMETRY"):
        would_accept(other, "px4")


@pytest.mark.parametrize(("later_us", "misplaced"), [(0, 1), (400_000, 1), (400_001, 0)])
def test_an_origin_that_comes_while_a_position_is_fused_is_counted(later_us, misplaced):
    """PX4 1.18 is 5300 km off after it."""
    reception = Reception("px4", {**DEFAULTS[Stack.PX4], **FUSING[Stack.PX4]})
    reception.take_origin(10**6)
    for one in Splitter().feed(stream({}, {})):
        reception.take(unpack(one))
    reception.take_origin(10**6 + PERIOD_US + later_us)
    assert reception.summary()["misplaced"] == misplaced
