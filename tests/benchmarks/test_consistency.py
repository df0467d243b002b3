"""Samples of the campaign of docs/accuracy/consistency.md.

Bands are chi-square bands of 99.9 % for so few flights, so that a filter that is right passes
whatever its seeds; the instants of one flight depend on each other and count as one.
"""

from functools import cache

import numpy as np
import pytest

from benchmarks.accuracy.consistency import BLOCKS, Account, account
from benchmarks.campaign import SCENARIOS, band, fly
from ekf_companion.engine.health import Aid

pytestmark = pytest.mark.campaign

SURE = 0.999
INSTANTS = (60.0, 80.0, 100.0, 119.0)
SEEDS = {"matched": 8, "default": 6}


@cache
def accounts(kind: str, receiver: str) -> list[Account]:
    return [
        account(fly(name, 50 * i + luck, receiver, 120.0), kind, INSTANTS)
        for i, name in enumerate(SCENARIOS)
        for luck in range(SEEDS[kind])
    ]


def mean_nees(kind: str, receiver: str, block: str) -> float:
    squares = np.array([one.nees[block] for one in accounts(kind, receiver)])
    return float(squares.mean() / BLOCKS[block])


@pytest.mark.parametrize("receiver", ["white", "slow"])
@pytest.mark.parametrize(
    "block",
    [
        "position",
        "velocity",
        "attitude",
        "gyro bias",
        "accel bias",
        "baro offset",
        "GNSS delay",
        "heading offset",
    ],
)
def test_a_filter_that_knows_its_sensors_is_as_wrong_as_it_says(block, receiver):
    low, high = band(len(accounts("matched", receiver)) * BLOCKS[block], SURE)
    assert low < mean_nees("matched", receiver, block) < high


@pytest.mark.parametrize("receiver", ["white", "slow"])
def test_height_is_as_wrong_as_it_says(receiver):
    found = accounts("matched", receiver)
    low, high = band(len(found), SURE)
    assert low < np.mean([np.square(one.ratios["position"][:, 2]) for one in found]) < high


@pytest.mark.parametrize("block", ["velocity", "attitude", "gyro bias", "accel bias"])
def test_with_default_settings_nothing_is_surer_than_it_may_be(block):
    _, high = band(len(accounts("default", "slow")) * BLOCKS[block], SURE)
    assert mean_nees("default", "slow", block) < high


def test_good_measurements_are_not_refused():
    found = accounts("matched", "white")
    assert sum(one.resets for one in found) == 0
    for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY, Aid.HEADING, Aid.BARO):
        counts = [one.verdicts[aid] for one in found]
        assert sum(one["fused"] for one in counts) > 1000
        assert sum(one["gated"] for one in counts) == 0
