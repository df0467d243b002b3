"""What an autopilot would take, by its parameters, and how it is asked for them."""

import struct

import pytest

from ekf_companion.doctor.parameters import DECIDING, Reader, fusion

GNSS_ALONE = {
    "EK3_SRC1_POSXY": 3,
    "EK3_SRC1_VELXY": 3,
    "EK3_SRC1_POSZ": 1,
    "EK3_SRC1_VELZ": 3,
    "EK3_SRC1_YAW": 1,
}
OURS_ALONE = {**dict.fromkeys(GNSS_ALONE, 6)}
SECOND_SET = {name.replace("SRC1", "SRC2"): value for name, value in OURS_ALONE.items()}
MS = 1_000_000


@pytest.mark.parametrize(
    ("family", "parameters", "takes_ours", "is_double"),
    [
        ("px4", {"EKF2_EV_CTRL": 0}, False, False),
        ("px4", {"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7}, False, False),
        ("px4", {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0}, True, False),
        ("px4", {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 8}, True, False),
        ("px4", {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 7}, True, True),
        ("px4", {"EKF2_EV_CTRL": 4, "EKF2_GPS_CTRL": 1}, True, True),
        ("px4", {"EKF2_AID_MASK": 1}, False, False),
        ("px4", {"EKF2_AID_MASK": 24}, True, False),
        ("px4", {"EKF2_AID_MASK": 9}, True, True),
        ("ardupilot", {"VISO_TYPE": 0}, False, False),
        ("ardupilot", {"VISO_TYPE": 1, **GNSS_ALONE}, False, False),
        ("ardupilot", {"VISO_TYPE": 1, **OURS_ALONE}, True, False),
        ("ardupilot", {"VISO_TYPE": 1, **OURS_ALONE, "EK3_SRC1_VELXY": 3}, True, True),
        ("ardupilot", {"VISO_TYPE": 1, **GNSS_ALONE, **SECOND_SET}, True, False),
        ("ardupilot", {"VISO_TYPE": 1, **OURS_ALONE, **SECOND_SET, "EK3_SRC2_YAW": 3}, True, True),
        ("ardupilot", {"VISO_TYPE": 1, **GNSS_ALONE, **SECOND_SET, "EK3_SRC2_POSZ": 3}, True, True),
    ],
)
def test_what_is_taken_follows_from_the_parameters(family, parameters, takes_ours, is_double):
    """Rule 25."""
    taken = fusion(parameters, family)
    assert bool(taken.ours) == takes_ours
    assert taken.is_double == is_double


@pytest.mark.parametrize(
    ("family", "parameters"),
    [
        ("px4", {}),
        ("px4", {"EKF2_EV_CTRL": 15}),
        ("px4", {"EKF2_GPS_CTRL": 7}),
        ("ardupilot", {"VISO_TYPE": 1}),
        ("ardupilot", {"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6}),
        ("ardupilot", GNSS_ALONE),
        ("unknown", {"EKF2_EV_CTRL": 0}),
    ],
)
def test_too_little_is_not_taken_for_safe(family, parameters):
    """Rule 25."""
    assert fusion(parameters, family) is None


def test_each_parameter_is_asked_three_times_and_then_given_up():
    reader, now_ns = Reader(), 0
    reader.begin("px4", now_ns)
    while not reader.is_done:
        reader.request(1, 1, now_ns)
        now_ns += 10 * MS
        assert now_ns < 20_000 * MS
    assert set(reader.asked.values()) == {3}
    assert set(DECIDING["px4"]) <= set(reader.asked)


def test_a_value_is_taken_as_its_family_lays_it():
    reader = Reader()
    bytewise = struct.unpack("<f", struct.pack("<i", 15))[0]
    reader.take("EKF2_EV_CTRL", bytewise, 6, "px4")
    reader.take("EKF2_GPS_CTRL", 7.0, 9, "px4")
    assert reader.values == {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 7.0}
    reader.take("VISO_TYPE", 1.0, 2, "ardupilot")
    assert reader.values["VISO_TYPE"] == 1.0
    reader.take("SYSID_THISMAV", 1.0, 2, "ardupilot")
    reader.take("VISO_QUAL_MIN", float("nan"), 9, "ardupilot")
    assert len(reader.values) == 3
