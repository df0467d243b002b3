"""What ``fleet tune`` does with one flight: its likelihood, a search by itself, and its gain.

Each is a task of its own, which a process or a worker of Dask runs: it reads the flight anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ekf_companion.calibrate.likelihood import cuts_at, likelihood
from ekf_companion.config.config import Config
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import CompanionError
from ekf_companion.fleet.source import Source
from ekf_companion.fleet.tune_antenna import Antenna
from ekf_companion.fleet.tune_parameter import (
    ARM,
    BEGIN,
    DELAY,
    GYRO_NOISE,
    HIGH,
    LOW,
    SCALE,
    STEPS,
    VELOCITY_STD,
    N,
    known,
    tuned,
)
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.measurements import GNSS_STD, GNSS_VELOCITY, Kind
from ekf_companion.nav.state import Status, Table
from ekf_companion.replay.read import read

UNSTATED = 1e-3
"""What a receiver states of its velocity while that is tuned, m/s: in every flight its white share
is learnt anew, and at most three times this is made of it."""
SETTLING = 10.0
"""Time after the first position that is not counted, s: the filter is settling."""
SHORTEST = 20.0
"""Least time that is counted, s."""
SEARCHES = 2
"""Times that the search goes over all parameters: the first finds the delay and the noise of the
receiver, the second the rest."""
CLOSE = 0.02
"""Resolution of the search, logarithm of a noise; of the others, of ``SCALE``."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The log-likelihood of a flight about some parameters."""

    value: float
    slope: Array
    """Shape (n,)."""
    curvature: Array
    """Second derivatives, shape (n, n)."""
    delay: float
    """The delay that is configured, or that the log declares, s."""


def _opened(source: Source, config: Config) -> tuple[Recording, Table, list[int]] | str:
    """Return a flight, its estimates, and where what counts of it begins and ends.

    Else why it cannot be used.
    """
    try:
        with source.opened() as path:
            recording = read(path, config)
    except CompanionError as error:
        return str(error).split(f"{source.name}: ")[-1]
    if not (recording.events.kind == Kind.GNSS).any():
        return "holds no GNSS fix"
    table = Pipeline(config, recording.family, recording.gnss_delay).run(recording.events)
    located = np.flatnonzero(table.column("status") >= Status.OK)
    if not len(located):
        return "no position could be estimated"
    begin, end = (float(table.stamp_ns[i]) * 1e-9 for i in (located[0], -1))
    if end - begin < SETTLING + SHORTEST:
        return f"only {end - begin:.0f} s with a position, of {SETTLING + SHORTEST:.0f} at least"
    return recording, table, cuts_at(recording, np.array([begin + SETTLING, end]))


class Likelihood:
    """The log-likelihood of a flight by parameters."""

    def __init__(
        self, recording: Recording, table: Table, cuts: Sequence[int], config: Config
    ) -> None:
        """Take a flight between two cuts, and its estimates."""
        values = recording.events.values.copy()
        velocity_std = range(*GNSS_STD.indices(values.shape[1]))[2]
        values[recording.events.kind == Kind.GNSS, velocity_std] = UNSTATED
        self._recording = replace(recording, events=replace(recording.events, values=values))
        self._antenna = Antenna(self._recording, table, config)
        self._cuts, self._config, self._rows = cuts, config, 0

    def __call__(self, theta: Array, off: Array | float = 0.0) -> float:
        """Return it; rows that were not judged count as the mean of the rest.

        These are few: where a filter had to restart. The first call settles how many there are.

        Args:
            theta: The parameters.
            off: What is added to the velocities of the fixes, m/s, shape (fixes, 3).
        """
        values = self._antenna.brought(theta[ARM], float(theta[DELAY]))
        values[self._antenna.fixes, GNSS_VELOCITY] += off
        events = replace(self._recording.events, values=values)
        brought = replace(self._recording, events=events)
        config = known(self._config, theta)
        config = replace(config, gnss=replace(config.gnss, lever_arm=(0.0, 0.0, 0.0)))
        sums, rows = likelihood(brought, config, self._cuts)
        self._rows = self._rows or rows
        return float(sums.sum()) * self._rows / rows if rows else -math.inf

    def noise_curvature(self, theta: Array, value: float) -> float:
        """Return by how much the noise of the rate curves the likelihood along the lever arm.

        Noise n of the rate adds C_nb (n x arm) to what is left of a velocity, and lowers the
        likelihood by half of its variance 2 |arm|^2 var(n) / 3 an axis, times the trace of the
        inverse of the velocities' covariance: as if a shorter arm were likelier. The trace is that
        of a quadratic form, and shown by random signs.

        Source: Nakamura 1990, Biometrika 77, 1 (corrected scores); Hutchinson 1989, Communications
        in Statistics 18, 3 (trace by random signs).
        """
        signs = np.random.default_rng(1).choice([-1.0, 1.0], (len(self._antenna.fixes), 3))
        std = 0.5 * math.exp(theta[VELOCITY_STD])  # far from the gate
        bend = self(theta, std * signs) + self(theta, -std * signs) - 2.0 * value
        var = math.exp(2.0 * theta[GYRO_NOISE]) * self._antenna.bandwidth
        return 2.0 / 3.0 * var * max(-bend, 0.0) / std**2


def search(source: Source, config: Config) -> Array | str:
    """Return the likeliest parameters of one flight alone; else why there are none."""
    from scipy.optimize import minimize

    if isinstance(found := _opened(source, config), str):
        return found
    of = Likelihood(*found, config)
    done: Any = minimize(
        lambda x: -of(x * SCALE),
        BEGIN / SCALE,
        method="Powell",
        bounds=np.stack([LOW, HIGH], axis=1) / SCALE[:, None],
        options={"xtol": CLOSE, "ftol": 1e-9, "maxiter": SEARCHES},
    )
    likeliest: Array = done.x * SCALE
    return likeliest


def look(source: Source, theta: Array, config: Config) -> Look | str:
    """Return the likelihood of a flight about some parameters; else why there is none."""
    if isinstance(found := _opened(source, config), str):
        return found
    of = Likelihood(*found, config)
    value, slope, curvature = differences(of, theta)
    excess = of.noise_curvature(theta, value)
    value += 0.5 * excess * float(theta[ARM] @ theta[ARM])
    slope[ARM] += excess * theta[ARM]
    curvature[ARM, ARM] += excess * np.eye(3)
    if not np.isfinite([value, *slope, *curvature.flat]).all():
        return "its fixes cannot be judged with these parameters"
    recording = found[0]
    late = delays_ns(config, recording.family, recording.gnss_delay)[Kind.GNSS]
    return Look(value, slope, curvature, float(late) * 1e-9)


def differences(of: Callable[[Array], float], theta: Array) -> tuple[float, Array, Array]:
    """Return a function's value, slope, shape (n,), and second derivatives, shape (n, n)."""
    value, slope, curvature = of(theta), np.zeros(N), np.zeros((N, N))
    h, side = np.diag(STEPS), np.zeros(N)
    for i in range(N):
        up, down = of(theta + h[i]), of(theta - h[i])
        slope[i] = (up - down) / (2.0 * STEPS[i])
        side[i] = up + down - 2.0 * value
        curvature[i, i] = side[i] / STEPS[i] ** 2
    for i, j in combinations(range(N), 2):
        both = of(theta + h[i] + h[j]) + of(theta - h[i] - h[j]) - 2.0 * value
        mixed = 0.5 * (both - side[i] - side[j]) / (STEPS[i] * STEPS[j])
        curvature[i, j] = curvature[j, i] = mixed
    return value, slope, curvature


def gain(
    item: tuple[Source, Array], is_shown: Mask, std: tuple[float, float], config: Config
) -> tuple[float, float] | str:
    """Return a flight's gains in log-likelihood with fixed noise and with learnt; else why none."""
    source, theta = item
    if isinstance(found := _opened(source, config), str):
        return found
    recording, _, cuts = found
    values, rows = [], 0
    for one in (
        config,
        tuned(config, theta, is_shown, std, learns=False),
        tuned(config, theta, is_shown, std, learns=True),
    ):
        sums, judged = likelihood(recording, one, cuts)
        rows = rows or judged
        values.append(float(sums.sum()) * rows / max(judged, 1))
    return values[1] - values[0], values[2] - values[0]
