"""Several real inertial units on one vehicle, one of which fails (docs/SOURCES.md)."""

import numpy as np
import pytest

from benchmarks.accuracy.four_imus import FLIGHTS, FOLDER, UNITS, Track, Unit, mounting
from ekf_companion.logs import dataflash
from ekf_companion.logs.dataflash_records import read_tables
from ekf_companion.logs.dataflash_tables import READ
from ekf_companion.logs.series import stack
from ekf_companion.nav.lanes import Lanes, used_rows
from tests.paths import DATA

COPTER = DATA / "two-imus-copter-aerobatic" / "1.BIN"
needs_data = pytest.mark.skipif(not COPTER.is_file(), reason="the recorded flights are not here")
pytestmark = [pytest.mark.campaign, needs_data]
AXES = ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")
BEFORE, AFTER = 12.0, 1.0
"""Time that is looked at before and after a fault, s."""
LEAVES = 0.2


def four_units():
    """Return the flights of a quadrotor with four units: of each stamps (s) and samples."""
    flights = []
    for name in FLIGHTS:
        track = Track.read(DATA / FOLDER / name / "GT.csv")
        units = [Unit.read(DATA / FOLDER / name / f"IMU_{number}.csv") for number in UNITS]
        flight = []
        for one in units:
            mounted = mounting(track, one)
            turned = np.hstack([one.gyro @ mounted.C_bu.T, one.accel @ mounted.C_bu.T])
            flight.append((one.t - mounted.offset, turned))
        flights.append(flight)
    return flights


def two_units():
    """Return the flight of an aerobatic copter with two units, in the axes of the board."""
    found, *_ = read_tables(COPTER, READ)
    tables = [found[name].all() for name in ("IMU", "IMU2")]
    return [[(one["TimeMS"] * 1e-3, stack(one, *AXES)) for one in tables]]


def freeze(values, after):
    values[after] = values[after][0]


def step(axis, by):
    def change(values, after):
        values[after, axis] += by

    return change


def leave(flights, count, change, seed, cases):
    """Return when the first unit was left after each fault, s; infinite: not in a second."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < cases:
        flight = flights[rng.integers(len(flights))][:count]
        low = max(t[0] for t, _ in flight) + BEFORE
        begin = rng.uniform(low, min(t[-1] for t, _ in flight) - AFTER)
        near = [t[(t > begin - BEFORE) & (t < begin + AFTER)] for t, _ in flight]
        if min(map(len, near)) < 20 or max(np.diff(t).max() for t in near) > 0.2:
            continue  # the log has a gap there
        if max(t[0] for t in near) > begin - 0.5 * BEFORE or min(t[-1] for t in near) < begin + 0.5:
            continue
        number, t_ns, values = [], [], []
        for place, (t, samples) in enumerate(flight):
            near = (t > begin - BEFORE) & (t < begin + AFTER)
            some, stamps = samples[near].copy(), t[near]
            if place == 0 and change is not None:
                change(some, stamps >= begin)
            number.append(np.full(len(stamps), place))
            t_ns.append(np.rint((stamps - begin + BEFORE + 1.0) * 1e9).astype(np.int64))
            values.append(some)
        order = np.argsort(np.concatenate(t_ns), kind="stable")
        lanes = Lanes(0)
        used_rows(
            lanes,
            np.concatenate(number)[order],
            np.concatenate(t_ns)[order],
            np.concatenate(values)[order],
            np.zeros(len(order), dtype=bool),
        )
        changes = [one.t_ns * 1e-9 - BEFORE - 1.0 for one in lanes.changes]
        found.append(changes[0] if changes else np.inf)
    return np.array(found)


def share(found):
    return np.mean((found >= 0.0) & (found <= LEAVES))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_a_frozen_unit_of_four_is_left_at_once(count):
    assert share(leave(four_units(), count, freeze, 1, 40)) == 1.0


@pytest.mark.parametrize(("axis", "by"), [(3, 1.0), (4, -1.0), (0, 0.1), (2, -0.1)])
def test_of_four_shaken_units_one_that_steps_is_left_at_once_mostly(axis, by):
    """Down the vibration is as large as a step of 1 m/s^2: nobody could tell it within 0.2 s."""
    assert share(leave(four_units(), 4, step(axis, by), 2, 40)) >= 0.75


def test_nothing_is_left_of_four_units_that_are_as_they_were():
    assert np.isinf(leave(four_units(), 4, None, 3, 60)).all()


def test_a_frozen_unit_of_an_aerobatic_copter_is_left_at_once():
    found = leave(two_units(), 2, freeze, 4, 60)
    assert np.mean(found > LEAVES) == 0.0


def test_the_aerobatic_copter_itself_is_read_by_its_first_unit_nearly_throughout():
    recording = dataflash.read(COPTER)
    changes = [note for note in recording.notes if " is used from " in note]
    assert len(changes) <= 2
