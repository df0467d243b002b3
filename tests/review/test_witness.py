"""What a verdict says of yaw, tilt and height beside a truth, or beside the autopilot's."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import COLUMNS, GEODETIC, QUATERNION, Status, Trajectory
from ekf_companion.review.report import Report, summary
from ekf_companion.review.track import Track
from ekf_companion.review.verdict import judge_log
from tests.review.test_track import NONE, SECOND_NS, table_of

T_S = np.arange(0.0, 100.0, 0.05)


def turned(yaw_deg, pitch_deg=0.0):
    """Return attitudes of so many degrees at each of ``T_S``."""
    still = 0.0 * T_S
    return so3.from_euler(still, np.deg2rad(pitch_deg + still), np.deg2rad(yaw_deg + still))


def reported(sigma_deg=2.0, imu=200.0, refused=0, **witness):
    """Return a report on a vehicle that turns slowly, beside what is named."""
    table = table_of(T_S)
    for name, values in zip(QUATERNION, turned(TURN).T, strict=True):
        table.values[:, COLUMNS.index(name) - 1] = values
    for name in ("sd_roll", "sd_pitch", "sd_yaw"):
        table.values[:, COLUMNS.index(name) - 1] = np.deg2rad(sigma_deg)
    table.values[:, COLUMNS.index("sd_pos_d") - 1] = 0.5
    found = Report(log="x", seconds={Status.OK: 100.0}, **witness)
    found.track.add(NONE, table)
    found.counts[Kind.GNSS], found.rates[Kind.IMU] = 100, imu
    health = Pipeline(FilterSettings()).health()
    counts = dict.fromkeys(Verdict, 0) | {Verdict.FUSED: 100, Verdict.DISTURBED: refused}
    sensors = dict(health.headings) | {"compass": counts}
    found.health = replace(
        health, verdicts=dict(health.verdicts) | {Aid.HEADING: counts}, headings=sensors
    )
    return found


TURN = 3.0 * T_S
"""Yaw of ours, deg."""


def other(q_nb, above=0.0):
    """Return a trajectory at our place, so many metres above it."""
    t_ns = np.rint(T_S * SECOND_NS).astype(np.int64)
    place = {"lat": np.deg2rad(47.0 + 0.0 * T_S), "lon": np.deg2rad(8.0 + 0.0 * T_S)}
    alt = 500.0 + above + 0.0 * T_S
    return Trajectory(name="other", pos_t_ns=t_ns, **place, alt=alt, att_t_ns=t_ns, q_nb=q_nb)


def between(first_s, last_s, size):
    """Return a size from one time to another, and 0 at others."""
    return np.where((first_s <= T_S) & (last_s > T_S), size, 0.0)


def drifted(first_s, last_s, size):
    """Return a size that comes and goes slowly: over 10 s."""
    return size * np.clip(np.minimum(T_S - first_s, last_s - T_S) / 10.0, 0.0, 1.0)


NEAR = "differs from the autopilot's estimate by 0.0 m RMS"


def test_an_attitude_that_its_sigma_explains_is_good():
    own = other(turned(TURN + 2.0))
    assert judge_log(reported(own=own)).sentence == f"good: {NEAR}, no resets"
    unsure = reported(sigma_deg=30.0, own=other(turned(TURN + between(40.0, 45.0, 25.0))))
    assert judge_log(unsure).grade == "good"


def test_an_autopilot_whose_yaw_jumps_is_named_and_costs_no_grade():
    own = other(turned(TURN + between(40.0, 45.0, 25.0)))
    found = judge_log(reported(own=own))
    assert found.sentence == (
        f"good: {NEAR}, no resets, the autopilot's yaw jumped: up to 25 deg from ours at "
        f"{found.sentence.partition('ours at ')[2][:2]} s (12.5 sigma)"
    )


def test_a_yaw_that_departs_from_the_autopilots_slowly_is_fair():
    found = judge_log(reported(own=other(turned(TURN + drifted(40.0, 70.0, 25.0)))))
    assert found.grade == "fair"
    assert found.reasons[0].startswith("yaw up to 25 deg from the autopilot's at 5")
    assert found.reasons[0].endswith(" s (12.5 sigma)")


@pytest.mark.parametrize(("last_s", "grade"), [(45.0, "fair"), (80.0, "poor")])
def test_by_a_truth_a_yaw_beyond_its_sigma_is_fair_or_poor(last_s, grade):
    found = judge_log(reported(truth=other(turned(TURN + between(40.0, last_s, 25.0)))))
    assert found.grade == grade
    assert found.reasons[0].startswith("yaw up to 25 deg from the truth at ")


def test_tilt_counts_as_yaw_does():
    found = judge_log(reported(own=other(turned(TURN, pitch_deg=drifted(40.0, 70.0, 20.0)))))
    assert found.grade == "fair"
    assert any(one.startswith("tilt up to 20 deg from the autopilot's") for one in found.reasons)
    assert "tilt 9" in found.size


def test_a_moment_beyond_the_sigma_is_not_named():
    moments = sum(between(first_s, first_s + 0.5, 25.0) for first_s in (40.0, 50.0, 60.0, 70.0))
    found = judge_log(reported(truth=other(turned(TURN + moments))))
    assert found.reasons == ()
    assert found.sentence.startswith("good: 0.0 m RMS from the truth, yaw 4")


def test_a_height_of_another_datum_is_asked_about():
    found = judge_log(reported(own=other(turned(TURN), above=-47.0)))
    assert found.grade == "good"
    words = "height 47.0 m above the autopilot's in the mean (another datum?)"
    assert found.aside == (words,)
    climbing = judge_log(reported(truth=other(turned(TURN), above=0.2 * T_S)))
    assert "height 4.6 m" in climbing.size
    assert climbing.reasons == ("the height's error is beyond its sigma",)


def test_a_slow_log_says_first_that_its_attitude_is_a_guess():
    slow = judge_log(reported(imu=1.25, own=other(turned(TURN + 40.0))))
    assert slow.sentence.startswith(
        "slow: inertial samples at 1.25 Hz (20 Hz or more would do), so the attitude is a guess "
        f"(yaw 40 deg, tilt 0.0 deg RMS from the autopilot's), {NEAR}"
    )


def test_an_aid_that_was_refused_often_is_named():
    own = other(turned(TURN))
    assert judge_log(reported(refused=20, own=own)).aside == ()
    often = judge_log(reported(refused=50, own=own))
    assert often.sentence == (
        f"good: {NEAR}, no resets, 33% of the compass's headings refused (its field is not the "
        "Earth's: calibrate mag may help)"
    )


def attitude_only(sigma_yaw_deg=2.0, **witness):
    """Return a report on a log without fixes, and so without a position."""
    found = reported(**witness)
    found.track, found.seconds = Track(), {Status.ATTITUDE: 100.0}
    table = table_of(T_S)
    for name, values in zip(QUATERNION, turned(TURN).T, strict=True):
        table.values[:, COLUMNS.index(name) - 1] = values
    for name, sigma in (("sd_roll", 2.0), ("sd_pitch", 2.0), ("sd_yaw", sigma_yaw_deg)):
        table.values[:, COLUMNS.index(name) - 1] = np.deg2rad(sigma)
    for name in GEODETIC:
        table.values[:, COLUMNS.index(name) - 1] = np.nan
    table.values[:, COLUMNS.index("status") - 1] = Status.ATTITUDE
    found.track.add(NONE, table)
    found.counts[Kind.GNSS] = 0
    return found


def attitude_of(q_nb):
    """Return a trajectory of attitudes alone, as of an autopilot without a position."""
    return Trajectory(name="ATT", att_t_ns=np.rint(T_S * SECOND_NS).astype(np.int64), q_nb=q_nb)


def test_without_a_position_the_attitude_is_compared_all_the_same():
    near = judge_log(attitude_only(own=attitude_of(turned(TURN + 1.0, 0.5))))
    assert near.sentence == (
        "attitude only: yaw 1.0 deg, tilt 0.5 deg RMS from the autopilot's, no GNSS fix"
    )
    far = judge_log(attitude_only(own=attitude_of(turned(TURN + drifted(30.0, 90.0, 53.0)))))
    assert "yaw up to 5" in far.sentence
    assert "from the autopilot's at" in far.sentence
    truth = judge_log(attitude_only(truth=attitude_of(turned(TURN + 20.0))))
    assert truth.sentence.startswith("attitude only: yaw 20 deg, tilt 0.0 deg RMS from the truth")
    # with positions of the witness, which there is nothing to compare with
    assert judge_log(attitude_only(own=other(turned(TURN)))).sentence.startswith(
        "attitude only: yaw 0.0 deg, tilt 0.0 deg RMS from the autopilot's, no GNSS fix"
    )
    assert judge_log(attitude_only()).sentence == "attitude only: no GNSS fix"


def test_a_yaw_that_is_not_known_is_not_compared():
    found = judge_log(attitude_only(100.0, own=attitude_of(turned(TURN + 120.0))))
    assert found.sentence == "attitude only: tilt 0.0 deg RMS from the autopilot's, no GNSS fix"


def test_a_compass_that_is_refused_is_named_beside_a_heading_that_is_not():
    found = reported(own=other(turned(TURN)))
    none = dict.fromkeys(Verdict, 0)
    compass, antennas = none | {Verdict.DISTURBED: 125}, none | {Verdict.FUSED: 420}
    both = none | {Verdict.DISTURBED: 125, Verdict.FUSED: 420}
    found.health = replace(
        found.health,
        verdicts=dict(found.health.verdicts) | {Aid.HEADING: both},
        headings={"compass": compass, "antennas": antennas},
    )
    assert judge_log(found).aside == (
        "all 125 of the compass's headings refused (its field is not the Earth's: calibrate mag "
        "may help)",
    )
    lines = summary(found)
    assert "    compass: 125 disturbed" in lines
    assert "    antennas: 420 fused" in lines
    # by a gate, and not for its field
    gated = none | {Verdict.GATED: 60, Verdict.FUSED: 40}
    found.health = replace(found.health, headings={"compass": none, "antennas": gated})
    assert judge_log(found).aside == ("60% of the headings of two antennas refused",)
