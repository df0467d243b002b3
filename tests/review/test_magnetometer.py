"""A magnetometer that is declared in another unit, or along other axes."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings, HeadingSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Kind
from ekf_companion.review.magnetometer import MagnetometerCheck
from sim_autopilot.config import GnssConfig, SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight

TRUE = np.eye(3)
IRON = np.array([0.1, -0.08, 0.05])


@pytest.fixture(scope="module")
def flown():
    """Return the events of a flight that finds north by a receiver with two antennas."""
    return events(
        Flight.plan("figure-eight", SimConfig(gnss=GnssConfig(yaw=True)), duration=40.0, seed=2)
    )


def notes(flown, matrix, hard=(0.0, 0.0, 0.0)):
    values, is_mag = flown.values.copy(), flown.kind == Kind.MAG
    values[is_mag, :3] = values[is_mag, :3] @ np.asarray(matrix).T + hard
    declared = replace(flown, values=values)
    check = MagnetometerCheck(HeadingSettings().year)
    pipeline = Pipeline(FilterSettings())
    for rows in np.array_split(np.arange(len(declared)), 3):
        block = declared.take(rows)
        check.add(block, pipeline.run(block))
    return check.notes()


def test_one_that_is_declared_right_gets_no_note_nor_does_a_vehicles_iron(flown):
    assert notes(flown, TRUE) == []
    assert notes(flown, TRUE * 1.3, hard=IRON) == []


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(1e2, "microtesla"), (1e3, "milligauss"), (1e5, "nanotesla"), (1e-4, "tesla"), (7.0, "check")],
)
def test_another_unit_is_named(flown, factor, unit):
    (note,) = notes(flown, TRUE * factor)
    assert "gauss as it is declared, where the Earth's field has 0.4" in note
    assert unit in note


@pytest.mark.parametrize(
    ("matrix", "axes"),
    [
        ([[0, 1, 0], [1, 0, 0], [0, 0, -1]], "(y, x, -z)"),  # east, north, up
        ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], "(x, -y, -z)"),  # forward, left, up
        ([[0, 0, 1], [1, 0, 0], [0, 1, 0]], "(y, z, x)"),
    ],
)
def test_other_axes_are_named(flown, matrix, axes):
    """What is declared as (x, y, z) is the matrix times the truth; named is the way back."""
    (note,) = notes(flown, matrix)
    assert f"fits the Earth's field as {axes} of what is declared as (x, y, z)" in note
