"""NEES of errors that were drawn from a covariance that is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ekf_companion.analysis.consistency import nees
from ekf_companion.filters.solution import Recorder, Solution
from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import Trajectory

FRAME = LocalFrame(0.8, 0.15, 400.0)
SECOND = 1_000_000_000
COUNT = 2000
FLIGHT = Trajectory(
    name="a turn",
    pos_t_ns=(ts := np.arange(0, COUNT * SECOND // 2 + SECOND, SECOND // 10)),
    lat=(geodetic := FRAME.to_geodetic(np.outer(ts * 1e-9, [5.0, -3.0, -0.1])))[0],
    lon=geodetic[1],
    alt=geodetic[2],
    vel_t_ns=ts,
    vel_n=np.tile([5.0, -3.0, -0.1], (len(ts), 1)),
    att_t_ns=ts,
    q_nb=so3.multiply(
        so3.exp(np.outer(ts * 1e-9, [0.0, 0.0, 0.3])), so3.from_euler(0.2, -0.4, 1.0)
    ),
)
"""Straight on while the body turns; ten rows a second."""


def drawn(told: float = 1.0, seed: int = 1) -> Solution:
    """Return estimates off the truth by errors of a covariance, of which a share is told."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(9, 9)) * np.repeat([0.01, 0.1, 1.0], 3)[:, None]
    # Attitude errors are in n already: a filter's rotation into n is not what is tried here
    P = root @ root.T
    recorder = Recorder("drawn", FRAME)
    for t_ns in np.arange(COUNT) * (SECOND // 2) + 30_000_000:  # between the truth's rows
        t, e = t_ns * 1e-9, root @ rng.normal(size=9)
        true = so3.multiply(so3.exp(np.array([0.0, 0.0, 0.3 * t])), so3.from_euler(0.2, -0.4, 1.0))
        state = Nominal(
            q_nb=so3.multiply(so3.exp(-e[:3]), true),
            vel_n=np.array([5.0, -3.0, -0.1]) - e[3:6],
            pos_n=t * np.array([5.0, -3.0, -0.1]) - e[6:],
        )
        recorder.add(int(t_ns), state, told * P)
    return recorder.solution()


@pytest.fixture(scope="module")
def honest() -> Solution:
    return drawn()


def test_errors_of_the_covariance_that_is_told_give_one(honest):
    found = nees(honest, FLIGHT, 0, COUNT * SECOND)
    low, high = chi2.ppf([0.005, 0.995], 3 * COUNT) / (3 * COUNT)
    assert found.count == COUNT
    for value in (found.position, found.velocity, found.attitude):
        assert low < value < high


def test_errors_of_twice_the_sigma_that_is_told_give_four():
    found = nees(drawn(told=0.25), FLIGHT, 0, COUNT * SECOND)
    for value in (found.position, found.velocity, found.attitude):
        assert value == pytest.approx(4.0, rel=0.1)


def test_only_what_lies_between_the_two_stamps_counts(honest):
    assert nees(honest, FLIGHT, 10 * SECOND, 20 * SECOND).count == 20
    nothing = nees(honest, FLIGHT, 5000 * SECOND, 6000 * SECOND)
    assert np.isnan([nothing.position, nothing.velocity, nothing.attitude]).all()
    assert nothing.count == 0


def test_nothing_is_interpolated_over_a_gap(honest):
    keep = (ts < 100 * SECOND) | (ts > 900 * SECOND)
    torn = replace(FLIGHT, vel_t_ns=ts[keep], vel_n=FLIGHT.vel_n[keep], att_t_ns=ts[:0])
    torn = replace(torn, q_nb=FLIGHT.q_nb[:0], pos_t_ns=ts[:0], lat=ts[:0], lon=ts[:0], alt=ts[:0])
    found = nees(honest, torn, 0, COUNT * SECOND)
    assert found.count == pytest.approx(400, abs=2)
    assert np.isnan([found.attitude, found.position]).all()


def test_a_truth_without_heights_measures_the_rest(honest):
    flat = FLIGHT.vel_n.copy()
    flat[:, 2] = np.nan
    found = nees(
        honest, replace(FLIGHT, alt=np.full(len(ts), np.nan), vel_n=flat), 0, COUNT * SECOND
    )
    low, high = chi2.ppf([0.005, 0.995], 2 * COUNT) / (2 * COUNT)
    assert low < found.velocity < high
    assert low < found.position < high
