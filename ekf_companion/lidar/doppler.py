"""Velocity of a radar by the radial speeds of what stands still around it.

A point in the direction u that stands still has the radial speed d = -u'v. Three points that agree
with most others begin, least squares over all that agree end; what moves itself, and echoes over
two surfaces, are left out.

Source: Kellner et al. 2013, "Instantaneous ego-motion estimation using Doppler radar" (consensus,
then least squares); Doer and Trommer 2020, "An EKF based approach to radar inertial odometry"
(three axes, as a measurement beside inertial samples).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.lidar.recording import Scan
from ekf_companion.lidar.sampling import within_range
from ekf_companion.lidar.settings import Settings
from ekf_companion.nav.arrays import Array

SAMPLES = 60
"""Of three points: where half the points agree one of 52 is of these alone, but once in 1000."""
AGREES = 3.0
"""Sigmas within which a point agrees."""
LEAST = 5
"""Points that agree: three find a velocity, two more can contradict it."""
SPAN = 0.03
"""Least singular value of three directions, of the largest, by which they span space, rad: less is
the error of one."""
SHOWN = 1e-6
"""Least information along a direction, of the largest: a spread of directions of a milliradian."""
ROUNDS = 6
"""Of least squares at most: then hardly a point still comes or goes."""
MOST_STEPS = 2048
"""Of radial speeds: a radar has as many as chirps in a frame, at most."""
SAME = 0.1
"""Share of a step by which speeds on one differ, and share of the speeds that may lie beside."""


@dataclass(frozen=True, slots=True, eq=False)
class EgoVelocity:
    """What one scan says of the velocity of the sensor, in the sensor's frame."""

    stamp: float
    """s, of the scan."""
    points: int
    """Within range."""
    used: int = 0
    """That agree; 0: too few do, and no velocity is shown."""
    vel: Array = field(default_factory=lambda: np.zeros(3))
    """m/s, shape (3,)."""
    information: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """Inverse of its covariance, s^2/m^2, shape (3, 3)."""
    rms: float = float("nan")
    """Of what is left of the speeds, in their sigmas."""


def velocities(scans: Iterable[Scan], settings: Settings) -> Iterator[EgoVelocity]:
    """Yield the velocity of each scan; radial speeds that wrap go on from the scan before.

    One in motion that is the same to the bit as that before shows none: the radar is frozen.

    Args:
        scans: In the order of their stamps; gone through twice.
        settings: Ranges, noise, and at which speed the radial speeds wrap.
    """
    step, before = find_step(scans), np.zeros(3)
    for scan in scans:
        found = ego_velocity(scan, settings, step, before)
        if found.vel.any() and (found.vel == before).all():
            found = EgoVelocity(scan.stamp, found.points)
        before = found.vel if found.used else before
        yield found


def find_step(scans: Iterable[Scan]) -> float:
    """Return the step in which a radar counts radial speeds, m/s; 0: they are continuous."""
    speeds = np.zeros(0)
    for scan in scans:
        if scan.doppler is not None:
            speeds = np.unique(np.concatenate([speeds, scan.doppler]))
        if len(speeds) > MOST_STEPS:
            return 0.0
    apart = np.diff(speeds)
    # Speeds that are equal may differ by rounding
    apart = apart[apart > 1e-3 * np.ptp(speeds) / len(speeds)] if len(speeds) > 2 else apart
    if len(apart) < 2:
        return 0.0
    step = float(np.median(apart))
    is_on = np.abs(speeds / step - np.round(speeds / step)) < SAME
    return step if is_on.mean() > 1.0 - SAME else 0.0


def ego_velocity(scan: Scan, settings: Settings, step: float, expected: Array) -> EgoVelocity:
    """Return the velocity of the sensor by one scan.

    Args:
        scan: With radial speeds.
        settings: Ranges, noise, and at which speed the radial speeds wrap.
        step: Between two radial speeds, m/s.
        expected: Velocity by which they are unwrapped, m/s, shape (3,).
    """
    kept = within_range(scan.points, settings)
    nothing = EgoVelocity(scan.stamp, len(kept))
    if scan.doppler is None or len(kept) < LEAST:
        return nothing
    u = scan.points[kept]
    H = -u / np.linalg.norm(u, axis=1)[:, None]
    d = scan.doppler[kept]
    if settings.most_doppler > 0.0:
        span = 2.0 * settings.most_doppler
        d = d + span * np.round((H @ expected - d) / span)
    vel = _consensus(H, d, _variance(H, expected, settings, step, 1.0))
    agrees, var = np.zeros(len(d), dtype=np.bool_), _variance(H, vel, settings, step, 1.0)
    for _ in range(ROUNDS):
        before, agrees = agrees, (d - H @ vel) ** 2 < AGREES**2 * var
        if agrees.sum() < LEAST:
            return nothing
        if (agrees == before).all():
            break
        A = (H[agrees].T / var[agrees]) @ H[agrees]
        # A radar without elevation shows two axes: along the third the least velocity, no more
        vel = np.linalg.pinv(A, SHOWN, hermitian=True) @ (H[agrees].T @ (d / var)[agrees])
        var = _variance(H, vel, settings, step, _crowd(d[agrees], step))
        # Surroundings may be noisier than is set, but what repeats itself is no better
        left = float(((d - H @ vel) ** 2 / var)[agrees].sum())
        var *= max(1.0, left / (agrees.sum() - 3))
    A = (H[agrees].T / var[agrees]) @ H[agrees]
    rms = float(np.sqrt(np.mean(((d - H @ vel) ** 2 / var)[agrees])))
    # What a scan has as a whole, without an inverse of A: it may not hold one direction
    whole = settings.doppler_scan**2 + settings.doppler_angle**2 * float(vel @ vel)
    information = np.linalg.solve(np.eye(3) + whole * A, A)
    information = 0.5 * (information + information.T)
    return EgoVelocity(scan.stamp, len(kept), int(agrees.sum()), vel, information, rms)


def lines_of(found: Iterable[EgoVelocity]) -> Iterator[str]:
    """Yield the lines of a .csv of velocities: empty cells where a scan shows none."""
    yield "t_s,vx_m_s,vy_m_s,vz_m_s,P_xx,P_xy,P_xz,P_yy,P_yz,P_zz,points,used,rms"
    for one in found:
        numbers = [""] * 9
        if one.used:
            # To 1 km/s where a direction is not shown
            P = np.linalg.inv(one.information + 1e-6 * np.eye(3))
            numbers = [f"{value:.6g}" for value in (*one.vel, *P[np.triu_indices(3)])]
        rms = f"{one.rms:.3g}" if one.used else ""
        yield ",".join([f"{one.stamp:.6f}", *numbers, str(one.points), str(one.used), rms])


def _variance(H: Array, vel: Array, settings: Settings, step: float, crowd: float) -> Array:
    """Return the variance of radial speeds, (m/s)^2, shape (n,).

    That of the speed itself, of its step, and of the direction, which turns what goes across into
    what goes along.
    """
    across = vel @ vel - (H @ vel) ** 2
    own = settings.doppler_noise**2 + crowd * step**2 / 12.0
    return np.asarray(own + settings.doppler_angle**2 * np.maximum(across, 0.0))


def _crowd(d: Array, step: float) -> float:
    """Return by how much rounding to a step counts more than as if each point's were its own.

    Over m steps rounding is a saw-tooth of m periods: 1/m^2 of its square is a slope, which passes
    for velocity. Of n points' own rounding it were 1/n. At rest all are on one step, and nothing
    averages out.
    """
    if step <= 0.0:
        return 1.0
    steps = 1.0 + float(np.ptp(d)) / step
    return max(1.0, len(d) / steps**2)


def _consensus(H: Array, d: Array, var: Array) -> Array:
    """Return the velocity of three points that agrees best with all."""
    chosen = np.random.default_rng(0).integers(len(d), size=(SAMPLES, 3))
    vel = np.einsum("kij,kj->ki", np.linalg.pinv(H[chosen], SPAN), d[chosen])
    cost = np.minimum((d - vel @ H.T) ** 2 / var, AGREES**2).sum(axis=1)
    return np.asarray(vel[int(cost.argmin())])
