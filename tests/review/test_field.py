"""A gyro and a magnetometer that do not turn alike are named; those that do are not."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.review.agreement import contradictions
from ekf_companion.review.axes import axis_disagreement
from ekf_companion.review.field import field_disagreement
from sim_autopilot.config import SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight

COARSE = replace(SimConfig(), imu=replace(SimConfig().imu, rate=50.0))
EXCHANGED, FLU = np.eye(3)[[1, 0, 2]], np.diag([1.0, -1.0, -1.0])
IRON = (0.2, -0.15, 0.1)


def flown(scenario, seconds, seed=4):
    found = events(Flight.plan(scenario, COARSE, duration=seconds, seed=seed), has_vel_down=True)
    return [found.take(found.kind == kind) for kind in (Kind.IMU, Kind.MAG, Kind.GNSS)]


@pytest.fixture(scope="module")
def quad():
    return flown("figure-eight", 40.0)


def turned(table, by):
    """Return events whose first three columns are multiplied by a matrix."""
    values = table.values.copy()
    values[:, :3] = values[:, :3] @ np.asarray(by).T
    return Events(t_ns=table.t_ns, kind=table.kind, values=values)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("scenario", "seconds"),
    [("static", 30.0), ("hover", 60.0), ("walk", 60.0), ("figure-eight", 30.0), ("loiter", 90.0)],
)
def test_what_is_declared_right_is_not_doubted(scenario, seconds, seed):
    imu, mag, _ = flown(scenario, seconds, seed)
    assert field_disagreement(imu, mag) == ""
    # Hard iron of half the field, and a noisy sensor
    values = mag.values.copy()
    values[:, :3] += IRON + np.random.default_rng(seed).normal(0.0, 0.01, (len(values), 3))
    noisy = Events(t_ns=mag.t_ns, kind=mag.kind, values=values)
    assert field_disagreement(imu, noisy) == ""
    late = Events(t_ns=mag.t_ns + 100_000_000, kind=mag.kind, values=mag.values)
    assert field_disagreement(imu, late) == ""


@pytest.mark.parametrize(
    ("of_gyro", "of_mag", "sentence"),
    [
        (np.eye(3) * 57.29578, np.eye(3), "gyro looks like deg/s: say units={'gyro': 'deg/s'}"),
        (np.eye(3) / 57.29578, np.eye(3), "gyro looks like rad/s that is called deg/s"),
        (-np.eye(3), np.eye(3), "gyro has the other sign"),
        (np.diag([1.0, 1.0, -1.0]), np.eye(3), "z of gyro is reversed"),
        (EXCHANGED, np.eye(3), "x and y of gyro are exchanged"),
        (np.eye(3), EXCHANGED, "x and y of mag are exchanged. Both"),
        (np.eye(3), EXCHANGED * [1.0, 1.0, -1.0], "x and y of mag are exchanged, and its z is up"),
        (np.eye(3), FLU, "mag is forward, left, up"),
        (np.eye(3), np.diag([1.0, 1.0, -1.0]), "z of mag is reversed"),
    ],
)
def test_axes_signs_and_units_by_which_the_field_does_not_turn_are_named(
    quad, of_gyro, of_mag, sentence
):
    imu, mag, _ = quad
    found = field_disagreement(turned(imu, of_gyro), turned(mag, of_mag))
    assert sentence in found
    assert found in contradictions(turned(imu, of_gyro), mag=turned(mag, of_mag))


@pytest.mark.parametrize(
    ("size", "sentence"), [(57.29578, "gyro looks like deg/s: "), (1.0 / 57.29578, "like rad/s")]
)
def test_units_of_the_gyro_show_in_the_velocity_of_the_fixes(quad, size, sentence):
    imu, _, fixes = quad
    assert sentence in axis_disagreement(turned(imu, np.eye(3) * size), fixes)


def test_hard_iron_as_strong_as_the_field_and_a_bias_hide_no_mistake(quad):
    imu, mag, _ = quad
    values, rates = mag.values.copy(), imu.values.copy()
    values[:, :3] += (0.4, -0.3, 0.2)
    rates[:, :3] += (0.02, -0.02, 0.02)
    biased = Events(t_ns=imu.t_ns, kind=imu.kind, values=rates)
    iron = Events(t_ns=mag.t_ns, kind=mag.kind, values=values)
    assert field_disagreement(biased, iron) == ""
    assert "z of gyro is rev" in field_disagreement(turned(biased, np.diag([1, 1, -1])), iron)
    assert "gyro has the other sign" in field_disagreement(turned(biased, -np.eye(3)), iron)


def test_damaged_rows_and_gaps_are_left_out(quad):
    imu, mag, _ = quad

    def damaged(table):
        values, t_ns = table.values.copy(), table.t_ns.copy()
        for row, number in ((50, 1e300), (60, np.inf), (70, -1e18), (80, np.nan)):
            values[row, :3] = number
        t_ns[len(t_ns) // 2 :] += 60_000_000_000
        return Events(t_ns=t_ns, kind=table.kind, values=values)

    assert field_disagreement(damaged(imu), damaged(mag)) == ""
    mistaken = damaged(turned(imu, -np.eye(3)))
    assert "gyro has the other sign" in field_disagreement(mistaken, damaged(mag))
    assert field_disagreement(imu.take(imu.kind != Kind.IMU), mag) == ""
    assert field_disagreement(imu, mag.take(mag.kind != Kind.MAG)) == ""
