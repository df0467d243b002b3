"""Claims of docs/ACCURACY.md, held to by samples of its campaigns."""

import numpy as np
import pytest

from benchmarks import compassless, lies, outages
from benchmarks.campaign import SCENARIOS, band, fly
from benchmarks.cases import TRUTH
from benchmarks.consistency import BLOCKS, account
from tests.paths import DATA

SEEDS = 12
SURE = 0.999
INSTANTS = (60.0, 80.0, 100.0, 119.0)


def accounts(receiver: str):
    return [
        account(fly(name, 50 * i + luck, receiver, 120.0), "matched", INSTANTS)
        for i, name in enumerate(SCENARIOS)
        for luck in range(SEEDS)
    ]


@pytest.mark.parametrize("receiver", ["white", "slow"])
def test_position_and_height_are_as_wrong_as_they_say(receiver):
    found = accounts(receiver)
    for block in ("position", "baro offset"):
        mean = np.mean([one.nees[block] for one in found]) / BLOCKS[block]
        low, high = band(len(found) * BLOCKS[block], SURE)
        assert low < mean < high, block
    low, high = band(len(found), SURE)
    down = np.mean([np.square(one.ratios["position"][:, 2]) for one in found])
    assert low < down < high


@pytest.mark.parametrize("case", TRUTH, ids=lambda case: case.title)
def test_the_drift_of_an_outage_in_a_recorded_flight_is_covered(case):
    if not (DATA / case.log).is_file():
        pytest.skip("the recorded flights are not here")
    found = outages.in_recorded((DATA / case.log, 10.0))
    # the outages of one flight depend on each other: four of five is enough
    assert np.mean([one[2] for one in found]) >= 0.8
    assert np.mean([one[3] for one in found]) >= 0.8


@pytest.mark.parametrize("name", ["figure-eight", "loiter", "square-spiral"])
def test_without_a_compass_the_yaw_is_found_in_flight(name):
    flown = fly(name, 4)
    found = compassless.outcome(flown, compassless.silent(flown))
    assert found.coarse < 30.0
    assert found.position < 30.0


@pytest.mark.parametrize("name", ["figure-eight", "loiter", "square-spiral"])
def test_a_compass_that_is_the_wrong_way_round_is_found_out(name):
    flown = fly(name, 4)
    found = compassless.outcome(flown, compassless.reversed_always(flown))
    assert found.coarse < 60.0
    assert found.position < 60.0


def test_a_frozen_receiver_is_not_followed():
    frozen = next(lie for lie in lies.LIES if "frozen" in lie.title)
    found = lies.outcome(fly("loiter", 7, duration=lies.DURATION), frozen)
    assert found.largest < 30.0
    assert found.recovered < 10.0
