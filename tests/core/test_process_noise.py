"""The scale of Q: what is configured, and what of it counts where it is learnt."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_BARO, E_HEADING, SLOW_ERRORS, Aid, Azimuth
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Motion
from tests.core.interpreted import load
from tests.core.states import a_state, array, let_walk, some_parameters

E_AIRSPEED = SLOW_ERRORS["airspeed"]


def scaled(learns: bool, dt: float = 0.01):
    """Return a state, its parameters and the noise of a pending motion."""
    x, k, m = a_state(2), some_parameters(), Motion()
    k.gyro_noise, k.accel_noise, k.learn_noise = 2e-3, 3e-2, float(learns)
    k.gyro_bias_walk, k.accel_bias_walk = 1e-4, 1e-3
    let_walk(k, Aid.BARO, 0.05)
    k.aid[Aid.BARO].speed_walk[0] = 0.01
    load().doubt.restart(x)
    load().walk.restart(x)
    x.pending.dt = dt
    load().process_noise.scale_noise(x, k, m)
    return x, k, m


def test_without_learning_only_what_is_configured_counts():
    x, _, m = scaled(learns=False)
    np.testing.assert_allclose(m.q, np.repeat([2e-3**2, 3e-2**2], 3) * 0.01)
    assert (m.gyro_walk, m.accel_walk) == pytest.approx((1e-4**2 * 0.01, 1e-3**2 * 0.01))
    assert m.new_bias == 0.0
    speed2 = np.dot(x.vel_n, x.vel_n)
    assert m.slow_walk[E_BARO] == pytest.approx((0.05**2 + 0.01**2 * speed2) * 0.01)


def test_a_wind_walks_by_time_and_by_height_climbed_or_lost():
    x, k, m = scaled(learns=False)
    let_walk(k, Aid.AIRSPEED, 0.05)
    k.aid[Aid.AIRSPEED].climb_walk[0] = 0.2
    x.vel_n[2], x.pending.dt = -3.0, 0.01
    load().process_noise.scale_noise(x, k, m)
    assert m.slow_walk[E_AIRSPEED] == pytest.approx((0.05**2 + 0.6**2) * 0.01)
    assert m.slow_walk[E_AIRSPEED + 1] == 0.0


def test_what_is_doubted_adds_to_what_was_learnt():
    x, k, m = scaled(learns=True)
    x.noise[:] = [1e-6] * 3 + [1e-4] * 3
    found = []
    for doubt in (0.0, 1.0):
        x.doubt, x.pending.dt = doubt, 0.01
        load().process_noise.scale_noise(x, k, m)
        found.append(np.array(m.q))
    trusted, doubted = found
    assert (trusted[:3] >= 1.5e-8).all()
    assert (trusted[3:] >= 1.5e-6).all()
    # the rest of the difference is that of scale and mounting
    assert (doubted - trusted >= np.repeat([2e-3**2, 3e-2**2], 3) * 0.01).all()


def test_slow_errors_are_carried_on_every_20_ms_and_by_all_the_time_since():
    x, k, m = scaled(learns=False)
    times = []
    for dt in (0.004, 0.004, 0.004, 0.03, 0.004):
        x.pending.dt = dt
        load().process_noise.scale_noise(x, k, m)
        times.append(m.slow_dt)
        assert (m.heading_faded > 0.0) == (m.slow_dt > 0.0)
    np.testing.assert_allclose(times, [0.0, 0.0, 0.022, 0.03, 0.0], atol=1e-12)


def test_a_compass_that_is_shown_to_be_right_counts_as_better_within_limits():
    x, k, level = a_state(3), Parameters(), load().process_noise.heading_level
    x.heading_std, x.azimuth, k.learn_noise = 0.02, Azimuth.FIELD, 1.0
    row = array(x.P)[E_HEADING]
    found = {}
    for case, offset, std in (
        ("unknown", 0.0, 0.02),
        ("part", 0.0, 0.016),
        ("right", 0.001, 0.005),
        ("wrong", 0.03, 0.005),
    ):
        x.heading_offset, row[E_HEADING] = offset, std**2
        found[case] = np.sqrt(level(x, k))
    # while nothing shows the error, nothing changes
    assert found["unknown"] == found["wrong"] == pytest.approx(0.02)
    assert found["part"] == pytest.approx(0.016)
    assert found["right"] == pytest.approx(0.02 * np.sqrt(0.25))

    # another estimate's error wanders with time, whatever GNSS has found
    x.azimuth, x.heading_offset, row[E_HEADING] = Azimuth.OTHER, 0.0, 0.005**2
    assert level(x, k) == pytest.approx(0.02**2)
    # with learn_noise off only what is configured counts
    x.azimuth, k.learn_noise = Azimuth.FIELD, 0.0
    assert level(x, k) == pytest.approx(0.02**2)
