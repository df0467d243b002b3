"""Noise of the inertial sensors at rest, and of the receiver at rest and in flight.

That of the inertial sensors is from the Allan deviation over all rests (``allan``, ``rest``), of
the worst of the three axes: the configuration has one number for them. That of the receiver is from
the scatter of its fixes (``scatter``, ``fixes``), in flight where there is enough of it: at rest
many receivers smooth more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ekf_companion.calibrate import allan, fixes, rest
from ekf_companion.calibrate.allan import Curve, Noise
from ekf_companion.calibrate.fixes import Receiver
from ekf_companion.calibrate.rest import Stretch
from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording

SHORTEST = 10.0
"""Shortest stretch at rest that counts, s."""
NEEDED = 20.0
"""Rest needed in all, s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Inertial:
    """Noise of the inertial sensors at rest."""

    seconds: float
    rate: float
    """Hz."""
    curves: tuple[Curve, ...]
    """Of gyro forward, right, down, then accelerometer."""
    axes: tuple[Noise, ...]
    """Likewise."""
    steps: tuple[float, float]
    """Resolution of gyro and accelerometer: the usual step between two values."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Noises:
    """The noise measured from a log."""

    inertial: Inertial | None
    receivers: tuple[Receiver, ...]
    """At rest and in flight, as far as measured."""
    notes: tuple[str, ...]


def measure(recording: Recording, settings: FilterSettings, name: str = "the log") -> Noises:
    """Measure the noise of a log's sensors, with the estimator's settings.

    Raises:
        LogError: There is neither rest nor enough fixes.
    """
    stretches = rest.find(recording.events, settings.align, SHORTEST)
    rate = rest.rate(recording.events)
    notes: list[str] = []
    inertial = _inertial(rate, stretches, notes)
    own = fixes.find(recording)
    receivers: list[Receiver] = []
    if len(own) > 2:
        found = [fixes.at_rest(own, stretches)]
        if rate >= rest.SLOW:
            found.append(fixes.in_flight(recording, settings, own, stretches))
        receivers = [one for one in found if one is not None and one.horizontal is not None]
        if not receivers:
            notes.append(
                "the receiver: too few fixes in a row; a minute of them, at rest or with a known "
                "attitude, is needed"
            )
    else:
        notes.append("the receiver: no GNSS fix of its own in the log")
    if inertial is None and not receivers:
        raise LogError(f"{name}: tells nothing of noise: {'; '.join(notes)}")
    return Noises(inertial=inertial, receivers=tuple(receivers), notes=tuple(notes))


def _inertial(rate: float, stretches: Sequence[Stretch], notes: list[str]) -> Inertial | None:
    """Fit all six axes; return None, and add a note, if there is no rest."""
    seconds = sum(stretch.seconds for stretch in stretches)
    lack = ""
    if rate == 0.0:
        lack = "no samples in the log"
    elif rate < rest.SLOW:
        lack = (
            f"samples come at {rate:.1f} Hz, below {rest.SLOW:.0f} Hz; what is between them "
            "cannot be judged. Ask for a faster stream"
        )
    elif seconds < NEEDED:
        lack = (
            f"{seconds:.0f} s of rest found, {NEEDED:.0f} s are needed; let the vehicle stand "
            "still with its motors off, for some minutes (an hour for the walk of the biases)"
        )
    if lack:
        notes.append(f"the inertial sensors: {lack}")
        return None
    period = 1.0 / rate
    fits = [allan.fit([part.values[:, axis] for part in stretches], period) for axis in range(6)]
    values = np.concatenate([part.values for part in stretches])
    return Inertial(
        seconds=seconds,
        rate=rate,
        curves=tuple(curve for curve, _ in fits),
        axes=tuple(noise for _, noise in fits),
        steps=(_step(values[:, :3]), _step(values[:, 3:])),
    )


def _step(values: np.ndarray) -> float:
    """Return the median step between the values that occur, or 0."""
    steps = np.diff(np.unique(np.round(values, 9)))
    return float(np.median(steps)) if len(steps) else 0.0
