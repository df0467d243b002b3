"""Noise of the inertial sensors at rest, and of the receiver at rest and in flight.

That of the inertial sensors is from the Allan deviation over all rests (``allan``, ``rest``), of
the worst of the three axes: the configuration has one number for them. That of the receiver is from
the scatter of its fixes (``scatter``, ``fixes``), in flight where there is enough of it: at rest
many receivers smooth more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.calibrate import allan, fixes, rest
from ekf_companion.calibrate.allan import Curve, Noise
from ekf_companion.calibrate.fixes import Receiver
from ekf_companion.calibrate.rest import Stretch
from ekf_companion.calibrate.result import Result, Setting, rounded
from ekf_companion.calibrate.scatter import Scatter
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings, ImuSettings
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording

SHORTEST = 10.0
"""Shortest stretch at rest that counts, s."""
NEEDED = 20.0
"""Rest needed in all, s."""
WORTH = 600.0
"""Rest after which a random walk of the bias can show, s."""
SENSORS = {"gyro": ("rad/s", slice(0, 3)), "accel": ("m/s^2", slice(3, 6))}


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
        raise LogError(f"{name}: shows nothing of the noise: {'; '.join(notes)}")
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


def result(found: Noises, settings: FilterSettings) -> Result:
    """Return measured noise as keys of the configuration, beside the present settings."""
    notes: list[str] = []
    keys: list[Setting] = []
    data: dict[str, Any] = {}
    if found.inertial is not None:
        keys += _imu_settings(found.inertial, settings.imu)
        notes += _imu_notes(found.inertial)
        data["inertial"] = _imu_data(found.inertial)
    if found.receivers:
        keys += _gnss_settings(found.receivers[-1], settings.gnss)
        notes += [_gnss_note(one) for one in found.receivers]
        data["gnss"] = {one.state.replace(" ", "_"): _gnss_data(one) for one in found.receivers}
    return Result(settings=keys, notes=[*notes, *found.notes], data=data)


def _imu_settings(found: Inertial, present: ImuSettings) -> list[Setting]:
    """Return white noise and bias random walk of both sensors.

    In flight vibration adds to the white noise. The estimator raises it by what the samples show;
    behind a low-pass they do not show it, and the present setting should not be lowered.
    """
    keys = []
    for sensor, (unit, part) in SENSORS.items():
        worst = max(found.axes[part], key=lambda axis: axis.white)
        floor: float = getattr(present, f"{sensor}_noise")
        is_safe = worst.white > floor or (present.learn_noise and worst.corner is None)
        why = "motors add to it" if is_safe else f"at rest: keep {floor:g}, which counts motors in"
        keys.append(
            Setting(
                key=f"imu.{sensor}_noise",
                value=worst.white,
                comment=f"{unit} per sqrt Hz, +-{max(100.0 * worst.white_std, 1.0):.0f} %: worst "
                f"axis, read off at {worst.white_from:.2g} s; {why}",
                is_sure=bool(is_safe and worst.white > 1e-9),
            )
        )
    for sensor, (unit, part) in SENSORS.items():
        walks = [axis.walk for axis in found.axes[part]]
        worst_walk = max(walks, key=lambda walk: walk.bound)
        largest = max(walk.value for walk in walks)
        shows = largest > 0.0 and found.seconds >= WORTH
        value = largest if shows else worst_walk.bound
        comment = (
            f"{unit} per sqrt s, below {worst_walk.bound:.1e}: worst axis"
            if shows
            else f"{unit} per sqrt s; not more than this, no more can be said after "
            f"{found.seconds:.0f} s of rest"
        )
        keys.append(
            Setting(key=f"imu.{sensor}_bias_walk", value=value, comment=comment, is_sure=shows)
        )
    return keys


def _imu_notes(found: Inertial) -> list[str]:
    notes = [f"inertial sensors: {found.seconds:.0f} s of rest at {found.rate:.0f} Hz"]
    corners = [axis.corner for axis in found.axes if axis.corner is not None]
    if corners:
        short = {
            sensor: max(curve.deviation[0] * curve.tau[0] ** 0.5 for curve in found.curves[part])
            for sensor, (_, part) in SENSORS.items()
        }
        naive = [f"{sensor} {density:.1e}" for sensor, density in short.items()]
        notes.append(
            f"the stream is low-passed at about {np.median(corners):.0f} Hz: from one sample to "
            f"the next the noise looks smaller ({', '.join(naive)}) than it is"
        )
    for (sensor, (unit, part)), step in zip(SENSORS.items(), found.steps, strict=True):
        if step > 2.0 * max(float(curve.deviation[0]) for curve in found.curves[part]):
            notes.append(
                f"the {sensor} is rounded to {step:.2g} {unit}, which hides its noise; the number "
                "below is of the rounding as much as of the sensor"
            )
        flicker = [axis.instability for axis in found.axes[part]]
        worst = max(flicker, key=lambda level: level.bound)
        said = f"{worst.value:.1e}" if worst.value else f"below {worst.bound:.1e}"
        notes.append(f"bias instability of the {sensor}: {said} {unit}")
    return notes


def _imu_data(found: Inertial) -> dict[str, Any]:
    names = [f"{sensor}_{axis}" for sensor in SENSORS for axis in ("x", "y", "z")]
    axes = {
        name: {
            "white": rounded(noise.white),
            "white_std_share": rounded(noise.white_std),
            "bias_instability": rounded(noise.instability.value),
            "bias_instability_bound": rounded(noise.instability.bound),
            "bias_walk": rounded(noise.walk.value),
            "bias_walk_bound": rounded(noise.walk.bound),
            "low_pass_hz": noise.corner,
            "tau_s": rounded(curve.tau),
            "allan_deviation": rounded(curve.deviation),
        }
        for name, curve, noise in zip(names, found.curves, found.axes, strict=True)
    }
    return {"rest_s": found.seconds, "rate_hz": rounded(found.rate), **axes}


def _gnss_settings(found: Receiver, present: GnssSettings) -> list[Setting]:
    """Return the floors: as keys where the present ones do harm, else as comments."""
    keys = []
    floors = (
        ("position_std", "m", found.horizontal, present.position_std),
        ("height_std", "m", found.height, present.height_std),
        ("velocity_std", "m/s", found.velocity, present.velocity_std),
    )
    for (key, unit, scatter, floor), stated in zip(floors, found.stated, strict=True):
        if scatter is None:
            continue
        # A receiver that claims less than the floor, and keeps it, is better than the floor
        is_better = key != "velocity_std" and stated < floor and scatter.white < 0.8 * floor
        is_worse = scatter.white > floor
        why = "" if is_better or is_worse else f"; {floor:g} may stay: what lasts longer counts too"
        said = f"the receiver states {stated:.2g}" if np.isfinite(stated) else "it states none"
        keys.append(
            Setting(
                key=f"gnss.{key}",
                value=max(scatter.white, stated) if is_better else scatter.white,
                comment=f"{unit}, +-{100.0 * scatter.white_std:.0f} %: white noise {found.state}, "
                f"{said}{why}",
                is_sure=bool(is_better or is_worse),
            )
        )
    slow = found.horizontal
    if slow is not None and slow.time is not None:
        keys.append(
            Setting(
                key="gnss.slow_time",
                value=slow.time,
                comment=f"s, within a factor of 3: correlation time of {slow.slow:.2g} m, seen "
                f"for {slow.seconds:.0f} s",
            )
        )
    return keys


def _gnss_note(found: Receiver) -> str:
    def said(scatter: Scatter | None, name: str, unit: str, stated: float) -> str:
        if scatter is None:
            return f"{name} not determined"
        if scatter.time is not None:
            slow = f"{scatter.slow:.2g} {unit} slow ({scatter.time:.0f} s)"
        elif scatter.slow < 0.5 * scatter.white:
            slow = f"nothing slow in {scatter.seconds:.0f} s"
        else:
            slow = f"slow error not separable, at most {scatter.slow:.2g} {unit}"
        claim = f", stated {stated:.2g}" if np.isfinite(stated) else ""
        return f"{name} {scatter.white:.2g} {unit} white, {slow}{claim}"

    velocity = found.velocity
    parts = [
        said(found.horizontal, "position", "m", found.stated[0]),
        said(found.height, "height", "m", found.stated[1]),
        f"velocity {velocity.white:.2g} m/s white" if velocity else "no velocity",
    ]
    return f"receiver, {found.seconds:.0f} s {found.state}: {'; '.join(parts)}"


def _gnss_data(found: Receiver) -> dict[str, Any]:
    data: dict[str, Any] = {"seconds": rounded(found.seconds)}
    scatters = {
        "position_m": found.horizontal,
        "height_m": found.height,
        "velocity_mps": found.velocity,
    }
    for (name, scatter), stated in zip(scatters.items(), found.stated, strict=True):
        if scatter is None:
            continue
        data[name] = {
            "white": rounded(scatter.white),
            "white_std_share": rounded(scatter.white_std),
            "stated": rounded(stated),
        }
        if name != "velocity_mps":
            data[name] |= {
                "slow": rounded(scatter.slow),
                "slow_time_s": None if scatter.time is None else rounded(scatter.time),
                "lag_s": rounded(scatter.lag),
                "structure": rounded(scatter.structure),
            }
    return data
