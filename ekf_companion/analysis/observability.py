"""Observability of each state along a flight: local Gramians and the covariance.

Two measures, both from the transition and the Jacobians of the aids that the error-state filter
used, along its own estimate:

    The local Gramian of a window, W = sum Phi' H' R^-1 H Phi, referred to the window's start. It
    leaves out what came before, and the process noise: over 10 s that adds to a velocity as much
    as one fix leaves unknown, so longer windows would overstate.
    The covariance from the start of the flight on, with process noise: the least uncertainty that
    any filter could reach by then (Cramer-Rao). By this a state *becomes* observable.

States are made comparable by units: the sigma of each before the flight. The attitude's error is
about axes that are level and turned with the heading: roll, pitch, heading.

Source: Chen 1999, "Linear system theory and design", section 6.2; Ham and Brown 1983,
"Observability, eigenvalues, and Kalman filtering", IEEE Trans. AES-19; Tichavsky et al. 1998,
"Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE Trans. SP-46.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.analysis.observability_filter import STEP_NS, ObservabilityFilter, Step, is_field
from ekf_companion.analysis.observability_motion import Motion
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.gate import Gate
from ekf_companion.filters.observation import Azimuth
from ekf_companion.filters.sequence import MeasurementSequence, Setup
from ekf_companion.filters.strapdown import ATT, BA, BG, N
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import STANDARD_GRAVITY

Progress = Callable[[int, int], None]
"""Called with the number of samples done, and of all."""

WINDOW = 10.0
"""Length of a window, s; see above."""
OBSERVABLE = 0.5
"""Share of the unit below which a state counts as observable. Of two states of which only the sum
is measured, as a bias and a tilt at rest, each keeps 0.71 at least: 0.5 needs their separation."""
HEADING_UNIT = float(np.radians(10.0))
"""rad: twice the sigma of a useful heading, and small enough for sines to be angles."""
UNKNOWN_HEADING = float(np.pi / np.sqrt(3.0))
"""One sigma of a heading that is not known, rad: uniform over the circle."""
ANGLES = ("roll", "pitch", "heading")
MOTION = [
    f"{what} {axis}" for what in ("velocity", "position") for axis in ("north", "east", "down")
]
BIASES = [f"{what} {axis} bias" for what in ("gyro", "accelerometer") for axis in "xyz"]
STATES = (*ANGLES, *MOTION, *BIASES)
"""Names in order of the error state; the angles are about level axes."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Observability:
    """The result of a flight. Times are s after the first inertial sample."""

    begin: float
    """When the filter begins."""
    t: Array
    """Ends of the steps, shape (m,)."""
    unit: Array
    """Of each state, SI, shape (15,)."""
    covariance: Array
    """Covariance at each time, SI, shape (m, 15, 15)."""
    at_rest: Array
    """One sigma in units of a vehicle at rest with the same aids, shape (m, 15)."""
    free_heading: Array
    """One sigma of the heading without heading aids, rad, shape (m,)."""
    window: float
    """s."""
    singular: Array
    """Singular values, descending, of the Gramian in units of the window that ends at each time: 1
    equals the prior information. Shape (m, 15); NaN until the first window is full."""
    direction: Array
    """The unit vector of each, as rows, shape (m, 15, 15)."""
    window_sigma: Array
    """One sigma in units after the window alone, from the prior, shape (m, 15)."""
    motion: Motion
    first: Mapping[str, float]
    """When each aid was first fused, s."""
    has_magnetometer: bool
    """The heading aid is a magnetometer; else it is a heading."""
    is_rest: bool
    """The flight begins at rest: the mean of the gyro is its bias."""
    notes: tuple[str, ...]
    """What the user should know, one sentence each."""

    @property
    def sigma(self) -> Array:
        """Return one sigma at each time, in units, shape (m, 15)."""
        return np.asarray(
            np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0)) / self.unit
        )

    @property
    def judged_sigma(self) -> Array:
        """Return one sigma in units, that of roll and pitch without gyro noise, shape (m, 15).

        Gyro noise limits the tilt however well it is separated from the accelerometer biases. So
        the least sigma that it ever has beside them is subtracted.
        """
        judged = self.sigma
        with_bias = self.covariance[:, :2, BA]
        explained = np.linalg.solve(self.covariance[:, BA, BA], with_bias.transpose(0, 2, 1))
        shared2 = np.einsum("kij,kji->ki", with_bias, explained) / np.square(self.unit[:2])
        beside2 = np.square(judged[:, :2]) - shared2
        floor2 = np.clip(beside2.min(axis=0), 0.0, OBSERVABLE * OBSERVABLE)
        judged[:, :2] = np.sqrt(np.maximum(np.square(judged[:, :2]) - floor2, 0.0))
        return np.asarray(judged)


def analyse(
    course: MeasurementSequence,
    setup: Setup,
    settings: FilterSettings,
    *,
    window: float = WINDOW,
    progress: Progress | None = None,
) -> Observability:
    """Run the error-state filter over a recording and judge the observability of its states.

    The window is in s; the settings hold the prior sigmas of the biases; the gate of the setup is
    used up.

    Raises:
        LogError: The recording is shorter than a step, or the filter diverges.
    """
    unit = units(setup, settings)
    P = prior(setup, settings)
    tried = run(course, ObservabilityFilter(setup, P), progress)
    if tried.is_lost:
        # A start in a manoeuvre may be so wrong that the gate refuses true measurements
        fresh = replace(setup, gate=Gate(settings.gate))
        other = run(course, ObservabilityFilter(fresh, P, is_gated=False), progress)
        tried = min(tried, other, key=lambda one: one.refused_share)
    steps = tried.steps
    if not steps:
        raise LogError(
            f"the filter runs for less than {STEP_NS * 1e-9:g} s; that shows nothing of its states"
        )
    singular, direction, window_sigma = _windows(steps, unit, round(window / (STEP_NS * 1e-9)))
    zero_ns = int(course.t_ns[0])
    azimuths = [aid for _, aid in course.aids if isinstance(aid, Azimuth)]
    return Observability(
        begin=(setup.start.t_ns - zero_ns) * 1e-9,
        t=np.array([one.t_ns - zero_ns for one in steps]) * 1e-9,
        unit=unit,
        covariance=np.array([one.P for one in steps]),
        at_rest=np.array([one.rest for one in steps]) / unit,
        free_heading=np.array([one.free_heading for one in steps]),
        window=window,
        singular=singular,
        direction=direction,
        window_sigma=window_sigma,
        motion=tried.motion.motion(zero_ns),
        first={aid: (t_ns - zero_ns) * 1e-9 for aid, t_ns in tried.first_ns.items()},
        has_magnetometer=any(is_field(aid) for aid in azimuths),
        is_rest=bool(setup.start.P[BG.start, BG.start] < 0.25 * settings.imu.gyro_bias**2),
        notes=tried.notes(),
    )


def run(
    course: MeasurementSequence, tried: ObservabilityFilter, progress: Progress | None = None
) -> ObservabilityFilter:
    """Run a filter to the end of a recording, and return it.

    Raises:
        LogError: It diverges.
    """
    for done, step in enumerate(course.steps(tried.begin_ns)):
        if step.over is not None:
            tried.predict(step.over)
        for aid in step.aids:
            tried.correct(step.t_ns, aid)
        if step.is_sample:
            tried.end_sample(step.t_ns)
        if progress is not None and done % 1000 == 0:
            progress(done, len(course.t_ns))
    return tried


def units(setup: Setup, settings: FilterSettings) -> Array:
    """Return one sigma of each state before the flight, SI, shape (15,).

    That of a bias is from the settings, whatever the start has learnt; of roll and pitch the error
    of a level by an unknown accelerometer bias; of velocity and position that of the start.
    """
    imu = settings.imu
    unit = np.sqrt(np.diagonal(setup.start.P)).copy()
    unit[ATT] = [imu.accel_bias / STANDARD_GRAVITY] * 2 + [HEADING_UNIT]
    unit[BG], unit[BA] = imu.gyro_bias, imu.accel_bias
    return np.asarray(unit)


def prior(setup: Setup, settings: FilterSettings) -> Array:
    """Return the covariance of the start without what it has learnt of gyro bias and heading.

    The start treats its heading as independent of its level. A dipping field makes it depend on
    the level, and would thus seem to show the level: so the heading is unknown here.
    """
    P = setup.start.P.copy()
    P[BG] = P[:, BG] = 0.0
    P[BG, BG] = settings.imu.gyro_bias**2 * np.eye(3)
    down_b = so3.to_matrix(setup.start.state.q_nb)[2]
    P[ATT, ATT] += UNKNOWN_HEADING**2 * np.outer(down_b, down_b)
    return np.asarray(P)


def _windows(steps: Sequence[Step], unit: Array, size: int) -> tuple[Array, Array, Array]:
    """Return singular values, directions and one sigma of the window that ends with each step."""
    m = len(steps)
    singular, sigma = np.full((m, N), np.nan), np.full((m, N), np.nan)
    direction = np.full((m, N, N), np.nan)
    for end in range(size - 1, m):
        W = steps[end].W
        for one in reversed(steps[end - size + 1 : end]):
            W = one.W + one.Phi.T @ W @ one.Phi
        T = steps[end - size + 1].to_level
        scaled = (T @ W @ T.T) * np.outer(unit, unit)
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        singular[end], direction[end] = np.maximum(values[::-1], 0.0), vectors.T[::-1]
        sigma[end] = np.sqrt(np.diagonal(np.linalg.inv(scaled + np.eye(N))))
    return singular, direction, sigma
