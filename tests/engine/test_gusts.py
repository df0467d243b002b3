"""Gusts that push a vehicle about within one interval of its receiver, which gives a mean."""

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.estimate import read_truth
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status
from tests.core.flights import flight
from tests.engine.estimation import deviations, rms, run

METRE = 1.0 / 6.367e6
"""Of latitude, rad."""
DELAY = 0.12
INTERVAL = 0.2
FREQUENCIES = np.geomspace(0.4, 3.0, 12)
"""Hz."""


class Gusts:
    """Horizontal accelerations, and what becomes of them, from a time on; of one size in m/s^2."""

    def __init__(self, size: float, begin: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._rate = 2.0 * np.pi * FREQUENCIES
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(FREQUENCIES)))
        self._size = size * np.sqrt(2.0 / len(FREQUENCIES))
        self._begin = begin

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return acceleration, velocity and position, north and east, shape (n, 2) each."""
        late = np.maximum(t - self._begin, 0.0)[:, None, None]
        phase = self._rate * late + self._phase
        first = np.sin(self._phase) / self._rate  # so that the velocity begins at zero
        accel = np.where(late > 0.0, np.cos(phase), 0.0)
        vel = np.sin(phase) / self._rate - first
        pos = (np.cos(self._phase) - np.cos(phase)) / self._rate**2 - first * late
        return tuple(self._size * each.sum(axis=-1) for each in (accel, vel, pos))


def blown(events: Events, truth, gusts: Gusts, is_mean: bool) -> Events:
    """Add gusts; a receiver gives the mean of its velocities an interval apart, or now's."""
    start = events.t_ns[0]
    t = (events.t_ns - start) * 1e-9
    values = events.values.copy()
    imu = np.flatnonzero(events.kind == Kind.IMU)
    accel = np.zeros((len(imu), 3))
    accel[:, :2] = gusts.at(t[imu])[0]
    dcm = so3.to_matrix(truth.q_nb[np.searchsorted(truth.pos_t_ns, events.t_ns[imu])])
    values[imu, 3:6] += np.einsum("nij,ni->nj", dcm, accel)
    fix = np.flatnonzero(events.kind == Kind.GNSS)
    then = t[fix] - DELAY
    _, now, pos = gusts.at(then)
    ends = 0.5 * (gusts.at(then - 0.5 * INTERVAL)[1] + gusts.at(then + 0.5 * INTERVAL)[1])
    values[fix, 3:5] += ends if is_mean else now
    values[fix, 0] += pos[:, 0] * METRE
    values[fix, 1] += pos[:, 1] * METRE / np.cos(values[fix, 0])
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@pytest.mark.parametrize("size", [2.0, 8.0, 15.0])
@pytest.mark.parametrize("is_mean", [True, False])
@pytest.mark.parametrize("name", ["figure-eight", "hover"])
def test_a_velocity_that_is_a_mean_makes_nobody_doubt_good_samples(name, is_mean, size):
    events, truth = flight(name, duration=120.0, noise=(0.3, 0.3))
    table, pipeline = run(blown(events, truth, Gusts(size, 30.0, 1), is_mean))
    late = table.stamp_ns - table.stamp_ns[0] > 40e9
    found, _ = deviations(table, truth)
    assert np.mean(table.column("status")[late] == Status.OK) > 0.95
    assert np.degrees([rms(angle) for angle in found[late][:, 3:].T]).max() < 1.0
    assert pipeline.health().resets == 0


def test_a_recorded_airplane_in_steep_turns_and_gusts_keeps_its_attitude(flight):
    """Its autopilot is 0.21, 0.36 and 0.33 deg off; who doubts the samples, up to 4.5."""
    from ekf_companion.replay.read import read

    truth = read_truth(flight("sitl-ap-plane-airspeed/truth.csv"))
    recording = read(flight("sitl-ap-plane-airspeed/flight.tlog"), Config())
    table = Pipeline(Config(), recording.family).run(recording.events)
    t = np.asarray(table.stamp_ns)
    late = (t > 39.5e9) & (t < 146e9)
    assert np.mean(table.column("status")[late] == Status.OK) > 0.99
    names = ("vel_n", "vel_e", "vel_d", "q_w", "q_x", "q_y", "q_z")
    estimate = np.stack([table.column(name)[late] for name in names], axis=1)
    place = np.searchsorted(truth.pos_t_ns, t[late])
    angles = so3.to_euler(estimate[:, 3:]) - so3.to_euler(truth.q_nb[place])
    assert np.degrees([rms(one) for one in so3.wrap(angles).T]).max() < 0.45
    assert rms(estimate[:, :3] - truth.vel_n[place]) < 0.4
