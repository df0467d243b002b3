"""What the filter finds of a receiver's delay, and how sure it is of that."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_DELAY
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.settings.from_settings import SET_STD
from ekf_companion.core.settings.settings import HABITS, FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Status
from sim_autopilot import events as wire
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight

SHAKING = 0.09
"""m/s^2/sqrt(Hz): PX4's simulator in hover, 1.4 m/s^2 a sample at 250 Hz."""
FIRST_GUESSES = ((0.0, 0.1), (0.05, 0.06), (0.1, 0.1), (0.2, 0.1))
"""Delay and one sigma of it, s: an ArduPilot's, a PX4's, and too large ones."""


def fly(path: str, seed: int, delay: float, shaking: float = SHAKING, rate: float = 8.0):
    config = SimConfig()
    config = replace(
        config,
        imu=replace(config.imu, accel_noise=shaking),
        gnss=replace(
            config.gnss, delay=delay, rate=rate, noise_h=0.05, noise_v=0.1, noise_vel=0.05
        ),
    )
    return wire.events(Flight.plan(path, config, seed=seed, duration=90.0), has_vel_down=False)


def found(events, delay: float, delay_std: float, weigh: str = "") -> tuple[float, float]:
    """Return the delay found and one sigma, s, by a first guess."""
    settings = FilterSettings(weigh_faults=weigh) if weigh else FilterSettings()
    settings = replace(settings, gnss=replace(settings.gnss, delay=delay, delay_std=delay_std))
    pipeline = Pipeline(settings)
    pipeline.run(events)
    x = as_state(pipeline.state().block)
    return delay + x.gnss_delay, float(np.sqrt(x.P[E_DELAY][E_DELAY]))


@pytest.mark.parametrize("delay", [0.0, 0.12, 0.2])
def test_the_delay_is_found_whatever_the_first_guess_and_so_is_its_sigma(delay):
    """Noise taken for acceleration, and fixes compared with a velocity that they had made, held it
    between the first guess and the truth, and the filter was sure of it to 5 ms."""
    events = fly("figure-eight", seed=round(100.0 * delay) + 1, delay=delay)
    for guess, std in FIRST_GUESSES:
        value, sigma = found(events, guess, std)
        assert abs(value - delay) < 3.0 * sigma
        assert sigma < 0.02
        assert abs(value - delay) < 0.015


@pytest.mark.parametrize("shaking", [SHAKING, 0.02])
def test_a_hover_tells_little_of_the_delay_and_the_sigma_says_so(shaking):
    events = fly("hover", seed=3, delay=0.0, shaking=shaking)
    for guess, std in FIRST_GUESSES:
        value, sigma = found(events, guess, std)
        assert abs(value) < 3.0 * sigma
        assert sigma > 0.01


def test_a_known_delay_stays():
    """By the gates' own rules; for the hypotheses, one that is known wrongly is a fault."""
    events = fly("figure-eight", seed=4, delay=0.1)
    assert found(events, 0.05, 0.0, "off") == (0.05, 0.0)
    assert found(events, 0.05, 0.0, "act")[0] == pytest.approx(0.1, abs=0.01)


def test_of_a_receiver_without_velocities_its_positions_show_the_delay():
    events = fly("figure-eight", seed=5, delay=0.12)
    fixes = np.flatnonzero(events.kind == Kind.GNSS)
    values = events.values.copy()
    values[fixes, 3:6] = np.nan
    value, sigma = found(replace(events, values=values), 0.0, 0.1)
    assert sigma < 0.05
    assert abs(value - 0.12) < 4.0 * sigma


def told_at(events, when: float, delay: float):
    """Return the events with an autopilot that says at a time, s, how late fixes are."""
    t_ns = np.array([events.t_ns.min() + round(when * 1e9)])
    return merge(events, Events.from_columns(t_ns, Kind.VEHICLE, [1.0], [0.0], [1.0], [delay]))


def learnt(events, **gnss) -> tuple[float, float]:
    """Return the delay found by a PX4's habits and one sigma, s."""
    settings = FilterSettings()
    settings = replace(settings, gnss=replace(settings.gnss, **gnss))
    pipeline = Pipeline(settings, "px4")
    pipeline.run(events)
    x = as_state(pipeline.state().block)
    first = HABITS["px4"].gnss_delay if settings.gnss.delay == "auto" else settings.gnss.delay
    return first + x.gnss_delay, float(np.sqrt(x.P[E_DELAY][E_DELAY]))


def test_what_the_autopilot_says_of_the_delay_is_the_first_guess():
    """A PX4 in its simulator says 0, and until 50 ms were unlearnt its controller flew ahead."""
    hover = fly("hover", seed=6, delay=0.0)
    hover = hover.take(hover.t_ns < hover.t_ns.min() + 15_000_000_000)
    usual, sigma = learnt(hover)
    assert abs(usual) > 0.02
    value, told_sigma = learnt(told_at(hover, 0.5, 0.0))
    assert abs(value) < 0.015
    assert told_sigma < SET_STD < sigma
    # What nobody has set is as uncertain as what is usual
    unset = HABITS["px4"].unset_gnss_delay
    value, sigma = learnt(told_at(hover, 0.5, unset))
    assert 0.5 * unset < value < unset + 0.02
    assert sigma > 1.5 * SET_STD


def test_what_the_user_says_of_it_goes_before():
    hover = fly("hover", seed=6, delay=0.0)
    other = told_at(hover, 0.5, 0.1)
    assert learnt(told_at(hover, 0.5, 0.3), delay=0.0) == learnt(other, delay=0.0)
    assert learnt(other, delay_std=0.0) == (pytest.approx(0.1), 0.0)
    surer, wider = learnt(other, delay_std=0.005), learnt(other, delay_std=0.05)
    assert surer[0] > 0.08 > wider[0]
    assert surer[1] < 0.005 < wider[1]


def test_told_late_it_counts_as_much_and_what_was_learnt_meanwhile_still_does():
    events = fly("figure-eight", seed=7, delay=0.04)
    early, early_sigma = learnt(told_at(events, 0.5, 0.1))
    late, late_sigma = learnt(told_at(events, 80.0, 0.1))
    assert abs(late - early) < 0.005
    assert late_sigma == pytest.approx(early_sigma, rel=0.1)
    assert abs(late - 0.04) < 3.0 * late_sigma


def lagging(events: Events, lag: float) -> Events:
    """Return the fixes with the velocities of some time before, s, that the positions are of."""
    fixes = np.flatnonzero(events.kind == Kind.GNSS)
    t = events.t_ns[fixes] * 1e-9
    values = events.values.copy()
    for i in (3, 4, 5):
        values[fixes, i] = np.interp(t - lag, t, events.values[fixes, i])
    return replace(events, values=values)


@pytest.mark.parametrize("lag", [0.1, 0.2])
@pytest.mark.parametrize("path", ["figure-eight", "square-spiral"])
def test_a_velocity_later_than_its_position_leads_the_position_nowhere(path, lag):
    """The position was taken for as old as the velocity, and slid away from it in each turn."""
    events = fly(path, seed=6, delay=0.05)
    late = lagging(events, lag)
    told_none = FilterSettings()
    usual = replace(told_none, gnss=replace(told_none.gnss, velocity_lag_std=0.1))
    right, now, before = (
        Pipeline(settings).run(flown)
        for settings, flown in ((usual, events), (usual, late), (told_none, late))
    )
    settled = right.stamp_ns > right.stamp_ns[0] + int(40e9)
    off, was = (
        np.sqrt(
            np.mean(
                (table.column("pos_n") - right.column("pos_n"))[settled] ** 2
                + (table.column("pos_e") - right.column("pos_e"))[settled] ** 2
            )
        )
        for table in (now, before)
    )
    assert off < 0.5 * was
    assert np.mean(now.column("status")[settled] == Status.OK) > 0.95
