"""A vehicle that really moves, and its sensors."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame, gravity
from sim_autopilot.config import SimConfig
from sim_autopilot.vehicle import Cold, Senses, Vehicle

DT = 0.008


def vehicle(**options):
    return Vehicle(LocalFrame(np.radians(47.4), np.radians(8.5), 488.0), **options)


def hover(own, seconds, accel_n=(0.0, 0.0, 0.0), wrong=(0.0, 0.0, 0.0)):
    """Fly with an acceleration asked for, by an attitude that is off by some Euler angles."""
    for _ in range(round(seconds / DT)):
        estimated = so3.multiply(so3.exp(np.array(wrong)), own.q_nb)
        own.step(DT, np.array(accel_n), 0.0, estimated)
    return own


def test_it_stands_on_the_ground_until_it_is_lifted():
    own = hover(vehicle(), 1.0, (0.0, 0.0, 20.0))
    assert own.is_landed
    assert own.force_b == pytest.approx([0, 0, -gravity(own.frame.lat, 488.0)], abs=1e-6)
    assert not hover(own, 1.0, (0.0, 0.0, -2.0)).is_landed
    assert own.pos_n[2] == pytest.approx(-1.0, abs=0.1)
    hover(own, 5.0, (0.0, 0.0, 1.0))
    assert own.is_landed
    assert own.vel_n == pytest.approx([0, 0, 0])


def test_its_samples_integrate_back_to_its_motion():
    own = hover(vehicle(), 2.0, (0.0, 0.0, -2.0))
    pos_n, vel_n, q_nb = own.pos_n, own.vel_n, own.q_nb
    weight = np.array([0.0, 0.0, float(gravity(own.frame.lat, 490.0))])
    for k in range(500):
        own.step(DT, np.array([2.0 * np.sin(k * DT), 1.0, 0.1]), 0.3, own.q_nb)
        turn = own.rate_b * DT
        middle = so3.multiply(q_nb, so3.exp(0.5 * turn))
        q_nb = so3.multiply(q_nb, so3.exp(turn))
        gain = (so3.rotate(middle, own.force_b) + weight) * DT
        pos_n, vel_n = pos_n + (vel_n + 0.5 * gain) * DT, vel_n + gain
    # Without the turning of the Earth, which is in the samples
    assert vel_n == pytest.approx(own.vel_n, abs=0.02)
    assert pos_n == pytest.approx(own.pos_n, abs=0.03)
    assert so3.log(so3.multiply(so3.conjugate(q_nb), own.q_nb)) == pytest.approx(
        [0, 0, 0], abs=1e-3
    )


def test_what_the_estimate_is_tilted_by_it_flies_away_by():
    own = hover(vehicle(), 2.0, (0.0, 0.0, -2.0))
    hover(own, 2.0, wrong=(0.0, np.radians(2.0), 0.0))
    # The nose seems 2 degrees up and is lowered: forward
    assert own.vel_n[0] == pytest.approx(9.8 * np.radians(2.0) * 2.0, rel=0.2)


def test_the_wind_carries_it_away():
    own = hover(vehicle(wind_n=(0.0, 5.0, 0.0)), 2.0, (0.0, 0.0, -2.0))
    assert own.vel_n[1] > 0.5


@pytest.mark.parametrize(("fade", "middle"), [(0.0, -4.0), (10.0, -2.0)])
def test_a_cold_receiver_is_off_and_then_right(fade, middle):
    cold = Cold(until=15.0, fade=fade)
    assert cold.at(0.0)[2] == -4.0
    assert cold.at(10.0)[2] == pytest.approx(middle)
    assert not cold.at(15.0).any()


def test_a_fix_is_of_where_it_was():
    config = replace(SimConfig(), gnss=replace(SimConfig().gnss, noise_h=0.0, noise_v=0.0))
    own = vehicle()
    senses = Senses(own, config, 1, None)
    for k in range(250):
        own.step(DT, np.array([0.0, 0.0, -2.0]), 0.0, own.q_nb)
        senses.remember(k * DT)
        if k == 234:
            was_n = own.pos_n
    fix = senses.fix(249 * DT, 0)
    assert own.frame.to_ned(fix.lat, fix.lon, fix.alt) == pytest.approx(was_n, abs=1e-3)
