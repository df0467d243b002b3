"""Rule 25: the guard's decision, as a table, and against an independent witness."""

import itertools

import numpy as np
import pytest

from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.fusion import NAMES, decide, missing, watched
from sim_autopilot.acceptance import DEFAULTS, would_accept
from sim_autopilot.judgement import Stack

PX4, ARDUPILOT, UNKNOWN = Family.PX4, Family.ARDUPILOT, Family.UNKNOWN
PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")


def source_set(number, *values):
    return {f"EK3_SRC{number}_{part}": value for part, value in zip(PARTS, values, strict=True)}


def ardupilot(**changes):
    """Return every parameter that may decide, as the firmware sets it but for some."""
    defaults = DEFAULTS[Stack.ARDUPILOT]
    return {name: float(defaults[name]) for name in NAMES[ARDUPILOT]} | changes


def px4(vision, gnss):
    return {"EKF2_EV_CTRL": float(vision), "EKF2_GPS_CTRL": float(gnss)}


def enabled(bits):
    return px4(15, 7) | {"EKF2_SENS_EN": float(bits)}


OURS, GNSS, NONE = (6, 6, 6, 6, 6), (3, 3, 1, 3, 1), (0, 0, 1, 0, 0)


@pytest.mark.parametrize(
    ("family", "parameters", "is_streaming", "words"),
    [
        (PX4, px4(0, 7), True, "EKF2_EV_CTRL is 0: the autopilot fuses nothing of ours"),
        (PX4, {"EKF2_EV_CTRL": 0.0}, True, "EKF2_EV_CTRL is 0"),
        (PX4, {"EKF2_EV_CTRL": None}, True, "EKF2_EV_CTRL does not exist"),
        (PX4, px4(15, 0), True, "EKF2_GPS_CTRL is 0: the autopilot fuses ours, and no GNSS"),
        (PX4, {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": None}, True, "EKF2_GPS_CTRL does not exist"),
        (PX4, px4(15, 7), False, "set EKF2_GPS_CTRL to 0 to fly on our estimate"),
        (PX4, px4(1, 1), False, "our horizontal position together with the position"),
        (PX4, px4(2, 4), False, "our height together with the velocity"),
        # Our yaw comes of the same fixes and the same compass
        (PX4, px4(8, 7), False, "our yaw together with"),
        (PX4, px4(1, 8), False, "together with the yaw of the GNSS"),
        (PX4, {"EKF2_EV_CTRL": 15.0}, False, "it did not answer for EKF2_GPS_CTRL"),
        (PX4, {"EKF2_GPS_CTRL": 7.0}, False, "it did not answer for EKF2_EV_CTRL"),
        (PX4, {}, False, "it answers no request for a parameter"),
        # A bit that nobody knows may be fusion
        (PX4, px4(16, 7), False, "our something unknown (16) together with the position"),
        (PX4, px4(17, 7), False, "our horizontal position and something unknown (16) together"),
        (PX4, px4(15, 16), False, "together with the something unknown (16) of the GNSS"),
        (PX4, px4(-1, 7), False, "EKF2_EV_CTRL is -1"),
        (PX4, px4(16, 0), True, "fuses ours, and no GNSS"),
        # Switched off in flight, whatever the other parameters say (1.18)
        (PX4, enabled(8191), False, "set EKF2_GPS_CTRL to 0 to fly on our estimate"),
        (PX4, enabled(8191 - 8), True, "EKF2_SENS_EN is 8183: vision is switched off"),
        (PX4, enabled(8191 - 1), False, "would fuse our"),
        (PX4, enabled(8191 - 3), True, "EKF2_SENS_EN is 8188: GNSS is switched off"),
        (PX4, px4(15, 7) | {"EKF2_SENS_EN": None}, False, "would fuse our"),
        # Before 1.14
        (PX4, {"EKF2_AID_MASK": 1.0}, True, "EKF2_AID_MASK is 1: the autopilot fuses nothing"),
        (PX4, {"EKF2_AID_MASK": 281.0}, False, "set EKF2_AID_MASK to 280 to fly on our estimate"),
        (PX4, {"EKF2_AID_MASK": 136.0}, False, "set EKF2_AID_MASK to 8 "),
        (PX4, {"EKF2_AID_MASK": 513.0}, False, "set EKF2_AID_MASK to 0 "),
        (PX4, {"EKF2_AID_MASK": 512.0}, False, "our something unknown (512) together"),
        (PX4, {"EKF2_AID_MASK": 103.0}, True, "the autopilot fuses nothing of ours"),
        (PX4, {"EKF2_AID_MASK": 280.0}, False, "it did not answer for EKF2_HGT_MODE"),
        (PX4, {"EKF2_AID_MASK": 280.0, "EKF2_HGT_MODE": 3.0}, True, "fuses ours, and no GNSS"),
        (PX4, {"EKF2_AID_MASK": 280.0, "EKF2_HGT_MODE": 1.0}, False, "set EKF2_HGT_MODE to 3"),
        # 1.14 still has the old mask, which decides nothing any more
        (PX4, {**px4(15, 7), "EKF2_AID_MASK": 1.0}, False, "EKF2_EV_CTRL is 15"),
        (PX4, {"EKF2_GPS_CTRL": 7.0, "EKF2_AID_MASK": 1.0}, False, "answer for EKF2_EV_CTRL"),
        (ARDUPILOT, ardupilot(), True, "VISO_TYPE is 0: the autopilot takes no ODOMETRY"),
        (ARDUPILOT, {"VISO_TYPE": 0.0}, True, "VISO_TYPE is 0"),
        (ARDUPILOT, {"VISO_TYPE": None}, True, "VISO_TYPE does not exist"),
        (ARDUPILOT, ardupilot(VISO_TYPE=1.0), True, "no EK3_SRCn_* is 6"),
        (
            ARDUPILOT,
            ardupilot(VISO_TYPE=1.0, EK3_SRC1_POSXY=6.0),
            False,
            "set EK3_SRC1_VELXY and EK3_SRC1_VELZ to 6 to fly on our estimate, or VISO_TYPE to 0",
        ),
        (ARDUPILOT, ardupilot(VISO_TYPE=1.0, EK3_SRC1_YAW=6.0), False, "EK3_SRC1_YAW 6"),
        (
            ARDUPILOT,
            ardupilot(VISO_TYPE=3.0, **source_set(1, *OURS)),
            True,
            "no EK3_SRCn set has GNSS too",
        ),
        (
            ARDUPILOT,
            ardupilot(VISO_TYPE=1.0, **source_set(1, 6, 6, 6, 6, 2)),
            False,
            "EK3_SRC1_YAW 2",
        ),
        # Sets are alternatives, but for the velocities, which are pooled by default
        (
            ARDUPILOT,
            ardupilot(VISO_TYPE=1.0, EK3_SRC_OPTIONS=0.0, **source_set(2, *OURS)),
            True,
            "no EK3_SRCn set has GNSS too",
        ),
        (
            ARDUPILOT,
            ardupilot(VISO_TYPE=1.0, EK3_SRC_OPTIONS=3.0, **source_set(2, *OURS)),
            False,
            "set EK3_SRC_OPTIONS to 2, so that only the set in use is fused",
        ),
        (
            ARDUPILOT,
            ardupilot(VISO_TYPE=1.0, **source_set(2, 6, 0, 6, 0, 6)),
            True,
            "no EK3_SRCn set has GNSS too",
        ),
        (
            ARDUPILOT,
            ardupilot(VISO_TYPE=1.0, EK3_SRC_OPTIONS=0.0, EK3_SRC3_POSXY=6.0, EK3_SRC3_POSZ=3.0),
            False,
            "set EK3_SRC3_POSZ to 6",
        ),
        (ARDUPILOT, {"VISO_TYPE": 1.0}, False, "did not answer for EK3_SRC_OPTIONS"),
        (ARDUPILOT, {}, False, "it answers no request for a parameter"),
        (UNKNOWN, {}, True, "neither PX4 nor ArduPilot"),
    ],
)
def test_the_decision_and_the_remedy(family, parameters, is_streaming, words):
    decision = decide(family, parameters)
    assert decision.is_streaming is is_streaming
    assert words in decision.sentence
    assert decision.is_settled
    assert decision.parameters == {k: v for k, v in parameters.items() if v is not None}
    # The pilot's screen has fifty bytes, and a withheld stream says what to do
    assert 0 < len(f"Companion: {decision.text}") <= 50
    assert bool(decision.remedy) is not is_streaming


@pytest.mark.parametrize("family", [PX4, ARDUPILOT])
@pytest.mark.parametrize(
    ("mode", "independent", "is_streaming"),
    [("auto", False, False), ("auto", True, True), ("always", False, True), ("never", True, False)],
)
def test_the_configuration_goes_before_the_parameters(family, mode, independent, is_streaming):
    both = px4(15, 7) if family is PX4 else ardupilot(VISO_TYPE=1.0, EK3_SRC1_POSXY=6.0)
    assert decide(family, both, mode, independent).is_streaming is is_streaming
    # Nor is anything waited for where it is told
    decision = decide(family, {}, mode, independent, is_complete=False)
    assert decision.is_settled is (mode != "auto" or independent)


def test_always_says_that_nothing_guards():
    assert "nothing guards against counting GNSS twice" in decide(PX4, {}, "always").sentence


@pytest.mark.parametrize("family", [PX4, ARDUPILOT])
def test_nothing_is_sent_before_the_answers_are_there(family):
    decision = decide(family, {}, is_complete=False)
    assert not decision.is_streaming
    assert not decision.is_settled
    assert set(NAMES[family]) - set(missing(family, {})) <= {"EKF2_SENS_EN"}


def test_what_decides_is_watched_and_no_more():
    assert watched(PX4, px4(0, 7)) == ("EKF2_EV_CTRL", "EKF2_GPS_CTRL")
    old = ("EKF2_AID_MASK", "EKF2_HGT_MODE")
    assert watched(PX4, {"EKF2_AID_MASK": 1.0}) == ("EKF2_EV_CTRL", "EKF2_GPS_CTRL", *old)
    for nothing in (0.0, None):  # it takes none, or was built without
        assert watched(ARDUPILOT, {"VISO_TYPE": nothing}) == ("VISO_TYPE",)
        assert missing(ARDUPILOT, {"VISO_TYPE": nothing}) == ()
    assert watched(ARDUPILOT, ardupilot(VISO_TYPE=1.0)) == NAMES[ARDUPILOT]


# The witness knows the receivers, and nothing of the guard


def two(frame_id):
    """Return two messages, so close that fusion begins."""
    sender = Sender(1, 194)
    fields = {
        "frame_id": frame_id,
        "child_frame_id": 12,
        "q": (1.0, 0.0, 0.0, 0.0),
        "estimator_type": 3,
        "quality": 100,
    }
    times = (10**6, 1_030_000)
    return b"".join(sender.message("ODOMETRY", time_usec=t, **fields) for t in times)


def test_where_px4_fuses_ours_beside_gnss_nothing_is_sent():
    streamed = 0
    for vision, gnss, frame_id in itertools.product(range(16), range(16), (1, 20)):
        fused = would_accept(two(frame_id), Stack.PX4, px4(vision, gnss)).fused
        decision = decide(PX4, px4(vision, gnss))
        is_streaming = decision.is_streaming
        assert decision.is_fused is (is_streaming and bool(fused))
        assert not (is_streaming and fused and gnss)
        assert is_streaming or (vision and gnss)
        streamed += is_streaming
    assert streamed == 2 * (16 + 15)


def test_where_ardupilot_fuses_ours_beside_gnss_in_any_set_nothing_is_sent():
    rng, data = np.random.default_rng(25), two(20)
    found = {True: 0, False: 0}
    for _ in range(2000):
        parameters = ardupilot(
            VISO_TYPE=float(rng.integers(0, 2)), EK3_SRC_OPTIONS=float(rng.integers(0, 2))
        )
        # Mostly whole sets, so that both decisions come
        for number in (1, 2, 3):
            values = [OURS, GNSS, NONE, rng.choice([0, 3, 6], 5)][int(rng.integers(0, 4))]
            parameters |= source_set(number, *map(float, values))
        decision, in_any = decide(ARDUPILOT, parameters), False
        is_streaming = decision.is_streaming
        found[is_streaming] += 1
        for number in (1, 2, 3):
            fused = would_accept(data, Stack.ARDUPILOT, parameters, source_set=number).fused
            has_gnss = any(parameters[f"EK3_SRC{number}_{part}"] == 3 for part in PARTS)
            assert not (is_streaming and fused and has_gnss), parameters
            in_any = in_any or bool(fused)
        assert decision.is_fused is (is_streaming and in_any)
    assert min(found.values()) > 300


def test_vision_that_is_switched_off_is_not_fused():
    assert decide(PX4, px4(15, 0) | {"EKF2_SENS_EN": 8183.0}).is_fused is False
    assert decide(PX4, px4(15, 0) | {"EKF2_SENS_EN": 8191.0}).is_fused is True
    assert "EKF2_SENS_EN" in watched(PX4, enabled(8191))
    assert "EKF2_SENS_EN" not in watched(PX4, px4(15, 7) | {"EKF2_SENS_EN": None})
