"""Several inertial units in flight: one fails, and the estimate goes on by another."""

import functools
import math

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig, OdometryConfig, OutputConfig
from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.engine.companion import Companion
from ekf_companion.nav import so3
from sim_autopilot.config import SimConfig, SpareConfig
from sim_autopilot.faults.fault import parse
from sim_autopilot.firmware import PERSONALITIES
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench

PERSONALITY = PERSONALITIES["ardupilot"]
CONFIG = Config(
    link=LinkConfig(spare_imu_rate=100.0),
    output=OutputConfig(odometry=OdometryConfig(mode="always")),
)
BEGIN = 40.013
"""Of a fault, s."""
DURATION = 50.0
LEAVES_NS = 200_000_000
FAULTS = {
    "imu-stuck": "stuck",
    "imu-gap": "silent",
    "imu-nan": "not a number",
    "imu-step": "off from the others by a step",
    "imu-step:forward=0,down=2": "off from the others by a step",
    "imu-step:forward=0,yaw=0.2": "off from the others by a step",
    "imu-noise": "off from the others by a step",
}
LONG = pytest.mark.campaign


class Watched(Companion):
    """Keeps what was estimated at each sample."""

    def __init__(self, config):
        super().__init__(config)
        self.t_ns, self.values = [], []

    def receive(self, data, now_ns, sender=None):
        """Process bytes, and keep the estimate that follows from them."""
        messages = super().receive(data, now_ns, sender)
        now = self.estimate
        if now is not None and (not self.t_ns or now.t_ns > self.t_ns[-1]):
            self.t_ns.append(now.t_ns)
            self.values.append(now.values)
        return messages


@functools.cache
def flown(fault, scenario="figure-eight", units=2, seed=0, config=CONFIG):
    """Fly with a fault of the first unit from ``BEGIN`` on; return the companion and the flight."""
    sim = PERSONALITY.suited(SimConfig(spare=SpareConfig(compasses=units, units=units)))
    flight = Flight.plan(scenario, sim, duration=DURATION, seed=seed)
    companion = Watched(config)
    faults = []
    if fault:
        kind, _, values = fault.partition(":")
        faults = [parse(f"{kind}:start={BEGIN},duration=999,{values}".rstrip(","))]
    Bench(flight, companion, personality=PERSONALITY, faults=faults).run()
    return companion, flight


def steps(companion, flight):
    """Return errors and their change from sample to sample around the fault, in sigmas.

    Shapes (n, 9), (n - 1, 9): position, velocity and attitude, by their axes.
    """
    t_ns = np.array(companion.t_ns)
    is_near = t_ns >= flight.first_ns + (BEGIN - 1.0) * 1e9
    truth = flight.truth_at(t_ns[is_near])
    found = [as_estimate(np.array(values)) for values in np.array(companion.values)[is_near]]
    home = flight.trajectory.frame
    places = np.array([list(one.lla) for one in found])
    pos = home.to_ned(*np.radians(places[:, :2]).T, places[:, 2]) - truth.pos_n
    vel = np.array([list(one.vel_n) for one in found]) - truth.vel_n
    q_nb = so3.from_euler(*np.array([list(one.euler) for one in found]).T)
    turn = so3.log(so3.multiply(q_nb, so3.conjugate(truth.q_nb)))
    sigma = np.array([[*one.std_pos, *one.std_vel, *one.std_euler] for one in found])
    errors = np.concatenate([pos, vel, turn], axis=1)
    return errors / sigma, np.diff(errors, axis=0) / sigma[1:]


def left(companion, flight):
    """Return how long after the fault the first unit was left, ns, and why."""
    (change,) = companion.session.decoder.inertial.lanes.changes
    return change.t_ns - flight.to_ns(BEGIN), change.why


@pytest.mark.parametrize("scenario", ["hover", pytest.param("figure-eight", marks=LONG)])
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("units", [2, pytest.param(1, marks=LONG)])
def test_a_unit_that_fails_in_flight_is_left_without_a_step(fault, scenario, units):
    companion, flight = flown(fault, scenario, units)
    late, why = left(companion, flight)
    assert -1_000_000 <= late <= LEAVES_NS  # stamps of spare units are whole milliseconds
    assert why == FAULTS[fault]
    errors, jumps = steps(companion, flight)
    assert np.abs(jumps).max() < 3.0
    assert np.abs(errors).max() < 5.0
    assert companion.pipeline.resets == 0


def test_units_without_a_fault_change_no_bit_of_the_estimate():
    companion, _ = flown("", units=2)
    alone, _ = flown("", units=2, config=Config(output=CONFIG.output))
    assert not companion.session.decoder.inertial.lanes.changes
    np.testing.assert_array_equal(companion.t_ns[-1], alone.t_ns[-1])
    assert companion.session.decoder.inertial.is_watching
    assert not alone.session.decoder.inertial.is_watching
    np.testing.assert_array_equal(companion.values[-1], alone.values[-1])


def test_log_and_pilot_name_the_unit_in_use_and_why_the_other_was_left(caplog):
    companion, _ = flown.__wrapped__("imu-stuck", "hover")
    assert "Inertial sensor 1 is used: 0 is stuck" in caplog.text
    units = companion.session.decoder.inertial.units()
    assert units["1"] == "used"
    assert units["2"] == "spare"
    assert units["0"].startswith("stuck at ")


def test_a_restart_goes_on_with_the_unit_that_was_in_use():
    companion, _ = flown("imu-stuck", "hover")
    inertial = companion.session.decoder.inertial
    assert inertial.unit == 1
    assert max(map(abs, inertial.lanes.offset)) > 0.0


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(8))
def test_the_estimate_is_no_worse_than_by_the_best_unit(seed):
    companion, flight = flown("imu-step", "figure-eight", 2, seed)
    errors, jumps = steps(companion, flight)
    assert np.abs(jumps).max() < 3.0
    assert math.sqrt(np.mean(errors**2)) < 2.0
