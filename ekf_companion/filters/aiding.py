"""Rows of a recording as observations: fixes, and the best of what shows north."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.observation import Azimuth, Observation, Position, Velocity
from ekf_companion.filters.strapdown import cross
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, GnssFlag, HeadingSource, Kind

Array = npt.NDArray[np.float64]
Timed = tuple[int, Observation]
"""Time, ns, and what was seen then."""


def fixes(ordered: Events, settings: FilterSettings) -> Events:
    """Return the fixes that count: the receiver's, or where it is silent the autopilot's own.

    Raises:
        LogError: There is none.
    """
    rows = ordered.take(ordered.kind == Kind.GNSS)
    flags = rows.values[:, 10].astype(int)
    is_good = np.isfinite(rows.values[:, :3]).all(axis=1) & np.isfinite(rows.values[:, 6:8]).all(
        axis=1
    )
    is_good &= (flags & GnssFlag.SUSPECT) == 0
    is_derived = (flags & GnssFlag.DERIVED) != 0
    source = settings.gnss.source
    own = rows.take(is_good & ~is_derived)
    if source == "global" or (source == "auto" and len(own) == 0):
        own = rows.take(is_good & is_derived)
    if len(own) == 0:
        raise LogError(
            "no GNSS fix: positions are needed here; zupt (of a walk) and ahrs do without, and "
            "eskf gives attitude and relative height"
        )
    return own


def of_fixes(
    rows: Events, rates_b: Array, frame: LocalFrame, settings: FilterSettings
) -> list[Timed]:
    """Return positions and velocities with their times.

    Args:
        rows: Fixes.
        rates_b: Angular rate at each, rad/s, shape (n, 3).
        frame: Of the positions.
        settings: Lever arm, floors of the noise.
    """
    found: list[Timed] = []
    gnss = settings.gnss
    lever = np.array(gnss.lever_arm)
    pos_n = frame.to_ned(*rows.values[:, :3].T)
    for i, t_ns in enumerate(rows.t_ns.tolist()):
        vel_n, (std_h, std_v, std_vel) = rows.values[i, 3:6], rows.values[i, 6:9].tolist()
        horizontal, vertical = max(std_h, gnss.position_std), max(std_v, gnss.height_std)
        std = np.array([horizontal, horizontal, vertical])
        found.append((t_ns, Position(pos_n=pos_n[i], std=std, lever_b=lever)))
        if not gnss.use_velocity or np.isnan(vel_n[:2]).any():
            continue
        std_vel = gnss.velocity_std_unknown if np.isnan(std_vel) else std_vel
        velocity = Velocity(
            vel_n=vel_n[:2] if np.isnan(vel_n[2]) else vel_n,
            std=max(std_vel, gnss.velocity_std),
            swing_b=cross(rates_b[i], lever),
        )
        found.append((t_ns, velocity))
    return found


def azimuths(ordered: Events, rows: Events, settings: FilterSettings) -> list[Timed]:
    """Return what shows north: of the sources that speak, the best.

    Another speaks where all that are better have been silent for ``gate.timeout_heading``.

    Args:
        ordered: The recording, stamps ascending.
        rows: Its fixes, of which the first says how the field of the place is.
        settings: Which sources, floors of the noise, time-out.

    Raises:
        LogError: None speaks.
    """
    wanted = settings.heading.source
    patience_ns = round(settings.gate.timeout_heading * 1e9)
    found: list[Timed] = []
    # Before its first word a source counts as silent since the recording began
    heard_ns = np.zeros(0, dtype=np.int64)
    for source in HeadingSource:
        if wanted not in ("auto", source.name.lower()):
            continue
        ways = [_headings(source, ordered, settings)]
        if source is HeadingSource.MAGNETOMETER:
            ways.append(_fields(ordered, rows, settings))
        for timed in ways:
            since = np.concatenate([ordered.t_ns[:1], heard_ns])
            chosen = [
                (t, aid)
                for t, aid in timed
                if not len(heard_ns)
                or t - since[np.searchsorted(heard_ns, t, side="right")] > patience_ns
            ]
            found += chosen
            heard_ns = np.array(sorted(t for t, _ in found), dtype=np.int64)
    if not found:
        raise LogError(
            "no heading: a magnetometer or another source of it is needed here "
            "(heading.source); eskf finds north from the motion"
        )
    return sorted(found, key=lambda one: one[0])


def _headings(source: HeadingSource, ordered: Events, settings: FilterSettings) -> list[Timed]:
    """Return the headings that a source tells."""
    rows = ordered.take((ordered.kind == Kind.HEADING) & (ordered.values[:, 2] == source))
    rows = rows.take(np.flatnonzero(np.isfinite(rows.values[:, :2]).all(axis=1)))
    floor = settings.heading.heading_std
    forward = np.array([1.0, 0.0, 0.0])
    return [
        (t, Azimuth(seen_b=forward, azimuth=angle, std=max(std, floor)))
        for t, (angle, std) in zip(rows.t_ns.tolist(), rows.values[:, :2].tolist(), strict=True)
    ]


def _fields(ordered: Events, fixes: Events, settings: FilterSettings) -> list[Timed]:
    """Return the directions of the fields that are the Earth's by their strength."""
    heading = settings.heading
    declination, _, dip, strength = fixes.values[0, 9:13].tolist()
    mag = ordered.take(ordered.kind == Kind.MAG)
    size = np.linalg.norm(mag.values[:, :3], axis=1)
    is_earths = np.isfinite(size) & (size > 0.0)
    if strength > 0.0:
        is_earths &= np.abs(size / strength - 1.0) <= heading.field_strength
    level = np.cos(dip) if np.isfinite(dip) else 0.5
    azimuth = declination if np.isfinite(declination) else 0.0
    found: list[Timed] = []
    for t, field, total in zip(
        mag.t_ns[is_earths].tolist(), mag.values[is_earths, :3], size[is_earths], strict=True
    ):
        noise = heading.magnetometer_noise / max(0.1, level) / total
        std = float(np.hypot(noise, heading.magnetometer_std))
        found.append((t, Azimuth(seen_b=field, azimuth=azimuth, std=std)))
    return found
