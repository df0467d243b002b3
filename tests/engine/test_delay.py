"""What the filter finds of a receiver's delay."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from sim_autopilot import events as wire
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight

SHAKING = 0.09
"""m/s^2/sqrt(Hz): PX4's simulator in hover, 1.4 m/s^2 a sample at 250 Hz."""


@pytest.mark.parametrize("seed", [1, 2])
def test_a_receiver_without_delay_is_found_under_noise_as_large_as_the_motion(seed):
    """One sample's noise taken for acceleration held the delay at two thirds of its prior."""
    config = SimConfig()
    config = replace(
        config,
        imu=replace(config.imu, accel_noise=SHAKING),
        gnss=replace(config.gnss, delay=0.0, rate=8.0, noise_h=0.05, noise_v=0.1, noise_vel=0.05),
    )
    flown = Flight.plan("figure-eight", config, seed=seed, duration=90.0)
    settings = FilterSettings()
    settings = replace(settings, gnss=replace(settings.gnss, delay=0.05, delay_std=0.06))
    pipeline = Pipeline(settings)
    pipeline.run(wire.events(flown, has_vel_down=False))
    assert pipeline.health().gnss_delay == pytest.approx(-0.05, abs=0.010)
    assert np.isfinite(pipeline.values()[:3]).all()
