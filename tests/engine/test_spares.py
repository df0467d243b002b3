"""A second receiver and other compasses, where the first lies or falls silent."""

import dataclasses
import functools
import math

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.core.memory.enums import Aid, Azimuth
from ekf_companion.engine.companion import Companion
from ekf_companion.nav.state import Status
from ekf_companion.status.aids import sources_of
from sim_autopilot.config import SimConfig, SpareConfig
from sim_autopilot.episodes import error_series
from sim_autopilot.faults.fault import parse
from sim_autopilot.firmware import PERSONALITIES
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench
from sim_autopilot.score import Witness

PERSONALITY = PERSONALITIES["ardupilot"]
STREAMING = Config(output=OutputConfig(odometry=OdometryConfig(mode="always")))
"""Where nobody answers what the guard asks."""
BEGIN = 30.0
"""Of a fault, s."""
LONG = pytest.mark.campaign
SCENARIOS = ["hover", pytest.param("figure-eight", marks=LONG)]
GOOD = SimConfig().gnss
GOOD = dataclasses.replace(GOOD, noise_h=0.2, noise_v=0.3, slow_h=0.2, slow_v=0.2)


@functools.cache
def flown(fault: str, scenario: str = "hover", compasses: int = 0, receivers: int = 0):
    """Fly with a fault from ``BEGIN`` on; return the companion, the witness and its errors."""
    spare = SpareConfig(compasses=compasses, receivers=receivers)
    config = PERSONALITY.suited(SimConfig(spare=spare, gnss=GOOD))
    flight = Flight.plan(scenario, config, duration=60.0)
    companion = Companion(STREAMING)
    faults = [parse(fault)] if fault else []
    bench = Bench(flight, companion, personality=PERSONALITY, faults=faults)
    witness: Witness = bench.run()
    errors = error_series(witness, flight)
    return companion, errors.t, errors.size[errors.t > BEGIN - 5.0]


def is_good(companion, t, late) -> bool:
    """Return whether ODOMETRY was sent throughout, within 1 m and 5 degrees, and nothing jumped."""
    return (
        np.diff(t).max() < 0.2
        and late[:, 0].max() < 1.0
        and late[:, 2].max() < math.radians(5.0)
        and companion.pipeline.resets == 0
        and companion.pipeline.health().status == Status.OK
    )


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("compasses", [pytest.param(1, marks=LONG), 2])
@pytest.mark.parametrize("forward", [0.35, pytest.param(-0.35, marks=LONG)])
def test_a_compass_that_is_off_at_once_is_left_for_another(scenario, compasses, forward):
    fault = f"mag-disturbance:start={BEGIN},duration=999,forward={forward}"
    companion, t, late = flown(fault, scenario, compasses)
    assert is_good(companion, t, late)
    assert companion.pipeline.health().compass == 1
    assert companion.session.refused["mag: compass changed"] == 1


def test_a_field_that_is_added_to_all_compasses_makes_none_of_them_better():
    fault = f"mag-disturbance:start={BEGIN},duration=999,forward=0.35,compass=all"
    companion, _, late = flown(fault, "figure-eight", 2)
    assert companion.pipeline.health().compass == 0
    assert late[:, 2].max() < math.radians(5.0)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize(
    "fault",
    [
        "gnss-jump:east=60",
        pytest.param("gnss-jump:north=-25,down=10", marks=LONG),
        "gnss-outage:how=silent",
        pytest.param("gnss-outage:how=nofix", marks=LONG),
        "gnss-frozen:time=same",
    ],
)
def test_a_receiver_that_lies_or_falls_silent_is_left_for_the_second(scenario, fault):
    kind, values = fault.split(":")
    timed = f"{kind}:start={BEGIN},duration=999,{values}"
    companion, t, late = flown(timed, scenario, receivers=1)
    assert is_good(companion, t, late)
    assert companion.pipeline.health().receiver == 1


def test_log_and_status_name_the_receiver_that_is_used(caplog):
    fault = f"gnss-outage:start={BEGIN},duration=999,how=nofix"
    companion, _, _ = flown.__wrapped__(fault, receivers=1)
    assert "The receiver in use is number 2, was 1" in caplog.text
    ranks = companion.session.decoder.ranks
    azimuth, receiver = int(Azimuth.ANTENNA), companion.pipeline.health().receiver
    found = sources_of(azimuth, is_autopilots=False, ranks=ranks, receiver=receiver)
    assert found[Aid.POSITION] == found[Aid.HEIGHT] == found[Aid.VELOCITY] == "GPS2_RAW"
    assert found[Aid.HEADING] == "GPS2_RAW, two antennas"
    found = sources_of(azimuth, is_autopilots=False, ranks=ranks, receiver=0)
    assert found[Aid.HEADING] == "GPS_RAW_INT, two antennas"
    assert found[Aid.POSITION] == "GPS_RAW_INT"


def test_two_receivers_and_three_compasses_without_a_fault_leave_the_firsts_in_use():
    companion, t, late = flown("", "figure-eight", 2, 1)
    assert is_good(companion, t, late)
    health = companion.pipeline.health()
    assert (health.receiver, health.compass) == (0, 0)
