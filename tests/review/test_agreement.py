"""Sensors that contradict each other are named; those that agree are not, whatever is flown."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.review import axes
from ekf_companion.review.agreement import AgreementCheck
from ekf_companion.review.axes import axis_disagreement, integrated_force
from ekf_companion.review.clocks import clock_disagreement, fix_shift
from ekf_companion.review.fixes import disagreements, suspicion
from sim_autopilot.config import SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight

COARSE = replace(SimConfig(), imu=replace(SimConfig().imu, rate=50.0))


class Flown:
    """The sensors of a simulated flight, each as events."""

    def __init__(self, scenario, seconds, seed=4):
        found = events(
            Flight.plan(scenario, COARSE, duration=seconds, seed=seed), has_vel_down=True
        )
        self.imu, self.fixes, self.baro = (
            found.take(found.kind == kind) for kind in (Kind.IMU, Kind.GNSS, Kind.BARO)
        )

    def said(self):
        axes = axis_disagreement(self.imu, self.fixes)
        return [*disagreements(self.fixes, self.baro), *filter(None, (axes,))]


@pytest.fixture(scope="module")
def wing():
    return Flown("loiter", 70.0)


@pytest.fixture(scope="module")
def quad():
    return Flown("figure-eight", 40.0)


def changed(table, **columns):
    """Return events with columns made anew of the values: ``c3=lambda v: v[:, 4]``."""
    values = table.values.copy()
    for name, make in columns.items():
        values[:, int(name[1:])] = make(table.values)
    return Events(t_ns=table.t_ns, kind=table.kind, values=values)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("scenario", "seconds"),
    [
        ("static", 30.0),
        ("hover", 60.0),
        ("walk", 60.0),
        ("figure-eight", 30.0),
        ("loiter", 90.0),
        ("square-spiral", 120.0),
    ],
)
def test_what_is_declared_right_is_not_doubted(scenario, seconds, seed):
    flown = Flown(scenario, seconds, seed)
    assert flown.said() == []
    level = changed(flown.fixes, c5=lambda v: np.full(len(v), np.nan))
    assert axis_disagreement(flown.imu, level) == ""
    assert disagreements(level, None) == []
    assert suspicion(flown.fixes) == ""
    assert clock_disagreement(flown.imu, flown.fixes) == ""
    assert clock_disagreement(flown.imu, level) == ""


def test_what_another_reading_fits_as_well_is_not_doubted():
    """Straight to the north, the sign of east and the barometer's unit cannot be told."""
    rng = np.random.default_rng(3)
    t_ns = np.arange(0, 60_000_000_000, 200_000_000)
    north = 15.0 * t_ns * 1e-9 + rng.normal(0.0, 0.5, len(t_ns))
    east, alt = rng.normal(0.0, 0.5, (2, len(t_ns)))
    place = (0.8 + north / 6.37e6, 0.15 + east / 4.44e6, 400.0 + alt)
    speed = rng.normal((15.0, 0.3, 0.0), 0.1, (len(t_ns), 3))
    fixes = Events.from_columns(t_ns, Kind.GNSS, *place, *speed.T, 1.5, 2.5, 0.3)
    assert disagreements(fixes) == []
    (found,) = disagreements(changed(fixes, c3=lambda v: -v[:, 3]))
    assert "the other sign of north" in found


def scaled(size):
    return {f"c{k}": lambda v, k=k: size * v[:, k] for k in (3, 4, 5)}


RADIANS = {"c0": lambda v: np.deg2rad(v[:, 0]), "c1": lambda v: np.deg2rad(v[:, 1])}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (RADIANS, "latitude and longitude look like radians; name them lat_rad"),
        (scaled(3.6), "3.6 times as fast as the positions move: they look like km/h"),
        (scaled(100.0), "look like cm/s; give m/s"),
        (scaled(3.28084), "look like ft/s; give m/s"),
        (scaled(1.943844), "look like knots; give m/s"),
        ({"c3": lambda v: v[:, 4], "c4": lambda v: v[:, 3]}, "velocities are exchanged; veloc"),
        (
            {"c0": lambda v: v[:, 1], "c1": lambda v: v[:, 0]},
            "latitude and longitude are exchanged",
        ),
        ({"c1": lambda v: -v[:, 1]}, "the other sign of east; latitudes are positive north"),
        ({"c3": lambda v: -v[:, 3]}, "the other sign of north; latitudes are positive north"),
        ({"c2": lambda v: v[:, 2] * 1e-3}, "alt looks like km; give m and m/s"),
        (
            {"c2": lambda v: v[:, 2] * 3.28084},
            "the barometer's height: alt looks like feet; give m",
        ),
        ({"c5": lambda v: -v[:, 5]}, "alt falls as the vertical velocity rises"),
    ],
)
def test_positions_velocities_and_heights_that_disagree_are_named(wing, change, sentence):
    (found,) = disagreements(changed(wing.fixes, **change), wing.baro)
    assert sentence in found


def test_a_barometer_in_feet_is_told_from_heights_in_feet(wing):
    feet = changed(wing.baro, c0=lambda v: v[:, 0] * 3.28084)
    (found,) = disagreements(wing.fixes, feet)
    assert "the barometer's height looks like feet; give m and m/s" in found
    unknown = {"c5": lambda v: np.full(len(v), np.nan)}
    (found,) = disagreements(changed(wing.fixes, **unknown), feet)
    assert "alt moves 0.3048 times as much as the barometer's height: the barometer's" in found
    km = changed(wing.fixes, **unknown, c2=lambda v: v[:, 2] * 1e-3)
    (found,) = disagreements(km, wing.baro)
    assert "alt looks like km, or the barometer's height looks like mm" in found
    fast = changed(wing.fixes, c5=lambda v: v[:, 5] * 100.0)
    (found,) = disagreements(fast, wing.baro)
    assert "the vertical velocity looks like cm/s; give m and m/s" in found


def test_radians_without_a_velocity_to_tell_are_doubted_by_their_place(wing):
    unknown = {f"c{k}": lambda v: np.full(len(v), np.nan) for k in (3, 4, 5)}
    there = changed(wing.fixes, **unknown)
    assert "the ocean south of Ghana" in suspicion(changed(wing.fixes, **RADIANS, **unknown))
    assert suspicion(there) == ""
    # Simulators begin at latitude and longitude 0; and a ship may be there: its velocity shows it
    null = changed(there, c0=lambda v: v[:, 0] - v[0, 0], c1=lambda v: v[:, 1] - v[0, 1])
    assert suspicion(null) == ""
    at_sea = {"c0": lambda v: v[:, 0] - v[0, 0] + 0.01, "c1": lambda v: v[:, 1] - v[0, 1]}
    assert suspicion(changed(wing.fixes, **at_sea)) == ""
    assert "the ocean" in suspicion(changed(there, **at_sea))


EXCHANGED, FLU = np.eye(3)[[1, 0, 2]], np.diag([1.0, -1.0, -1.0])


@pytest.mark.parametrize("seconds", [18.0, -5.0, 1.0, -1.0])
def test_fixes_on_another_clock_are_named_with_how_far_it_is_off(quad, seconds):
    late = Events(
        t_ns=quad.fixes.t_ns + int(seconds * 1e9), kind=quad.fixes.kind, values=quad.fixes.values
    )
    # The simulator's receiver is late by 0.12 s
    assert fix_shift(quad.imu, late) == pytest.approx(seconds + 0.12, abs=0.1)
    check = AgreementCheck()
    check.add(merge(late, quad.imu))
    faults, (doubt,) = check.found()
    assert faults == []
    side = "late" if seconds > 0.0 else "early"
    size = abs(round(seconds + 0.1, 1))
    assert f"show the motion of gyro and accel {size:.1f} s too {side}: the times of both" in doubt


def test_fixes_that_are_declared_late_are_no_other_clock(quad):
    t_ns = quad.fixes.t_ns + 1_000_000_000
    late = Events(t_ns=t_ns, kind=quad.fixes.kind, values=quad.fixes.values)
    assert clock_disagreement(quad.imu, late) != ""
    assert clock_disagreement(quad.imu, late, 1.0) == ""
    assert "0.9 s too early" in clock_disagreement(quad.imu, quad.fixes, 1.0)


def test_fixes_later_by_a_receivers_delay_are_no_other_clock(quad):
    for seconds in (-0.1, 0.1, 0.3):
        t_ns = quad.fixes.t_ns + int(seconds * 1e9)
        late = Events(t_ns=t_ns, kind=quad.fixes.kind, values=quad.fixes.values)
        assert fix_shift(quad.imu, late) is None


@pytest.mark.parametrize(
    ("of_gyro", "of_accel", "sentence"),
    [
        (EXCHANGED, EXCHANGED, "x and y of both are exchanged, or one of the two is reversed"),
        (np.diag([1.0, -1.0, 1.0]), np.diag([1.0, -1.0, 1.0]), "x and y of both are exchanged"),
        (EXCHANGED, np.eye(3), "x and y of gyro alone are exchanged"),
        (FLU, np.eye(3), "gyro is forward, left, up and accel forward, right, down"),
        (np.diag([1.0, 1.0, -1.0]), np.eye(3), "z of gyro is reversed"),
        (-np.eye(3), np.eye(3), "gyro has the other sign"),
    ],
)
def test_axes_that_do_not_fit_the_velocity_are_named(quad, of_gyro, of_accel, sentence):
    values = quad.imu.values.copy()
    values[:, :3] = values[:, :3] @ of_gyro.T
    values[:, 3:6] = values[:, 3:6] @ of_accel.T
    mistaken = Events(t_ns=quad.imu.t_ns, kind=quad.imu.kind, values=values)
    assert sentence in axis_disagreement(mistaken, quad.fixes)


def test_axes_turned_about_down_together_cannot_be_told_from_another_heading(quad):
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    values = quad.imu.values.copy()
    values[:, :3], values[:, 3:6] = values[:, :3] @ turn.T, values[:, 3:6] @ turn.T
    turned = Events(t_ns=quad.imu.t_ns, kind=quad.imu.kind, values=values)
    assert axis_disagreement(turned, quad.fixes) == ""


def test_a_jump_of_the_receiver_is_not_taken_for_a_unit(wing):
    rows = np.arange(len(wing.fixes))
    wild = (rows > 100) & (rows < 160)
    glitch = changed(
        wing.fixes, c0=lambda v: v[:, 0] + wild * 1e-5, c2=lambda v: v[:, 2] + 30 * wild
    )
    assert disagreements(glitch, wing.baro) == []
    assert axis_disagreement(wing.imu, glitch) == ""


def test_damaged_rows_are_left_out(wing, quad):
    def damaged(table):
        values = table.values.copy()
        for row, number in ((50, 1e300), (60, np.inf), (70, -1e18), (80, np.nan)):
            values[row, :6] = number
        t_ns = table.t_ns.copy()
        if table is not quad.imu:
            t_ns[-1] += 10**17  # three years later
        return Events(t_ns=t_ns, kind=table.kind, values=values)

    for flown in (wing, quad):
        fixes, imu, baro = damaged(flown.fixes), damaged(flown.imu), damaged(flown.baro)
        assert disagreements(fixes, baro) == []
        assert axis_disagreement(imu, fixes) == ""
        assert clock_disagreement(imu, fixes) == ""
        assert suspicion(fixes) == ""
    (found,) = disagreements(damaged(changed(wing.fixes, **scaled(3.6))), damaged(wing.baro))
    assert "look like km/h" in found


@pytest.mark.parametrize("seed", [1, 3])
def test_an_hour_of_a_receivers_noise_is_no_other_unit_of_height(seed):
    """In an hour the noise makes a few spans three times as long as the climb in them."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 3600.0, 0.2)
    keeps = np.exp(-0.2 / 60.0)
    steps = 1.8 * np.sqrt(1.0 - keeps**2) * rng.standard_normal(len(t))
    slow = lfilter([1.0], [1.0, -keeps], steps)
    turn = 2.0 * np.pi / 20.0
    alt = 488.0 + 0.8 * np.sin(turn * t) + slow + 0.8 * rng.standard_normal(len(t))
    down = -0.8 * turn * np.cos(turn * t) + 0.1 * rng.standard_normal(len(t))
    still = np.zeros(len(t))
    at_home = (still + np.deg2rad(47.0), still + np.deg2rad(8.0), alt)
    t_ns = (t * 1e9).astype(np.int64)
    fixes = Events.from_columns(t_ns, Kind.GNSS, *at_home, still, still, down)
    assert disagreements(fixes) == []


def test_a_long_recording_is_compared_in_constant_memory():
    """By what is kept of each block, once there are samples enough."""
    size = 250_000
    kind = np.full(size, Kind.IMU, dtype=np.int8)
    kind[::5] = Kind.MAG
    kind[1::10] = Kind.BARO
    # At 350 events/s
    t_ns = np.arange(size, dtype=np.int64) * 2_857_143
    check = AgreementCheck()
    held = []
    tracemalloc.start()
    for part in range(6):
        values = np.ones((size, Events.from_rows([]).values.shape[1]))
        check.add(Events(t_ns=t_ns + part * (t_ns[-1] + 1), kind=kind.copy(), values=values))
        del values
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert held[5] - held[2] < 0.05 * held[2]


def test_exchanged_axes_need_no_integration_of_their_own():
    rng = np.random.default_rng(2)
    samples = axes.SECONDS * int(axes.RATE)
    gyro, accel = rng.standard_normal((2, samples, 3, 3))
    of_gyro, of_accel = (np.array(part) for part in zip(*axes.CANDIDATES, strict=True))
    each = integrated_force(gyro, accel, of_gyro, of_accel)
    # 300 sums of forces of 1 m/s2, rounded
    np.testing.assert_allclose(axes._forces(gyro, accel), each, rtol=0.0, atol=1e-12)
