"""What a flight shows of each state, and when: local Gramians and the covariance along the way.

Two measures, both from the transition and the Jacobians of the aids that the error-state filter
used, along its own estimate:

    The local Gramian of a window, W = sum Phi' H' R^-1 H Phi, referred to the window's start. It
    knows nothing of what came before, and no process noise: over 10 s that adds to a velocity as
    much as one fix leaves open, so longer windows would overstate.
    The covariance from the start of the flight on, process noise included: the least that any
    filter could know by then (Cramer-Rao). By this a state *becomes* observable.

States are made comparable by units: what is not known of them before. The attitude's error is
taken about axes that are level and turned with the heading: roll, pitch, heading.

Source: Chen 1999, "Linear system theory and design", section 6.2; Ham and Brown 1983,
"Observability, eigenvalues, and Kalman filtering", IEEE Trans. AES-19; Tichavsky et al. 1998,
"Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE Trans. SP-46.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ekf_companion.analysis.observability_motion import Motion
from ekf_companion.analysis.observability_walk import STEP_NS, Cell, Walk, is_field
from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.course import Course, Setup
from ekf_companion.filters.gate import Gate
from ekf_companion.filters.observation import Azimuth
from ekf_companion.filters.strapdown import ATT, BA, BG, N
from ekf_companion.nav import so3
from ekf_companion.nav.earth import STANDARD_GRAVITY

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Told how much is done, of how much."""

WINDOW = 10.0
"""Length of a window, s: what is written above."""
OBSERVABLE = 0.5
"""Share of the unit below which a state counts as observable. Of two states of which only the sum
is seen, as a bias and a tilt at rest, each keeps 0.71 at least: half needs telling them apart.
"""
HEADING_UNIT = float(np.radians(10.0))
"""rad: twice what a heading is good for, and where sines still are angles."""
UNKNOWN_HEADING = float(np.pi / np.sqrt(3.0))
"""One sigma of any heading at all, rad."""
ANGLES = ("roll", "pitch", "heading")
STATES = (
    *ANGLES,
    *(f"{what} {axis}" for what in ("velocity", "position") for axis in ("north", "east", "down")),
    *(f"{what} {axis} bias" for what in ("gyro", "accelerometer") for axis in "xyz"),
)
"""Names in order of the error state; the first three are not of the body's axes."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Observability:
    """What a flight shows. Times are s after the first inertial sample."""

    begin: float
    """When the filter begins."""
    t: Array
    """Ends of the steps, shape (m,)."""
    unit: Array
    """Of each state, SI, shape (15,)."""
    covariance: Array
    """By the flight until then, SI, shape (m, 15, 15)."""
    at_rest: Array
    """One sigma in units if it had stood as it began, with the same aids, shape (m, 15)."""
    free_heading: Array
    """One sigma of the heading without the aids that show north, rad, shape (m,)."""
    window: float
    """s."""
    singular: Array
    """Singular values of the Gramian of the window that ends then, descending, in units: 1 says as
    much as was known before. Shape (m, 15); NaN until the first window is full."""
    direction: Array
    """Of each, unit length, as rows, shape (m, 15, 15)."""
    window_sigma: Array
    """One sigma that a window alone leaves, of what is not known before as a prior, in units, shape
    (m, 15)."""
    motion: Motion
    first: Mapping[str, float]
    """When each aid was first fused, s."""
    has_magnetometer: bool
    """North is from a magnetometer; else from headings."""
    is_rest: bool
    """It begins at rest: the filter takes the mean of the gyro for its bias."""
    notes: tuple[str, ...]
    """What the user should know, one sentence each."""

    @property
    def sigma(self) -> Array:
        """Give one sigma by the flight until then, in units, shape (m, 15)."""
        return np.asarray(
            np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0)) / self.unit
        )

    @property
    def doubt(self) -> Array:
        """Give what is judged, in units, (m, 15): one sigma; that of roll and pitch without noise.

        Noise of the gyro keeps a tilt from being better known, however well it is told from the
        accelerometer biases. So the least that is ever left of it beside them does not count.
        """
        doubt = self.sigma
        with_bias = self.covariance[:, :2, BA]
        explained = np.linalg.solve(self.covariance[:, BA, BA], with_bias.transpose(0, 2, 1))
        shared2 = np.einsum("kij,kji->ki", with_bias, explained) / np.square(self.unit[:2])
        beside2 = np.square(doubt[:, :2]) - shared2
        floor2 = np.clip(beside2.min(axis=0), 0.0, OBSERVABLE * OBSERVABLE)
        doubt[:, :2] = np.sqrt(np.maximum(np.square(doubt[:, :2]) - floor2, 0.0))
        return np.asarray(doubt)


def analyse(
    course: Course,
    setup: Setup,
    settings: FilterSettings,
    *,
    window: float = WINDOW,
    progress: Progress | None = None,
) -> Observability:
    """Take the error-state filter through a recording, and see what it could know.

    Args:
        course: The recording.
        setup: Of it. Its gate counts on.
        settings: What is not known of the biases before.
        window: Length of a window, s.
        progress: Told how many samples are done.

    Raises:
        LogError: The recording is shorter than a step, or the filter diverges.
    """
    unit = units(setup, settings)
    P = prior(setup, settings)
    walk = walked(course, Walk(setup, P), progress)
    if walk.is_lost:
        # A start in a manoeuvre may be so wrong that the gate keeps the truth out
        fresh = replace(setup, gate=Gate(settings.gate))
        other = walked(course, Walk(fresh, P, is_gated=False), progress)
        walk = min(walk, other, key=lambda one: one.doubt)
    cells = walk.cells
    if not cells:
        raise LogError(
            f"the filter runs for less than {STEP_NS * 1e-9:g} s; that shows nothing of its states"
        )
    singular, direction, window_sigma = _windows(cells, unit, round(window / (STEP_NS * 1e-9)))
    zero_ns = int(course.t_ns[0])
    azimuths = [aid for _, aid in course.aids if isinstance(aid, Azimuth)]
    return Observability(
        begin=(setup.start.t_ns - zero_ns) * 1e-9,
        t=np.array([one.t_ns - zero_ns for one in cells]) * 1e-9,
        unit=unit,
        covariance=np.array([one.P for one in cells]),
        at_rest=np.array([one.rest for one in cells]) / unit,
        free_heading=np.array([one.free_heading for one in cells]),
        window=window,
        singular=singular,
        direction=direction,
        window_sigma=window_sigma,
        motion=walk.track.motion(zero_ns),
        first={aid: (t_ns - zero_ns) * 1e-9 for aid, t_ns in walk.first_ns.items()},
        has_magnetometer=any(is_field(aid) for aid in azimuths),
        is_rest=bool(setup.start.P[BG.start, BG.start] < 0.25 * settings.imu.gyro_bias**2),
        notes=walk.notes(),
    )


def walked(course: Course, walk: Walk, progress: Progress | None = None) -> Walk:
    """Take a filter to the end of a recording, and give it.

    Raises:
        LogError: It diverges.
    """
    for done, step in enumerate(course.steps(walk.begin_ns)):
        if step.over is not None:
            walk.predict(step.over)
        for aid in step.aids:
            walk.correct(step.t_ns, aid)
        if step.is_sample:
            walk.close(step.t_ns)
        if progress is not None and done % 1000 == 0:
            progress(done, len(course.t_ns))
    return walk


def units(setup: Setup, settings: FilterSettings) -> Array:
    """Give what is not known of each state before, one sigma, SI, shape (15,).

    A bias has that of the settings, whatever the start has learnt; roll and pitch what an unknown
    accelerometer bias makes of a level; velocity and position what the start has.
    """
    imu = settings.imu
    unit = np.sqrt(np.diagonal(setup.start.P)).copy()
    unit[ATT] = [imu.accel_bias / STANDARD_GRAVITY] * 2 + [HEADING_UNIT]
    unit[BG], unit[BA] = imu.gyro_bias, imu.accel_bias
    return np.asarray(unit)


def prior(setup: Setup, settings: FilterSettings) -> Array:
    """Give the covariance of the start, but for what it has learnt of gyro and heading.

    The start takes its heading for independent of its level. A field that dips makes it depend on
    the level, and would so seem to show that: so any heading is as likely here.
    """
    P = setup.start.P.copy()
    P[BG] = P[:, BG] = 0.0
    P[BG, BG] = settings.imu.gyro_bias**2 * np.eye(3)
    down_b = so3.to_matrix(setup.start.state.q_nb)[2]
    P[ATT, ATT] += UNKNOWN_HEADING**2 * np.outer(down_b, down_b)
    return np.asarray(P)


def _windows(cells: Sequence[Cell], unit: Array, size: int) -> tuple[Array, Array, Array]:
    """Give singular values, directions and one sigma of the window that ends with each cell."""
    m = len(cells)
    singular, sigma = np.full((m, N), np.nan), np.full((m, N), np.nan)
    direction = np.full((m, N, N), np.nan)
    for end in range(size - 1, m):
        W = cells[end].W
        for one in reversed(cells[end - size + 1 : end]):
            W = one.W + one.Phi.T @ W @ one.Phi
        T = cells[end - size + 1].level
        scaled = (T @ W @ T.T) * np.outer(unit, unit)
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        singular[end], direction[end] = np.maximum(values[::-1], 0.0), vectors.T[::-1]
        sigma[end] = np.sqrt(np.diagonal(np.linalg.inv(scaled + np.eye(N))))
    return singular, direction, sigma
