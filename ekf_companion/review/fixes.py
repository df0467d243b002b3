"""Whether the positions, velocities and heights of a recording agree: their units, signs and order.

The statistic: over spans of 3, 10 and 30 s in which the vehicle moved by ``FAR`` or more, the
median distance between a displacement and the velocity integrated over the same span, divided by
the median displacement. Of fixes that are declared right it is the noise of a receiver over that
way: at most 0.15 in 30 recordings, from hovers to fixed wings, but for 0.5 over 30 s in a noisy
one. A wrong unit, sign or order leaves 0.5 and more, and right ones in its place what noise
leaves: so it is named if it fits within a quarter, three times as well as what was declared. A
vehicle that moves by no more than its receiver's noise shows nothing, and nothing is said.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, known_rows
from ekf_companion.nav.earth import radii
from ekf_companion.nav.measurements import GNSS_POSITION, GNSS_VELOCITY, Events

LAGS = (3.0, 10.0, 30.0)
"""Spans, s: short for those who turn, long for those who creep."""
FAR = 5.0
"""m within a span: more than the noise of a receiver in the open."""
FEWEST = 10
"""Spans, each a second after the one before."""
FITS = 0.25
"""Statistic up to which a unit, sign or order fits."""
BETTER = 3.0
"""Factor between the statistics of what was declared and of what fits."""
LONGEST_GAP = 3.0
"""Seconds between fixes over which a velocity may be integrated."""
LARGEST = 1e9
"""A number beyond is damaged, in whatever unit."""
NOWHERE = (0.05, 1.6, 3.2)
"""deg from latitude and longitude 0: beyond the first, and within the others, is only ocean."""

_SPEEDS = {
    "km/h": 3.6,
    "mph": 2.236936,
    "knots": 1.943844,
    "ft/s": 3.280840,
    "cm/s": 100.0,
    "mm/s": 1000.0,
}
_LENGTHS = {"km": 1e-3, "feet": 3.280840, "cm": 100.0, "mm": 1000.0}
"""Size of a metre per second, or of a metre, in each."""


class _Reading(NamedTuple):
    """Fixes as they may have been meant."""

    sentence: str
    pos: Array
    """m, shape (n, d)."""
    way: Array
    """Integrated velocity, m, shape (n, d)."""


def disagreements(fixes: Events, baro: Events | None = None) -> list[str]:
    """Return a sentence for each thing about fixes that cannot be meant.

    Args:
        fixes: Of ``Kind.GNSS``, in the order of their stamps.
        baro: Of ``Kind.BARO``, likewise.
    """
    t, lat, lon, way = _horizontal(fixes)
    found = _of_motion(t, lat, lon, way)
    return [found] if found else [one for one in _of_heights(fixes, baro) if one]


def suspicion(fixes: Events) -> str:
    """Return a sentence if positions may be radians under the name of degrees; empty: no."""
    degrees = np.rad2deg(np.abs(fixes.values[:, :2]))
    degrees = degrees[known_rows(degrees)]
    least, lat, lon = NOWHERE
    if not len(degrees) or degrees.max() < least:
        return ""
    if degrees[:, 0].max() > lat or degrees[:, 1].max() > lon:
        return ""
    t, *place, way = _horizontal(fixes)
    declared = _Reading("", _north_east(*place), way)
    if any(_error(declared, *_moving(t, declared, lag)) < FITS for lag in LAGS):
        return ""
    return (
        "gnss: the positions lie in the ocean south of Ghana, within 1.6 deg of latitude 0 and 3.2 "
        "deg of longitude 0: if they are radians, name them lat_rad and lon_rad"
    )


def _horizontal(fixes: Events) -> tuple[Array, Array, Array, Array]:
    """Return times, s, latitude and longitude, rad, and integrated velocity, m, where known."""
    t, vel = np.asarray(fixes.t_ns * 1e-9), fixes.values[:, GNSS_VELOCITY][:, :2]
    known = known_rows(fixes.values[:, GNSS_POSITION]) & known_rows(vel)
    known &= (np.abs(vel) < LARGEST).all(axis=1) & (np.abs(fixes.values[:, :2]) < LARGEST).all(
        axis=1
    )
    known &= np.diff(t, prepend=-np.inf) > 0.0
    t, vel = t[known], vel[known]
    return t, fixes.values[known, 0], fixes.values[known, 1], _integrated(t, vel)


def _of_motion(t: Array, lat: Array, lon: Array, way: Array) -> str:
    """Return what is wrong with horizontal velocities or positions; empty: nothing."""
    pos = _north_east(lat, lon)
    readings = [
        _Reading(
            f"gnss: the velocities are {size:.4g} times as fast as the positions move: they look "
            f"like {unit}; give m/s",
            pos,
            way / size,
        )
        for unit, size in _SPEEDS.items()
    ]
    exchanged = "gnss: the positions and velocities fit each other if {}; {}"
    order = "velocities are north, east, down (not east, north, up)"
    sign = "latitudes are positive north, longitudes positive east, velocities north, east, down"
    for signs, which in (((-1, 1), "north"), ((1, -1), "east"), ((-1, -1), "north and of east")):
        what = f"one has the other sign of {which}"
        readings.append(_Reading(exchanged.format(what, sign), pos, way * signs))
    what = "north and east of the velocities are exchanged"
    readings.append(_Reading(exchanged.format(what, order), pos, way[:, ::-1]))
    if len(lon) and np.abs(lon).max() <= np.pi / 2.0:
        what = "latitude and longitude are exchanged"
        readings.append(_Reading(exchanged.format(what, sign), _north_east(lon, lat), way))
    if len(lat) and np.rad2deg(np.abs(lat)).max() <= np.pi / 2.0:
        pos_rad = _north_east(np.rad2deg(lat), np.rad2deg(lon))
        sentence = (
            "gnss: the positions move 57 times too little for the velocities: latitude and "
            "longitude look like radians; name them lat_rad and lon_rad"
        )
        readings.append(_Reading(sentence, pos_rad, way))
    return _best(t, _Reading("", pos, way), readings)


def _of_heights(fixes: Events, baro: Events | None) -> list[str]:
    """Return what is wrong with heights by the vertical velocity and by the barometer."""
    alt, down = fixes.values[:, 2], fixes.values[:, 5]
    known = (np.abs(alt) < LARGEST) & (np.diff(fixes.t_ns, prepend=-1) > 0)
    t, alt, down = np.asarray(fixes.t_ns[known] * 1e-9), alt[known], down[known]
    sizes: dict[str, float] = {}
    if (has_down := np.abs(down) < LARGEST).any():
        climb = -_integrated(t[has_down], down[has_down, None])[:, 0]
        sizes["the vertical velocity"] = _size(t[has_down], alt[has_down], climb)
    if baro is not None and (of_baro := np.abs(baro.values[:, 0]) < LARGEST).any() and len(t):
        stamps = baro.t_ns[of_baro] * 1e-9
        height = np.interp(t, stamps, baro.values[of_baro, 0])
        # Outside the barometer's time there is nothing to compare with
        inside = (t >= stamps[0]) & (t <= stamps[-1])
        sizes["the barometer's height"] = _size(t[inside], alt[inside], height[inside])
    wrong = {name: size for name, size in sizes.items() if size != 1.0}
    if not wrong:
        return []
    size, names = next(iter(wrong.values())), " and ".join(wrong)
    if size < 0.0:
        return [
            f"gnss: alt falls as {names} rises: heights are positive upwards, the third column of "
            "vel_n downwards"
        ]
    of_alt = f"alt looks like {_unit(size)}" if _unit(size) else ""
    per = "/s" if "velocity" in names else ""
    of_other = f"{names} looks like {_unit(1.0 / size)}{per}" if _unit(1.0 / size) else ""
    # Of three, the one that contradicts both others is wrong
    if len(sizes) == 2:
        of_alt, of_other = (of_alt, "") if len(wrong) == 2 else ("", of_other)
    looks = ", or ".join(filter(None, (of_alt, of_other))) or "one is in another unit"
    return [f"gnss: alt moves {size:.4g} times as much as {names}: {looks}; give m and m/s"]


def _size(t: Array, alt: Array, other: Array) -> float:
    """Return how many times as much the fixes' height, m, moves as another; 1 if they agree."""
    sizes = [-1.0, *_LENGTHS.values(), *(1.0 / size for size in _LENGTHS.values())]
    readings = [_Reading(str(size), alt[:, None] / size, other[:, None]) for size in sizes]
    return float(_best(t, _Reading("1", alt[:, None], other[:, None]), readings) or 1.0)


def _unit(size: float) -> str:
    """Return the unit of which a metre has so many; empty: none."""
    return next((unit for unit, one in _LENGTHS.items() if abs(size / one - 1.0) < 0.01), "")


def _best(t: Array, declared: _Reading, readings: list[_Reading]) -> str:
    """Return the sentence of the reading that fits where the declared one does not.

    Over the spans in which the vehicle moved as it reads: of metres taken for feet, those that a
    receiver's noise makes long would be next to none.
    """
    for lag in LAGS:
        fitting = []
        for reading in readings:
            first, last = _moving(t, reading, lag)
            error = _error(reading, first, last)
            if error < FITS and _error(declared, first, last) > BETTER * error:
                fitting.append((error, reading.sentence))
        if fitting:
            return min(fitting)[1]
    return ""


def _moving(t: Array, reading: _Reading, lag: float) -> tuple[Indices, Indices]:
    """Return first and last index of the spans in which the vehicle moved."""
    first, last = _spans(t, lag)
    moved = np.maximum(_lengths(reading.pos, first, last), _lengths(reading.way, first, last))
    return first[moved > FAR], last[moved > FAR]


def _error(reading: _Reading, first: Indices, last: Indices) -> float:
    """Return the statistic of a reading; infinite if it does not move, or too seldom."""
    if len(first) < FEWEST:
        return float("inf")
    pos, way = (part[last] - part[first] for part in (reading.pos, reading.way))
    size = float(np.median(np.linalg.norm(pos, axis=1)))
    return float(np.median(np.linalg.norm(pos - way, axis=1))) / size if size > 0.0 else np.inf


def _lengths(part: Array, first: Indices, last: Indices) -> Array:
    return np.asarray(np.linalg.norm(part[last] - part[first], axis=1))


def _spans(t: Array, lag: float) -> tuple[Indices, Indices]:
    """Return first and last index of spans without a gap, one that begins each second."""
    if len(t) < 2 or t[-1] - t[0] <= lag:
        nothing = np.zeros(0, dtype=np.int64)
        return nothing, nothing
    # The first fix of each second
    first = np.flatnonzero(np.diff(np.floor(t - t[0]), prepend=-1.0) > 0.0)
    last = np.searchsorted(t, t[first] + lag)
    first, last = first[last < len(t)], last[last < len(t)]
    gaps = np.cumsum(np.diff(t, prepend=t[0]) > LONGEST_GAP)
    whole = gaps[first] == gaps[last]
    return first[whole], last[whole]


def _integrated(t: Array, vel: Array) -> Array:
    """Return the way from the first row on, by trapezia, shape of the velocity."""
    steps = 0.5 * (vel[1:] + vel[:-1]) * np.diff(t)[:, None]
    return np.concatenate([np.zeros_like(vel[:1]), np.cumsum(steps, axis=0)])


def _north_east(lat: Array, lon: Array) -> Array:
    """Return positions north and east of the first, m, on the sphere that fits there."""
    if not len(lat):
        return np.zeros((0, 2))
    meridian, normal = radii(lat[0])
    east = so3.wrap(lon - lon[0]) * np.cos(lat) * normal
    return np.stack([(lat - lat[0]) * meridian, east], axis=1)
