"""The verdict on a log, by what a report says of it and by what else knew the position."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.recording import Damage
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status
from ekf_companion.review.departure import YAW, Angle, Departure, Excess, Height
from ekf_companion.review.evidence import Evidence
from ekf_companion.review.report import Report
from ekf_companion.review.track import Size
from ekf_companion.review.verdict import judge

HEALTH = Pipeline(FilterSettings()).health()
SURE = Evidence(sigma=Size(0.4, 0.5, 10.0))


def report(seconds=None, *, resets=0, refused=0, imu=250.0, gnss=100, **more):
    counts = dict.fromkeys(Verdict, 0) | {Verdict.FUSED: 100 - refused, Verdict.GATED: refused}
    verdicts = dict(HEALTH.verdicts) | {Aid.POSITION: counts}
    found = Report(log="x", seconds=seconds or {Status.OK: 100.0}, **more)
    found.counts[Kind.GNSS] = gnss
    found.rates[Kind.IMU] = imu
    found.health = replace(HEALTH, resets=resets, reset_reason="position", verdicts=verdicts)
    return found


def from_truth(rms, worst):
    return Evidence(sigma=SURE.sigma, truth=Size(rms, worst, 54.0), autopilot=Size(9.0, 9.0, 1.0))


def from_autopilot(rms, to_fixes=None, worst=0.0):
    return Evidence(sigma=SURE.sigma, autopilot=Size(rms, worst, 72.0), to_fixes=to_fixes)


@pytest.mark.parametrize(
    ("aid", "fused", "words"),
    [
        (Aid.BARO, 63, "37% of the barometer's measurements refused"),
        (Aid.RANGE_FINDER, 63, "37% of the range finder's measurements refused"),
        (Aid.RANGE_FINDER, 0, "all 37 of the range finder's measurements refused"),
    ],
)
def test_a_declared_aid_that_was_refused_often_is_named_by_its_sensor(aid, fused, words):
    found = report()
    counts = dict.fromkeys(Verdict, 0) | {Verdict.FUSED: fused, Verdict.GATED: 37}
    found.health = replace(found.health, verdicts={**found.health.verdicts, aid: counts})
    assert judge(found, SURE).aside == (words,)


OTHER = Evidence(truth=Size(1.3e7, 1.3e7, 1.0), truth_to_fixes=(0.8, 1.3e7))
LIES = Evidence(truth=Size(18.0, 25.0, 1.0), truth_to_fixes=(20.0, 25.0))
"""A receiver that lies all flight long, and an estimate that follows only partly."""


def silent(seconds):
    """Return a report on samples of 100 s, none for so long from 20 s on."""
    t_s = np.arange(0.0, 100.0, 0.01)
    found = report()
    found.track.stretches.add(
        np.rint(t_s[(t_s <= 20.0) | (t_s >= 20.0 + seconds)] * 1e9).astype(np.int64)
    )
    return found


BAD = Damage("1314 damaged places in the file (27.6 kB)", 0.02)


@pytest.mark.parametrize(
    ("found", "sentence"),
    [
        (report(), "good: 0.4 m RMS by its own sigma, no resets"),
        (
            silent(3.1),
            "good: 0.4 m RMS by its own sigma, no resets, no inertial samples for 3.1 s at 20 s",
        ),
        (silent(12.0), "fair: 0.4 m RMS by its own sigma, no inertial samples for 12 s at 20 s"),
        (report(resets=1), "fair: 0.4 m RMS by its own sigma, 1 reset (last: position)"),
        (report(resets=3), "poor: 3 resets (last: position), 0.4 m RMS by its own sigma"),
        (
            report(resets=1, reboots=1),
            "fair: 0.4 m RMS by its own sigma, the autopilot rebooted once",
        ),
        (report(refused=10), "fair: 0.4 m RMS by its own sigma, 10% of the fixes refused"),
        (report(refused=30), "poor: 30% of the fixes refused, 0.4 m RMS by its own sigma"),
        (
            report({Status.OK: 80.0, Status.DEAD_RECKONING: 10.0}),
            "fair: 0.4 m RMS by its own sigma, without GNSS for 10 s",
        ),
        (report({Status.OK: 97.0, Status.DEGRADED: 3.0}), "good: 0.4 m"),
        (
            report({Status.OK: 97.0, Status.INVALID: 3.0}),
            "poor: not valid for 3 s, 0.4 m RMS by its own sigma",
        ),
        (report({Status.ATTITUDE: 90.0}, gnss=0), "attitude only: no GNSS fix"),
        (report({Status.ATTITUDE: 90.0}), "attitude only: no position, for no heading was"),
    ],
)
def test_the_verdict_names_size_and_reasons(found, sentence):
    assert judge(found, SURE).sentence.startswith(sentence)


@pytest.mark.parametrize(
    ("evidence", "sentence"),
    [
        (from_truth(0.42, 0.9), "good: 0.4 m RMS from the truth, no resets"),
        (
            OTHER,
            "poor: 13000 km RMS from the truth, the truth is 13000 km from the receiver's fixes "
            "too (is it of this flight?)",
        ),
        (LIES, "poor: 18.0 m RMS from the truth, far from the truth"),
        (from_truth(3.0, 4.0), "fair: 3.0 m RMS from the truth, not close to the truth"),
        (
            from_truth(9.7, 46.0),
            "poor: 9.7 m RMS from the truth (46 m at 54 s), far from the truth",
        ),
        (
            Evidence(sigma=Size(9.2, 54.4, 53.0)),
            "poor: 9.2 m RMS by its own sigma (54 m at 53 s), unsure of its position",
        ),
        (from_autopilot(1.9), "good: differs from the autopilot's estimate by 1.9 m RMS, no"),
        (
            from_autopilot(3.0, (0.2, 3.1), 9.65),
            "good: differs from the autopilot's estimate by 3.0 m RMS (9.7 m at 72 s), the receiver"
            " agrees with ours (0.2 m, not 3.1 m), no resets",
        ),
        (
            from_autopilot(3.0, (3.1, 0.2)),
            "fair: differs from the autopilot's estimate by 3.0 m RMS, the receiver agrees with the"
            " autopilot's (0.2 m, not 3.1 m)",
        ),
        (
            from_autopilot(9.0, (9.1, 0.2)),
            "poor: differs from the autopilot's estimate by 9.0 m RMS, the receiver agrees with the"
            " autopilot's (0.2 m, not 9.1 m)",
        ),
        (
            from_autopilot(9.0),
            "fair: differs from the autopilot's estimate by 9.0 m RMS, the receiver does not say",
        ),
        (
            from_autopilot(1.0)._replace(sigma=Size(9.2, 54.4, 53.0)),
            "poor: differs from the autopilot's estimate by 1.0 m RMS, sigma 9.2 m RMS (54 m at",
        ),
    ],
)
def test_the_best_witness_of_the_position_is_the_one_that_counts(evidence, sentence):
    assert judge(report(), evidence).sentence.startswith(sentence)


RIGHT = Angle("yaw", YAW, np.deg2rad(1.0), 90.0)
TURNED = Angle("yaw", YAW, np.deg2rad(18.0), 90.0)
LOST = Excess(5.0, np.deg2rad(24.0), 29.5, 28.0)


def flown(rms, *angles, height=None, truth=True):
    """Return evidence of a flight whose position is so far from a truth, or the autopilot's."""
    size, departure = Size(rms, rms, 1.0), Departure(truth, angles, height)
    return Evidence(**{"truth" if truth else "autopilot": size}, departure=departure)


DOUBTS = {Status.OK: 30.0, Status.DEGRADED: 70.0}


@pytest.mark.parametrize(
    ("found", "evidence", "sentence"),
    [
        (report(DOUBTS), flown(0.7, RIGHT), "fair: 0.7 m RMS from the truth, degraded for 70 s"),
        (report(DOUBTS), flown(0.04), "fair: 0.0 m RMS from the truth, degraded for 70 s"),
        (report(refused=42), flown(0.7, RIGHT), "fair: 0.7 m RMS from the truth, 42% of the fixes"),
        (report(resets=3), flown(0.7, RIGHT), "fair: 0.7 m RMS from the truth, 3 resets"),
        (
            report({Status.OK: 40.0, Status.DEAD_RECKONING: 60.0}),
            flown(1.9),
            "fair: 1.9 m RMS from the truth, without GNSS for 60 s",
        ),
        (
            report({Status.OK: 98.0, Status.INVALID: 2.0}),
            flown(0.0),
            "fair: 0.0 m RMS from the truth, not valid for 2 s",
        ),
        # What is right only while it is given is poor all the same
        (
            report({Status.OK: 10.0, Status.INVALID: 90.0}),
            flown(0.0),
            "poor: not valid for 90 s, 0.0 m RMS from the truth",
        ),
        (report(DOUBTS), flown(3.0), "poor: degraded for 70 s, 3.0 m RMS from the truth, not cl"),
        (report(DOUBTS), flown(0.7, TURNED), "poor: degraded for 70 s, 0.7 m RMS from the truth"),
        (
            report(DOUBTS),
            flown(0.7, RIGHT._replace(ours=LOST)),
            "poor: degraded for 70 s, 0.7 m RMS from the truth, yaw up to 24 deg from the truth",
        ),
        (
            report(DOUBTS),
            flown(0.7, height=Height(14.3, 0.4, 1.0)),
            "poor: degraded for 70 s, 0.7 m RMS from the truth, height 14.3 m above the truth",
        ),
        (
            report(DOUBTS),
            flown(0.7, RIGHT, truth=False),
            "fair: differs from the autopilot's estimate by 0.7 m RMS, degraded for 70 s",
        ),
        # An autopilot that refuses the same receiver is no witness for what was not used
        (
            report(refused=42),
            flown(0.7, RIGHT, truth=False),
            "poor: 42% of the fixes refused, differs from the autopilot's estimate by 0.7 m RMS",
        ),
        (report(DOUBTS), SURE, "poor: degraded for 70 s, 0.4 m RMS by its own sigma"),
        (
            report(is_contradictory=True),
            flown(0.3),
            "poor: the units or axes look wrong, 0.3 m RMS from the truth",
        ),
    ],
)
def test_a_flight_that_is_right_is_not_poor_and_what_makes_one_poor_comes_first(
    found, evidence, sentence
):
    assert judge(found, evidence).sentence.startswith(sentence)


def test_a_slow_or_short_log_is_called_that_and_not_poor():
    slow = report({Status.DEGRADED: 100.0}, imu=3.3, resets=4)
    assert judge(slow, SURE).sentence == (
        "slow: inertial samples at 3.3 Hz (20 Hz or more would do), so the attitude is a guess, "
        "0.4 m RMS by its own sigma, degraded for 100 s, 4 resets (last: position)"
    )
    short = report({Status.ALIGNING: 4.1, Status.DEGRADED: 2.4})
    assert judge(short, SURE).sentence.startswith("short: 6 s are too few to judge")
    assert judge(report(imu=25.0), SURE).grade == "fair"
    assert judge(report(imu=50.0), SURE).grade == "good"


def test_damage_and_loss_are_said_and_count_once_they_are_much():
    little = report(damage=BAD._replace(share=0.001))
    assert judge(little, SURE).sentence == (
        f"good: 0.4 m RMS by its own sigma, no resets, {BAD.words}"
    )
    assert judge(report(damage=BAD), SURE).sentence.startswith("fair: 0.4 m")
    assert BAD.words in judge(report(damage=BAD), SURE).reasons
    lossy = judge(report(lost_share=0.08), SURE)
    assert (lossy.grade, lossy.reasons) == ("fair", ("8% of the telemetry lost on the link",))


def test_a_short_silence_of_the_inertial_samples_is_not_named():
    assert judge(silent(0.9), SURE).sentence == "good: 0.4 m RMS by its own sigma, no resets"
