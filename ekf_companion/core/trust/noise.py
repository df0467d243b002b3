"""White noise of the inertial samples, learnt from the samples themselves."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.memory.scratch import ImuRow
from cython.cimports.ekf_companion.core.memory.state import State

BLOCK_TIME = cython.declare(cython.double, 0.0095)
"""Least length of a block of samples, s: 10 ms, give or take their jitter."""
LOST = cython.declare(cython.double, 1.8)
"""Usual intervals without a sample after which a block begins anew: one that is missing leaves two.
An autopilot that thins its samples, 300 of them to 250, leaves out every sixth: 1.7 of the mean."""
MEMORY = cython.declare(cython.double, 2.0)
"""Time constant of the noise learnt, s."""


def learn_noise(x: State, imu: ImuRow, span: float) -> None:
    """Learn the white noise of each axis from second differences, which smooth motion leaves small.

    Of means over a block of samples: a rotor's jitter that a gyro samples now and then is not white
    from sample to sample, and what counts is how it adds up. White noise of variance s^2 gives
    second differences of variance 6 s^2; the state keeps s^2 dt.
    """
    block = address(x.noise_block)
    if x.dt == 0.0:
        x.dt = span
    x.dt += 0.05 * ((span if span < 2.0 * x.dt else 2.0 * x.dt) - x.dt)
    if x.samples < 2.0 or span > LOST * x.dt or span > 0.5 * MEMORY:
        for i in range(6):
            block.sum[i] = 0.0
        block.n = 0.0
        block.dt = 0.0
        block.blocks = 0.0
        return
    for i in range(3):
        block.sum[i] += imu.gyro[i]
        block.sum[3 + i] += imu.accel[i]
    block.n += 1.0
    block.dt += span
    if block.dt < BLOCK_TIME:
        return
    gain = block.dt / MEMORY
    for i in range(6):
        mean = block.sum[i] / block.n
        if block.blocks >= 2.0:
            d = mean - 2.0 * block.last[i] + block.before[i]
            x.noise[i] += gain * (d * d / 6.0 * block.dt - x.noise[i])
        block.before[i] = block.last[i]
        block.last[i] = mean
        block.sum[i] = 0.0
    block.blocks += 1.0
    block.n = 0.0
    block.dt = 0.0
