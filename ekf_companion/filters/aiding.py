"""Observations from the rows of a recording: fixes, and the best heading."""

from __future__ import annotations

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.observation import Azimuth, Observation, Position, Velocity
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, known_rows
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import (
    GNSS_DECLINATION,
    GNSS_FLAGS,
    GNSS_POSITION,
    GNSS_STD,
    GNSS_VELOCITY,
    Events,
    GnssFlag,
    HeadingSource,
    Kind,
)

Timed = tuple[int, Observation]
"""Time, ns, and observation."""


def fixes(ordered: Events, settings: FilterSettings) -> Events:
    """Return the usable fixes: the receiver's or, if there are none, the autopilot's own.

    Raises:
        LogError: There are no fixes.
    """
    rows = ordered.take(ordered.kind == Kind.GNSS)
    flags = rows.values[:, GNSS_FLAGS].astype(int)
    is_good = known_rows(rows.values[:, [0, 1, 2, 6, 7]])
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


def fix_observations(
    rows: Events, rates_b: Array, frame: LocalFrame, settings: FilterSettings
) -> list[Timed]:
    """Return positions (in the frame) and velocities of fixes.

    ``rates_b`` is the angular rate at each, rad/s, shape (n, 3).
    """
    found: list[Timed] = []
    gnss = settings.gnss
    lever = np.array(gnss.lever_arm)
    pos_n = frame.to_ned(*rows.values[:, GNSS_POSITION].T)
    for i, t_ns in enumerate(rows.t_ns.tolist()):
        vel_n, stds = rows.values[i, GNSS_VELOCITY], rows.values[i, GNSS_STD]
        std_h, std_v, std_vel = stds.tolist()
        horizontal, vertical = max(std_h, gnss.position_std), max(std_v, gnss.height_std)
        std = np.array([horizontal, horizontal, vertical])
        found.append((t_ns, Position(pos_n=pos_n[i], std=std, lever_b=lever)))
        if not gnss.use_velocity or np.isnan(vel_n[:2]).any():
            continue
        std_vel = gnss.velocity_std_unknown if np.isnan(std_vel) else std_vel
        velocity = Velocity(
            vel_n=vel_n[:2] if np.isnan(vel_n[2]) else vel_n,
            std=max(std_vel, gnss.velocity_std),
            swing_b=so3.cross(rates_b[i], lever),
        )
        found.append((t_ns, velocity))
    return found


def azimuths(ordered: Events, rows: Events, settings: FilterSettings) -> list[Timed]:
    """Return the headings of the best source present in a recording, stamps ascending.

    A worse source counts while all better ones have been silent for ``gate.timeout_heading``. The
    first of the fixes ``rows`` holds the field of the place.

    Raises:
        LogError: There is no source.
    """
    wanted = settings.heading.source
    patience_ns = round(settings.gate.timeout_heading * 1e9)
    found: list[Timed] = []
    # Before its first heading a source counts as silent since the recording began
    heard_ns = np.zeros(0, dtype=np.int64)
    for source in HeadingSource:
        if wanted not in ("auto", source.name.lower()):
            continue
        candidates = [_headings(source, ordered, settings)]
        if source is HeadingSource.MAGNETOMETER:
            candidates.append(_fields(ordered, rows, settings))
        for timed in candidates:
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
            "no heading: a magnetometer or another source of it is needed here (heading.source "
            "chooses it; from Python, give mag or heading, such as time and euler[:, 2] of an eskf "
            "run where they are known); eskf finds north from the motion"
        )
    return sorted(found, key=lambda one: one[0])


def _headings(source: HeadingSource, ordered: Events, settings: FilterSettings) -> list[Timed]:
    """Return the headings of a source."""
    rows = ordered.take((ordered.kind == Kind.HEADING) & (ordered.values[:, 2] == source))
    rows = rows.take(np.flatnonzero(known_rows(rows.values[:, :2])))
    floor = settings.heading.heading_std
    forward = np.array([1.0, 0.0, 0.0])
    return [
        (t, Azimuth(seen_b=forward, azimuth=angle, std=max(std, floor)))
        for t, (angle, std) in zip(rows.t_ns.tolist(), rows.values[:, :2].tolist(), strict=True)
    ]


def _fields(ordered: Events, fixes: Events, settings: FilterSettings) -> list[Timed]:
    """Return the azimuths of the magnetic fields whose strength is the Earth's."""
    heading = settings.heading
    declination, _, dip, strength = fixes.values[0, GNSS_DECLINATION:].tolist()
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
