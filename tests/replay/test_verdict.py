"""The verdict on a log, by what a report says of it."""

from dataclasses import replace

import pytest

from ekf_companion.core.settings import FilterSettings
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status
from ekf_companion.replay.report import Report
from ekf_companion.replay.verdict import judge

HEALTH = Pipeline(FilterSettings()).health()


def report(seconds=None, *, resets=0, refused=0, imu=250.0, reboots=0, gnss=100):
    counts = dict.fromkeys(Verdict, 0) | {Verdict.FUSED: 100 - refused, Verdict.GATED: refused}
    verdicts = dict(HEALTH.verdicts) | {Aid.POSITION: counts}
    found = Report(log="x", seconds=seconds or {Status.OK: 100.0}, reboots=reboots)
    found.counts[Kind.GNSS] = gnss
    found.rates[Kind.IMU] = imu
    found.horizontal_stds = [0.4, 0.5, 0.4]
    found.health = replace(HEALTH, resets=resets, reset_reason="position", verdicts=verdicts)
    return found


@pytest.mark.parametrize(
    ("found", "difference", "sentence"),
    [
        (report(), None, "good: 0.4 m by its own sigma, no resets"),
        (report(), (0.42, "the truth", True), "good: 0.4 m RMS from the truth, no resets"),
        (
            report(),
            (3.0, "the truth", True),
            "fair: 3.0 m RMS from the truth, not close to the truth",
        ),
        (report(), (9.0, "the truth", True), "poor: 9.0 m RMS from the truth, far from the truth"),
        (report(), (9.0, "the autopilot", False), "fair: 9.0 m RMS from the autopilot, far from t"),
        (report(resets=1), None, "fair: 0.4 m by its own sigma, 1 reset (last: position)"),
        (report(resets=3), None, "poor: 0.4 m by its own sigma, 3 resets (last: position)"),
        (
            report(resets=1, reboots=1),
            None,
            "fair: 0.4 m by its own sigma, the autopilot rebooted once",
        ),
        (report(refused=10), None, "fair: 0.4 m by its own sigma, 10% of the fixes refused"),
        (report(refused=30), None, "poor: 0.4 m by its own sigma, 30% of the fixes refused"),
        (report(imu=3.3), None, "poor: 0.4 m by its own sigma, inertial samples at 3.3 Hz"),
        (
            report({Status.OK: 80.0, Status.DEAD_RECKONING: 10.0}),
            None,
            "fair: 0.4 m by its own sigma, without GNSS for 10 s",
        ),
        (report({Status.OK: 97.0, Status.DEGRADED: 3.0}), None, "good: 0.4 m"),
        (report({Status.OK: 97.0, Status.INVALID: 3.0}), None, "poor: 0.4 m by its own sigma, not"),
        (report({Status.ATTITUDE: 90.0}, gnss=0), None, "attitude only: no GNSS fix"),
        (report({Status.ATTITUDE: 90.0}), None, "attitude only: no position, for no heading was"),
    ],
)
def test_the_verdict_names_size_and_reasons(found, difference, sentence):
    assert judge(found, difference).sentence.startswith(sentence)
