"""What is kept over a reboot of the autopilot."""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.slow_error import set_variance
from cython.cimports.ekf_companion.core.memory.constants import NEVER
from cython.cimports.ekf_companion.core.memory.enums import E_BA, E_BG, E_DELAY, E_IRON
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.state import State

REBOOT_TIME = cython.declare(cython.double, 100.0)
"""So long a bias is taken to have walked over a reboot, s: ten times what one lasts."""


def carry_over(x: State, y: State, k: Parameters) -> None:
    """Carry over to an empty state x what y knows that outlives a reboot of the autopilot.

    The receiver does not reboot, nor does the vehicle's own field change: its delay, how white its
    errors are, and hard iron are as they were. The biases are where they are the sensors' own
    (``k.keeps_bias``), give or take what they have walked meanwhile; but a gyro is calibrated by an
    autopilot that starts on the ground. Of an autopilot that takes its own estimate of the biases
    off, the accelerometer's is a guess, no surer than at any start.
    """
    is_flown = cython.declare(cython.bint, y.armed == 1.0 and y.landed != 1.0)
    x.gnss_delay = y.first_delay + within(y.gnss_delay - y.first_delay, k.delay_std)
    x.first_delay = y.first_delay
    x.first_delay_var = y.first_delay_var
    set_variance(x, E_DELAY, y.P[E_DELAY][E_DELAY])
    x.gain.var = y.gain.var
    x.gain.n = y.gain.n
    x.gain.shown = y.gain.shown
    x.lag = y.lag
    x.lag.last_t = NEVER
    walked = k.accel_bias_walk * k.accel_bias_walk * REBOOT_TIME
    turned = k.gyro_bias_walk * k.gyro_bias_walk * REBOOT_TIME
    for i in range(3):
        x.white_share[i] = y.white_share[i]
        x.nis_sum[i] = y.nis_sum[i]
        x.nis_n[i] = y.nis_n[i]
        x.hard_iron[i] = within(y.hard_iron[i], k.iron_std)
        set_variance(x, E_IRON + i, y.P[E_IRON + i][E_IRON + i])
        x.accel_bias[i] = within(y.accel_bias[i], k.accel_bias_std)
        if k.keeps_bias == 0.0:
            continue
        set_variance(x, E_BA + i, y.P[E_BA + i][E_BA + i] + walked)
        if is_flown:
            x.gyro_bias[i] = within(y.gyro_bias[i], k.gyro_bias_std)
            set_variance(x, E_BG + i, y.P[E_BG + i][E_BG + i] + turned)


def within(value: float, sigma: float) -> float:
    """Return what was learnt, within two sigmas of what is expected where nothing is known."""
    largest = 2.0 * sigma
    value = value if value < largest else largest
    return value if value > -largest else -largest
