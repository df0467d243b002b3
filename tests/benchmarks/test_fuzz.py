"""A short run of the fuzz campaign (``make fuzz`` has the long one)."""

import logging

import pytest

from benchmarks.reliability.fuzz import messages, mutated, run
from ekf_companion.nav.state import Status

pytestmark = pytest.mark.campaign


@pytest.fixture(autouse=True)
def _quiet():
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize(("make", "count"), [(mutated, 50_000), (messages, 5_000)])
def test_nothing_is_raised_the_state_stays_finite_and_an_honest_flight_is_estimated(make, count):
    """Rule 32: what is not a message never raises; what is one may say anything."""
    assert run(make(count, seed=5), count, seed=5).status is Status.OK
