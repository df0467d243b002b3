"""Find how a radar is turned on the inertial sensor, how late it is, and what its speeds are in."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.doppler import velocities
from ekf_companion.lidar.radar import LATE
from ekf_companion.lidar.readers.doppler_fit import POSITION_SIGMA, Fit, find
from ekf_companion.lidar.readers.scans import Scans
from ekf_companion.lidar.readers.timing import Timing
from ekf_companion.lidar.readers.units import SPEED, nearest
from ekf_companion.lidar.recording import InertialSamples, Mounting
from ekf_companion.lidar.settings import Settings
from ekf_companion.nav import so3

SHOWN = float(np.radians(12.0))
"""Sigma of the mounting up to which it counts as shown: the axes of a cube are 90 deg apart."""
APART = float(np.radians(30.0))
"""Of a mounting that is known, beyond which it is another one: nobody measures so badly."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """What radar and inertial samples show together."""

    timing: Timing
    """With the unit and sign of the speeds, and what the stamps are late."""
    mounting: Mounting
    noise: float
    """Variance of the velocities of scans, as a multiple of what their points say, 1 at least."""
    sentences: tuple[str, ...]


def compare_doppler(
    scans: Scans, inertial: InertialSamples, mounting: Mounting | None, most_speed: float
) -> Agreement:
    """Return how a radar is meant by its motion.

    Args:
        scans: The scans, with the timing that their values show.
        inertial: The samples, in SI units and in order.
        mounting: Of the radar on the inertial sensor; None: not known.
        most_speed: Radial speed at which they wrap, in the recording's unit; 0: they do not.

    Raises:
        LogError: They contradict each other.
    """
    timing, name = scans.timing, scans.source.name
    settings = Settings(most_doppler=most_speed)
    found = [one for one in velocities(scans, settings) if one.used]
    if len(found) < 2:
        raise LogError(
            f"{name}: {len(found)} scans show a velocity: too few points, or none that agree; "
            "is it the right topic, and is what stands still not filtered out by the radar?"
        )
    fit = find(found, inertial, mounting)
    noise = 1.0 if fit is None else fit.noise
    if fit is None or not fit.is_seen or (mounting is None and fit.sigma > SHOWN):
        said = "the motion does not show whether radar and samples agree"
        if mounting is None:
            said = (
                "the recording does not say how the radar is mounted, nor does the motion show it: "
                "taken for axes alike; give the mounting"
            )
        return Agreement(timing, mounting or Mounting(), noise, (said,))
    unit = nearest(1.0, 1.0 / abs(fit.unit), SPEED)
    if unit != 1.0 and timing.speed_unit == 1.0:
        # Noise is in m/s: once more, with speeds in m/s
        scans = replace(scans, timing=replace(timing, speed_unit=unit))
        again = compare_doppler(scans, inertial, mounting, unit * most_speed)
        said = f"radial speeds are in {SPEED[unit]}, not m/s"
        return replace(again, sentences=(said, *again.sentences))
    timing, sentences = _signs(timing, fit, is_known=mounting is not None)
    if noise > 1.0:
        sentences.append(
            f"velocities of scans are {np.sqrt(noise):.1f} times as noisy as their points say: "
            "taken so"
        )
    if mounting is None:
        mounting = Mounting(fit.rotation, np.zeros(3), fit.sigma, POSITION_SIGMA)
        sentences.append(
            f"the recording does not say how the radar is mounted: by the motion {_angles(fit)}, "
            f"sigma {np.degrees(fit.sigma):.1f} deg, taken for at the inertial sensor; give the "
            "mounting if it is known"
        )
    elif (angle := fit.apart(mounting.rotation)) > APART and fit.sigma < SHOWN:
        raise LogError(
            f"{name}: the axes of radar and inertial sensor do not belong together: by the motion "
            f"the radar is mounted at {_angles(fit)}, {np.degrees(angle):.0f} deg from where it is "
            f"said to be{_mirrored(fit)}; correct the axes (forward, left, up), or the mounting"
        )
    return Agreement(timing, mounting, noise, tuple(sentences))


def _signs(timing: Timing, fit: Fit, *, is_known: bool) -> tuple[Timing, list[str]]:
    """Return the timing with the sign of the speeds and late stamps, and sentences on them."""
    said = [
        f"radar and inertial samples agree: {100 * (1 - fit.left):.0f} % of the changes of "
        "velocity are the same"
    ]
    if fit.unit < 0:
        mirrored = "" if is_known else ", or an axis of the radar is mirrored, which is the same"
        said.append(f"radial speeds are positive towards the sensor{mirrored}: turned round")
        timing = replace(timing, speed_unit=-timing.speed_unit)
    # What is less the filter finds
    if abs(fit.delay) > 2.0 * LATE:
        late = "late" if fit.delay < 0 else "early"
        timing = replace(timing, shift=timing.shift + fit.delay)
        said.append(
            f"stamps of scans are {1e3 * abs(fit.delay):.0f} ms {late} by the motion, sigma "
            f"{1e3 * fit.delay_sigma:.0f} ms: corrected"
        )
    return timing, said


def _mirrored(fit: Fit) -> str:
    return ", and its speeds are reversed or one axis mirrored" if fit.unit < 0 else ""


def _angles(fit: Fit) -> str:
    roll, pitch, yaw = np.degrees(so3.to_euler(so3.from_matrix(fit.rotation))).tolist()
    return f"roll, pitch, yaw of {roll:.0f}, {pitch:.0f}, {yaw:.0f} deg"
