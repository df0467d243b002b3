"""Mounting and delay of a lidar by the first turns of a recording, with what they show of them.

Points of a map stay where a guess has put them, so what is found is the next guess. Coarse passes
take the points of their beginning as right: they find a rotation of degrees, but a lever that the
map's own distortion feigns, and sigmas ten times too small. In fine ones the parts of the map have
the error of the guess too (see ``update.shift_by_state``). Each pass has a prior of its own about
its guess; in the end that is taken out and the one that was asked for is put in, once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.lidar.odometry import Odometry
from ekf_companion.lidar.recording import Mounting, Recording, Scan
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import exp, log
from ekf_companion.nav.arrays import Array

BEGINNING = 20.0
"""Part of a recording by which mounting and delay are found, s."""
HELD = 3.0
"""Beginning of a pass in which neither is looked for, s."""
PASSES = 8
"""Of each kind, at most."""
MOST_KEPT = 2_000_000
"""Points that are kept from one pass to the next, of 40 bytes: as much as the map may take."""
TURNING = 0.2
"""Rate of a turn that shows mounting and delay, rad/s: ten times what noise and bias are."""
LOST = 4.0
"""Sigmas that were asked for beyond which what is found is not believed."""
SETTLED_TURN, SETTLED_DELAY = np.radians(0.1), 1e-3
"""Change of a coarse pass below which it is the last, rad and s."""
FINE_TURN, FINE_DELAY = np.radians(0.5), 5e-3
"""What the coarse passes leave, one sigma, rad and s: five times the change of the last, as each
goes a fifth of the way where the map shows little."""
TURN, LEVER, LATE = slice(0, 3), slice(3, 6), 6
"""Parts of a calibration's error state."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Where the lidar is, and how late the inertial stamps are."""

    rotation: Array
    """Lidar to body, shape (3, 3)."""
    position: Array
    """Of the lidar in the body, m."""
    delay: float
    """s."""
    P: Array
    """Of rotation (vector in the lidar's frame), position and delay, shape (7, 7)."""
    alignment: float = 0.0
    """Sigma of the axes of the gyro, in which they are, relative to those of the body, rad."""

    @property
    def mounting(self) -> Mounting:
        """Return where the lidar is."""
        return Mounting(self.rotation, self.position)

    def plus(self, dx: Array, P: Array) -> Calibration:
        """Add an error state, and give it a covariance."""
        position, delay = self.position + dx[LEVER], self.delay + float(dx[LATE])
        return Calibration(self.rotation @ exp(dx[TURN]), position, delay, P)

    def minus(self, other: Calibration) -> Array:
        """Return the error state from the other one to this, shape (7,)."""
        turn = log(other.rotation.T @ self.rotation)
        return np.hstack([turn, self.position - other.position, self.delay - other.delay])


class _Part:
    """The part of a recording that each pass takes: read once, if it has not too many points."""

    def __init__(self, recording: Recording) -> None:
        self.inertial, self._scans = recording.inertial, recording.scans
        self._kept: tuple[float, list[Scan]] | None = None

    def since(self, begin: float) -> Iterator[Scan]:
        """Yield the scans of :data:`BEGINNING`."""
        if self._kept is not None and self._kept[0] == begin:
            yield from self._kept[1]
            return
        kept: list[Scan] = []
        self._kept, points = None, 0
        for scan in self._scans:
            if scan.stamp > begin + BEGINNING:
                break
            if scan.stamp < begin:
                continue
            points += len(scan.points)
            if points <= MOST_KEPT:
                kept.append(scan)
            yield scan
        if points <= MOST_KEPT:
            self._kept = begin, kept


def calibrate(recording: Recording, settings: Settings) -> Calibration:
    """Return mounting and delay, and how well they are known: as asked where nothing shows them."""
    asked = _asked(recording.mounting, settings)
    begin = _first_turn(recording)
    if not asked.P.any() or begin is None:
        return asked
    part = _Part(recording)
    guess, begin = _coarse(part, settings, asked, begin)
    if guess is asked:
        return asked
    for _ in range(PASSES):
        made = _fine(part, settings, guess, asked, begin)
        moved, guess = made.minus(guess), made
        if (np.abs(moved) <= np.sqrt(np.diag(made.P))).all():
            break
    # The lidar is compared with the axes of the gyro, which are not quite those of the body
    alignment = settings.inertial_scale if settings.is_mounting_estimated else 0.0
    return replace(guess, alignment=alignment)


def _asked(mounting: Mounting, settings: Settings) -> Calibration:
    """Return what is known before."""
    sigma = np.zeros(7)
    if settings.is_mounting_estimated:
        sigma[TURN], sigma[LEVER] = mounting.rotation_sigma, mounting.position_sigma
    sigma[LATE] = settings.delay_sigma
    return Calibration(mounting.rotation, mounting.position, 0.0, np.diag(sigma**2))


def _first_turn(recording: Recording) -> float | None:
    """Return when the vehicle turns first, s: at rest mounting and delay show in nothing."""
    rate = np.linalg.norm(recording.inertial.gyro, axis=1)
    turning = np.flatnonzero(rate > TURNING)
    return float(recording.inertial.stamp[turning[0]]) if len(turning) else None


def _coarse(
    part: _Part, settings: Settings, asked: Calibration, begin: float
) -> tuple[Calibration, float]:
    """Return a better rotation and delay, or what was asked for, and from when on they show.

    By maps whose beginning is taken as right, with the lever as it was asked for.
    """
    guess = asked
    free = asked.P.copy()
    free[LEVER] = 0.0
    for _ in range(PASSES):
        known = Calibration(guess.rotation, guess.position, guess.delay, np.zeros((7, 7)))
        made = _passed(part, settings, known, begin, free)
        if made is None:
            return asked, begin
        if (np.abs(made.minus(asked)) > LOST * np.sqrt(np.diag(asked.P)) + 1e-12).any():
            # By surroundings that show too little: elsewhere they may show more
            guess = asked
            begin += 0.25 * BEGINNING
            continue
        moved, guess = made.minus(guess), made
        if np.linalg.norm(moved[TURN]) < SETTLED_TURN and abs(moved[LATE]) < SETTLED_DELAY:
            break
    return guess, begin


def _fine(
    part: _Part, settings: Settings, guess: Calibration, asked: Calibration, begin: float
) -> Calibration:
    """Return the most likely calibration by a map that has the error of the guess."""
    most = np.repeat([FINE_TURN, np.inf, FINE_DELAY], [3, 3, 1])
    prior = np.minimum(np.sqrt(np.diag(asked.P)), most)
    unsure = Calibration(guess.rotation, guess.position, guess.delay, np.diag(prior**2))
    made = _passed(part, settings, unsure, begin)
    if made is None:
        return guess
    # What the scans show by themselves, in units of this prior
    k = np.flatnonzero(prior)
    across = np.outer(prior[k], prior[k])
    size, axes = np.linalg.eigh(np.linalg.inv(made.P[np.ix_(k, k)] / across))
    shown = (axes * np.maximum(size - 1.0, 0.0)) @ axes.T
    before = np.diag(prior[k] ** 2 / np.diag(asked.P)[k])
    P = np.linalg.inv(shown + before)
    moved, back = made.minus(guess)[k] / prior[k], asked.minus(guess)[k] / prior[k]
    dx, whole = np.zeros(7), np.zeros((7, 7))
    dx[k] = prior[k] * (P @ (shown @ moved + moved + before @ back))
    whole[np.ix_(k, k)] = P * across
    return guess.plus(dx, whole)


def _passed(
    part: _Part,
    settings: Settings,
    guess: Calibration,
    begin: float,
    free: Array | None = None,
) -> Calibration | None:
    """Return what a pass finds, from a covariance ``free`` after its beginning; None: nothing."""
    odometry = Odometry(
        part.inertial, guess.mounting, settings, delay=guess.delay, calibration=guess.P
    )
    until: float | None = None
    for scan in part.since(begin):
        until = scan.stamp + HELD if until is None else until
        if scan.stamp > until:
            odometry.release(free)
            until = np.inf
        odometry.process(scan)
    x = odometry.x
    return (
        Calibration(x.C_bl, x.pos_b, x.delay, odometry.calibration) if odometry.map.voxels else None
    )
