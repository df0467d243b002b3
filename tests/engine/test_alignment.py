"""A compass that has led our yaw from the first on is found by the motion, by whatever angle."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Fault
from ekf_companion.core.memory.overlay import as_banks
from ekf_companion.core.memory.packing import unpack
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status
from tests.core.flights import between, flight
from tests.core.test_hypotheses import pipeline
from tests.engine.estimation import errors


def turned(events: Events, angle: float) -> Events:
    """Turn the magnetic field about down, so that the compass is off by an angle, deg."""
    values = events.values.copy()
    rows = events.kind == Kind.MAG
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    values[rows, 0] = c * events.values[rows, 0] + s * events.values[rows, 1]
    values[rows, 1] = c * events.values[rows, 1] - s * events.values[rows, 0]
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


def noisy(events: Events, sigma: float, seed: int) -> Events:
    """Add white noise to the magnetic field, gauss."""
    values = events.values.copy()
    rows = events.kind == Kind.MAG
    values[rows, :3] += np.random.default_rng(seed).normal(0.0, sigma, (rows.sum(), 3))
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


def found(one: Pipeline) -> tuple[float, float]:
    """Return how probable it is that our yaw is off since the first heading, and by what, deg."""
    block = np.array(unpack(np.array(one._timeline.bank()))[None])
    bank = as_banks(block)[0]  # a view
    for i in range(bank.n):
        h = bank.instance[i]
        if h.kind == Fault.ALIGNMENT:
            return h.p, float(np.degrees(np.arctan2(h.b[1], 1.0 + h.b[0])))
    return 0.0, 0.0


@pytest.mark.parametrize("angle", [-130.0, -60.0, 90.0, 175.0])
def test_the_first_seconds_of_motion_show_the_angle(angle):
    events, _ = flight("loiter", 8.8, rate=50.0)  # at 8.6 s it moves by 1 m/s
    one = pipeline("act")
    one.run(turned(events, angle))
    probable, off = found(one)
    assert probable > 0.95
    assert abs((off + angle + 180.0) % 360.0 - 180.0) < 15.0
    assert one.health().resets == 0


@pytest.mark.parametrize("name", ["figure-eight", "loiter", "square-spiral"])
@pytest.mark.parametrize("angle", [-60.0, 90.0, 180.0])
def test_the_yaw_is_found_however_well_a_fault_of_the_receiver_explains_it(name, angle):
    events, truth = flight(name, 45.0, rate=50.0)
    one = pipeline("act")
    table = one.run(turned(events, angle))
    late = errors(table, truth, 30.0)
    yaw, sigma = (np.degrees(late[key][:, 2]) for key in ("euler", "sd_euler"))
    assert np.median(np.abs(yaw)) < 2.0
    # what is left of the compass may be a fault of its own, for some readings
    assert np.all(np.abs(yaw) < np.maximum(4.0, 3.0 * sigma))
    assert one.health().resets == 1


@pytest.mark.parametrize("name", ["figure-eight", "loiter", "hover"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_right_compass_beside_a_receiver_that_is_led_away_resets_nothing(name, seed):
    events, _ = flight(name, 45.0, seed=seed, rate=50.0)
    values = events.values.copy()
    rows = events.kind == Kind.GNSS
    since = np.clip((events.t_ns[rows] - events.t_ns[0]) * 1e-9 - 8.0, 0.0, 15.0)
    values[rows, 0] += 0.5 * since**2 / 6.371e6
    values[rows, 3] += since
    one = pipeline("act")
    one.run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert found(one)[0] < 0.01
    assert one.health().resets == 0


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_at_rest_a_noisy_compass_is_no_field_of_the_vehicle(seed):
    events, truth = flight("static", 25.0, seed=seed, rate=50.0)
    one = pipeline("act")
    table = one.run(noisy(events, 0.02, seed))
    assert not one.found_faults()
    assert np.degrees(np.abs(errors(table, truth, 5.0)["euler"][:, 2])).max() < 4.0


def test_a_field_that_begins_is_found_all_the_same():
    events, truth = flight("hover", 60.0, rate=50.0)
    values = events.values.copy()
    values[between(events, 40.0, 99.0) & (events.kind == Kind.MAG), 1] += 0.1
    one = pipeline("act")
    table = one.run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    assert {f.kind for f in one.found_faults()} <= {Fault.FIELD, Fault.BODY_FIELD}
    assert one.found_faults()
    assert np.degrees(np.abs(errors(table, truth, 40.0)["euler"][:, 2])).max() < 4.0
    assert table.column("status")[-1] == Status.OK
