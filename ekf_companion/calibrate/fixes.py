"""Errors of a log's fixes: at rest as they are, in flight with the motion subtracted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ekf_companion.calibrate import rest
from ekf_companion.calibrate.rest import Stretch
from ekf_companion.calibrate.scatter import Scatter, measure
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import STANDARD_GRAVITY, LocalFrame
from ekf_companion.nav.interpolation import resample
from ekf_companion.nav.measurements import (
    GNSS_FLAGS,
    GNSS_POSITION,
    GNSS_STD,
    GNSS_VELOCITY,
    Events,
    GnssFlag,
    Kind,
)
from ekf_companion.nav.state import ACCEL_BIAS, QUATERNION, VELOCITY, Status, Table

LARGEST = np.array([1.57, 3.15, 1e5])
"""Largest latitude, longitude, rad, and altitude, m, of a fix."""
EVEN = 1.5
"""Step between fixes over the usual one at which it is a gap."""
FLIGHT, REST = 40.0, 20.0
"""Least time in flight and at rest, s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Receiver:
    """Scatter of a receiver in one state of motion; None: not known."""

    state: str
    """``at rest`` or ``in flight``."""
    seconds: float
    horizontal: Scatter | None
    """m."""
    height: Scatter | None
    """m."""
    velocity: Scatter | None
    """Horizontal, m/s."""
    stated: tuple[float, float, float]
    """Median of the accuracy that the receiver reports of each; NaN: none."""


def find(recording: Recording) -> Events:
    """Return the receiver's own fixes in order of time, each once."""
    events = recording.events
    gnss = (events.kind == Kind.GNSS) & (events.values[:, GNSS_FLAGS] == float(GnssFlag.NONE))
    gnss &= (np.abs(events.values[:, GNSS_POSITION]) < LARGEST).all(axis=1)
    index = np.flatnonzero(gnss)
    first = np.unique(events.t_ns[index], return_index=True)[1]
    return events.take(index[first])


def at_rest(fixes: Events, stretches: Sequence[Stretch]) -> Receiver | None:
    """Measure the fixes at rest; return None if there are too few."""
    ends = [(stretch.t_ns[0], stretch.t_ns[-1]) for stretch in stretches]
    parts = [fixes.take((fixes.t_ns > begin) & (fixes.t_ns < end)) for begin, end in ends]
    parts = [part for part in parts if len(part) > 2]
    if not parts:
        return None
    frame = _frame(fixes)
    errors = [np.hstack([_ned(frame, part), part.values[:, GNSS_VELOCITY]]) for part in parts]
    return _receiver("at rest", [part.t_ns for part in parts], errors, fixes, REST, 0.0)


def in_flight(
    recording: Recording, settings: FilterSettings, fixes: Events, still: Sequence[Stretch]
) -> Receiver | None:
    """Measure the fixes in motion against the estimator's; return None if there are too few."""
    pipeline = Pipeline(settings, recording.family, recording.gnss_delay)
    table = pipeline.run(recording.events)
    if len(fixes) < 3 or len(table) < 3:
        return None
    late = delays_ns(settings, recording.family, recording.gnss_delay)[Kind.GNSS]
    true_ns = fixes.t_ns - late - round(pipeline.health().gnss_delay * 1e9)
    known = np.isfinite(table.column("vel_n")) & (table.column("status") >= Status.OK)
    row = np.clip(np.searchsorted(table.stamp_ns, true_ns), 1, len(table) - 1)
    moving = known[row] & known[row - 1] & (true_ns > table.stamp_ns[0])
    for stretch in still:
        moving &= (true_ns < stretch.t_ns[0]) | (true_ns > stretch.t_ns[-1])
    if moving.sum() < 3:
        return None
    antenna = _antenna(recording.events, table, settings)
    way, speed, gained = (resample(true_ns, table.stamp_ns, one) for one in antenna)
    velocity = fixes.values[:, GNSS_VELOCITY]
    # The integral of what the receiver adds to the estimated velocity; unknown counts as 0
    more = np.nan_to_num(velocity - speed)
    step = np.diff(fixes.t_ns)[:, None] * 1e-9
    added = np.cumsum(0.5 * (more[1:] + more[:-1]) * step, axis=0)
    position = _ned(_frame(fixes), fixes) - way
    position[1:] -= added
    errors = np.hstack([position, velocity - gained])
    resets = table.column("reset_count")[row]
    pieces = np.cumsum(np.diff(resets, prepend=resets[0]) != 0.0)
    chosen = [moving & (pieces == piece) for piece in np.unique(pieces)]
    stamps, parts = [fixes.t_ns[one] for one in chosen], [errors[one] for one in chosen]
    first = _receiver("in flight", stamps, parts, fixes, FLIGHT, 0.0)
    if first is None or first.velocity is None:
        return first
    # The integral of the receiver's velocity wanders by its white noise
    period = float(np.median(np.diff(fixes.t_ns))) * 1e-9
    wander = first.velocity.white**2 * period
    return _receiver("in flight", stamps, parts, fixes, FLIGHT, wander)


def _receiver(
    state: str,
    stamps: Sequence[Stamps],
    errors: Sequence[Array],
    fixes: Events,
    least: float,
    wander: float,
) -> Receiver | None:
    """Measure position and velocity errors, columns n, e, d of each, cut at gaps."""
    period = float(np.median(np.diff(fixes.t_ns))) * 1e-9
    parts: list[Array] = []
    for t_ns, values in zip(stamps, errors, strict=True):
        cuts = np.flatnonzero(np.diff(t_ns) * 1e-9 > EVEN * period) + 1
        parts += [part for part in np.split(values, cuts) if len(part) > 2]
    seconds = period * sum(map(len, parts))
    if seconds < least:
        return None

    def scatter(columns: slice, wander: float) -> Scatter | None:
        whole = [part[:, columns] for part in parts]
        return measure([one for one in whole if np.isfinite(one).all()], period, wander)

    stds = np.where(fixes.values[:, GNSS_STD] > 0.0, fixes.values[:, GNSS_STD], np.nan)
    stated = [float(np.nanmedian(std)) if np.isfinite(std).any() else np.nan for std in stds.T]
    return Receiver(
        state=state,
        seconds=seconds,
        horizontal=scatter(slice(0, 2), wander),
        height=scatter(slice(2, 3), wander),
        velocity=scatter(slice(3, 5), 0.0),
        stated=(stated[0], stated[1], stated[2]),
    )


def _frame(fixes: Events) -> LocalFrame:
    lat, lon, alt = np.median(fixes.values[:, GNSS_POSITION], axis=0)
    return LocalFrame(float(lat), float(lon), float(alt))


def _ned(frame: LocalFrame, fixes: Events) -> Array:
    return frame.to_ned(*fixes.values[:, GNSS_POSITION].T)


def _antenna(events: Events, table: Table, settings: FilterSettings) -> tuple[Array, Array, Array]:
    """Return the antenna's path, m, velocity and change of velocity, m/s, at every estimate.

    North, east, down. The path is the integral of the estimated velocity; the change of velocity is
    the integral of the specific force, rotated by the estimated attitude, and gravity. Both include
    the effect of the lever arm.
    """
    step = np.diff(table.stamp_ns, prepend=table.stamp_ns[:1])[:, None] * 1e-9
    velocity = np.nan_to_num(table.columns(VELOCITY))
    way = np.cumsum(0.5 * (velocity + np.roll(velocity, 1, axis=0)) * step, axis=0)
    t_ns, values = rest.samples(events)
    force_b = values[np.minimum(np.searchsorted(t_ns, table.stamp_ns), len(t_ns) - 1), 3:]
    force_b = force_b - np.nan_to_num(table.columns(ACCEL_BIAS))
    q_nb = np.nan_to_num(table.columns(QUATERNION))
    accel_n = so3.rotate(q_nb, force_b) + np.array([0.0, 0.0, STANDARD_GRAVITY])
    arm_b = np.broadcast_to(np.array(settings.gnss.lever_arm), (len(table), 3))
    arm_n = so3.rotate(q_nb, arm_b)
    swing_n = np.diff(arm_n, axis=0, prepend=arm_n[:1]) / np.maximum(step, 1e-6)
    return way + arm_n, velocity + swing_n, np.cumsum(accel_n * step, axis=0) + swing_n
