"""The verdict before take-off: how far is too far, what is not compared, what is only noted."""

import math
from dataclasses import replace

import pytest

from ekf_companion.nav.state import Status
from ekf_companion.status.preflight import check
from tests.status.standing import answered, changed, stand, verdict


@pytest.fixture(scope="module")
def good():
    """The snapshot of a vehicle that stands and lacks nothing."""
    return stand(duration=18.0).snapshot()


# How far apart is too far


def heading_off(snapshot, turned, std):
    sigma = replace(snapshot.vehicle.sigma, heading_deg=std)
    ours = snapshot.vehicle.autopilot.heading_deg + turned
    return changed(snapshot, heading_deg=ours % 360.0, sigma=sigma, turn_rate_deg_s=0.0)


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_heading_counts_beyond_three_sigmas_of_both_sides(good, way):
    assert heading_off(good, way * 14.9, 0.0).ready
    assert not heading_off(good, way * 15.1, 0.0).ready
    limit = 3.0 * math.hypot(5.0, 8.0)
    assert heading_off(good, way * (limit - 0.1), 8.0).ready
    assert not heading_off(good, way * (limit + 0.1), 8.0).ready


def test_while_the_vehicle_turns_an_older_answer_may_differ_more(good):
    other = replace(good.vehicle.autopilot, attitude_age_s=0.5)
    ours = (other.heading_deg + 20.0) % 360.0
    sigma = replace(good.vehicle.sigma, heading_deg=0.0)
    still = {"autopilot": other, "heading_deg": ours, "sigma": sigma}
    assert not changed(good, **still, turn_rate_deg_s=0.0).ready
    assert changed(good, **still, turn_rate_deg_s=12.0).ready


def test_levels_that_differ_are_told_by_the_angle_between_both_downs(good):
    sigma = replace(good.vehicle.sigma, roll_deg=0.0, pitch_deg=0.0)
    own = good.vehicle.autopilot
    for moved, is_ready in ((3.5, True), (3.7, False)):
        off = {"roll_deg": own.roll_deg, "pitch_deg": own.pitch_deg + moved}
        found = changed(good, **off, sigma=sigma, turn_rate_deg_s=0.0)
        assert found.ready is is_ready
    assert found.causes == ("level differs",)
    assert found.reasons == ("roll and pitch differ from the autopilot's by 4 deg",)


def test_a_position_counts_beyond_three_sigmas_and_5_m(good):
    def off(metres, std, **autopilot):
        sigma = replace(good.vehicle.sigma, horizontal_m=std)
        other = replace(good.vehicle.autopilot, **autopilot)
        lat = other.lat_deg + math.degrees(metres / 6378137.0)
        place = {"lat_deg": lat, "lon_deg": other.lon_deg, "vel_ned_m_s": (0.0, 0.0, 0.0)}
        return changed(good, **place, sigma=sigma, autopilot=other)

    assert off(4.9, 0.1).ready
    assert off(5.1, 0.1).causes == ("position differs",)
    # One that states no sigma is as sure as we are
    assert off(12.0, 3.0).ready
    assert not off(13.0, 3.0).ready
    assert not off(12.0, 3.0, horizontal_std_m=1.0).ready


def test_east_is_shorter_near_the_poles(good):
    other = replace(good.vehicle.autopilot, lat_deg=80.0, lon_deg=179.9999)
    place = {"lat_deg": 80.0, "lon_deg": -179.9999, "autopilot": other}
    assert changed(good, **place).ready  # 4 m, across the date line
    assert not changed(good, **place | {"lon_deg": -179.999}).ready


def test_a_height_counts_beyond_10_m(good):
    own = good.vehicle.autopilot.alt_m
    assert changed(good, alt_m=own + 9.9).ready
    assert changed(good, alt_m=own + 10.3).causes == ("height differs",)


@pytest.mark.parametrize(("std", "limit"), [(0.0, 1.0), (0.4, 1.5)])
def test_a_velocity_counts_beyond_three_sigmas_and_1_m_s(good, std, limit):
    north, east, down = good.vehicle.autopilot.vel_ned_m_s
    sigma = replace(good.vehicle.sigma, vel_ned_m_s=(std, 0.0, 0.0))
    for speed, is_ready in ((limit - 0.05, True), (limit + 0.05, False)):
        found = changed(good, vel_ned_m_s=(north + speed, east, down), sigma=sigma)
        assert found.ready is is_ready
    assert found.reasons == (f"velocity differs from the autopilot's by {speed:.1f} m/s",)


@pytest.mark.parametrize("angle", ["roll_deg", "pitch_deg"])
def test_a_vehicle_leans_beyond_45_deg_and_is_upside_down_beyond_120(good, angle):
    level = {"roll_deg": 0.0, "pitch_deg": 0.0}
    found = {
        lean: [
            reason.partition(":")[0].partition(",")[0]
            for reason in changed(good, **level | {angle: lean}).reasons
            if "mounting" in reason
        ]
        for lean in (44.0, -46.0, 119.0, -121.0)
    }
    assert found == {
        44.0: [],
        -46.0: ["mounting looks wrong"],
        119.0: ["mounting looks wrong"],
        -121.0: ["mounting looks upside down"],
    }


# What is not compared


def test_an_attitude_older_than_a_second_is_compared_with_nothing(good):
    """A heading that is far off is not told as such: who knows what it is now."""
    found = answered(good, heading_deg=good.vehicle.heading_deg + 90.0, attitude_age_s=1.1)
    assert found.causes == ("not compared",)
    assert found.reasons == (
        "attitude not compared with the autopilot's: its ATTITUDE is 1.1 s old",
    )


def test_a_position_older_than_a_second_is_compared_with_nothing(good):
    found = answered(good, lat_deg=0.0, position_age_s=3.0)
    assert found.sentence == (
        "ready (position not compared: the autopilot's GLOBAL_POSITION_INT is 3.0 s old)"
    )


def test_an_autopilot_that_says_no_attitude_is_told():
    found = verdict(stand(silent=("ATTITUDE",)))
    assert found.reasons == ("attitude not compared with the autopilot's: it says none",)


def test_an_autopilot_that_says_no_position_is_a_note():
    found = verdict(stand(silent=("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")))
    assert found.sentence == "ready (position not compared: the autopilot says none)"


def test_what_the_autopilot_makes_of_our_odometry_proves_nothing(good):
    found = answered(good, heading_deg=0.0, is_attitude_ours=True, is_position_ours=True)
    assert found.ready
    assert found.notes == (
        "heading not compared: the autopilot's is made of our ODOMETRY",
        "position not compared: the autopilot's is made of our ODOMETRY",
    )


def test_a_heading_that_is_the_autopilot_s_proves_nothing(good):
    own = replace(good.vehicle.aids["heading"], source="ATTITUDE, the autopilot's own")
    aids = {**good.vehicle.aids, "heading": own}
    assert changed(good, aids=aids).sentence == (
        "ready (heading not compared: ours is taken from the autopilot)"
    )


# What the estimate says of itself


@pytest.mark.parametrize(
    ("sigma", "cause"),
    [
        ({"horizontal_m": 5.1}, "position unsure"),
        ({"heading_deg": 10.1}, "heading unsure"),
        ({"pitch_deg": 5.1}, "level unsure"),
    ],
)
def test_an_estimate_that_is_unsure_is_told(good, sigma, cause):
    found = changed(good, sigma=replace(good.vehicle.sigma, **sigma))
    assert found.causes == (cause,)
    assert "known to" in found.sentence


@pytest.mark.parametrize(
    ("aid", "cause"),
    [
        ("heading", "compass refused"),
        ("height", "height refused"),
        ("position", "fix refused"),
        ("baro", "baro refused"),
    ],
)
def test_an_aid_that_is_refused_is_told(good, aid, cause):
    refused = replace(good.vehicle.aids[aid], state="refused", why="outside its gate")
    assert changed(good, aids={**good.vehicle.aids, aid: refused}).causes == (cause,)


def test_a_heading_that_has_been_lost_is_told(good):
    lost = replace(good.vehicle.aids["heading"], state="lost", used_s=7.0)
    found = changed(good, aids={**good.vehicle.aids, "heading": lost})
    assert found.reasons == ("no heading from HIGHRES_IMU, magnetometer for 7 s",)


def test_a_heading_that_nothing_shows_is_told(good):
    none = replace(good.vehicle.aids["heading"], source="", state="none")
    found = changed(good, aids={**good.vehicle.aids, "heading": none}, heading_deg=math.nan)
    assert found.causes == ("no heading",)


def test_a_heading_that_drifts_is_told(good):
    drift = replace(good.vehicle.drift, seconds=20.0, heading_deg=5.1)
    assert changed(good, drift=drift).reasons == ("heading drifts: by 5 deg in 20 s at rest",)
    assert changed(good, drift=replace(drift, heading_deg=4.9)).ready
    assert changed(good, drift=replace(drift, seconds=3.9)).ready
    assert not changed(good, drift=replace(drift, seconds=4.1)).ready


def test_a_compass_that_is_refused_at_times_is_told_as_such(good):
    aid = replace(good.vehicle.aids["heading"], refused_s=0.5, why="the magnetic field is not so")
    found = changed(good, aids={**good.vehicle.aids, "heading": aid})
    assert found.reasons == ("compass refused now and then: the magnetic field is not so",)


def test_a_drift_within_its_own_sigma_is_none(good):
    drift = replace(good.vehicle.drift, seconds=20.0, roll_deg=0.55)
    sure = replace(good.vehicle.sigma, roll_deg=0.3)
    assert changed(good, drift=drift, sigma=replace(sure, roll_deg=1.0)).ready
    assert changed(good, drift=drift, sigma=sure).causes == ("levels drift",)
    assert changed(good, drift=replace(drift, roll_deg=0.45), sigma=sure).ready


def test_a_degraded_estimate_without_another_reason_is_not_ready(good):
    degraded = replace(good.estimator, status=Status.DEGRADED)
    assert check(replace(good, estimator=degraded)).causes == ("degraded",)


def test_dead_reckoning_is_told_before_the_fixes_are_missed_for_long(good):
    reckoning = replace(good.estimator, status=Status.DEAD_RECKONING)
    assert check(replace(good, estimator=reckoning)).reasons == ("no fix: dead reckoning",)


def test_an_autopilot_that_flies_on_odometry_and_gets_none_is_told(good):
    other = replace(good.vehicle.autopilot, is_position_ours=True)
    output = replace(good.output, is_streaming=False, silence="waiting for the first fix")
    silent = replace(good, vehicle=replace(good.vehicle, autopilot=other), output=output)
    assert check(silent).reasons == (
        "the autopilot flies on our ODOMETRY, and none is sent: waiting for the first fix",
    )


# What is good to know


def test_what_speaks_against_no_take_off_is_a_note(good):
    slow = replace(good.estimator, imu_rate=50.0)
    output = replace(good.output, is_allowed=False, reason="GNSS would count twice")
    process = replace(good.process, recording_trouble="/a.tlog: the disk is full")
    units = {"0": "used", "1": "spare", "2": "stuck at 12.0 s"}
    imu = replace(good.imu, units=units, faults={"2": 1})
    found = check(replace(good, estimator=slow, imu=imu, output=output, process=process))
    assert found.ready
    assert found.notes == (
        "inertial samples come at 50 Hz: fast motion is missed",
        "inertial unit 2: stuck at 12.0 s",
        "ODOMETRY is withheld: GNSS would count twice",
        "not all is recorded: /a.tlog: the disk is full",
    )
