"""The numbers of a flight: errors, way and speed, vibration and clipping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ekf_companion.analysis.gaps import GAP_NS
from ekf_companion.analysis.score import Score, score
from ekf_companion.logs.estimate import of_table
from ekf_companion.nav.arrays import Array, Indices, Stamps, known_rows
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import GEODETIC, VELOCITY, Status, Table, Trajectory
from ekf_companion.nav.wind import MeanWind
from ekf_companion.review import difference
from ekf_companion.review.track import SLOT_NS

LEG = 1.0
"""m; what moves less since the last corner of a way is the estimate that wanders at rest."""
SMOOTH_S = 0.2
"""The mean over such a time is motion, the rest is vibration: 5 Hz, as ArduPilot's VIBE has it."""
LEAST_RATE, LEAST_FORCE = 0.5, 11.5
"""rad/s and m/s^2: no sensor has a smaller range; as the estimator has it (core/trust/doubt.py)."""
SAME = 1e-4
"""Relative difference of two readings at the end of a range; likewise."""
STEEP = 0.01
"""Relative step to the reading beside them: the top of a smooth motion, which repeats itself too,
bends by less between two samples."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """How far and fast an estimate went; NaN: no position."""

    way: float
    """Over ground, without what lies in gaps and resets, m."""
    top_speed: float
    """Over ground, m/s."""
    height: float
    """From its lowest to its highest point, m."""
    wind: str = ""
    """Its mean, in words; empty: it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Vibration:
    """What inertial samples shake, and how often they are at the end of their range."""

    rate: float
    """Of the samples, Hz: vibration above half of it is not in them, or is folded."""
    accel: tuple[float, float, float]
    """RMS by axis, m/s^2."""
    gyro: tuple[float, float, float]
    """Likewise, rad/s."""
    worst: float
    """Largest RMS of a second of any axis of the accelerometer, m/s^2."""
    worst_ns: int
    """When that second began."""
    accel_clipped: int
    """Samples in which an axis repeats its largest reading: the end of its range."""
    gyro_clipped: int
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Numbers:
    """All of them."""

    errors: tuple[Score, ...]
    """Against each of what the estimate is compared with."""
    settled: bool
    """Whether the errors of the start are left out: ``difference.SETTLED_NS``."""
    motion: Motion
    vibration: Vibration | None
    """None: too few samples."""

    def to_dict(self) -> dict[str, Any]:
        """Return everything for JSON."""
        return {
            "errors": [one.to_dict() for one in self.errors],
            "motion": {f"{name}_{unit}": _known(value) for name, unit, value in self._motion()},
            "vibration": None if self.vibration is None else asdict(self.vibration),
        }

    def _motion(self) -> list[tuple[str, str, float]]:
        found = self.motion
        return [
            ("way", "m", found.way),
            ("top_speed", "mps", found.top_speed),
            ("height", "m", found.height),
        ]


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def numbers(table: Table, others: Sequence[Trajectory], events: Events) -> Numbers:
    """Return the numbers of a flight.

    Args:
        table: The estimates, on one clock.
        others: What they are compared with, on it too.
        events: The measurements, likewise.
    """
    kept = _ten_a_second(table)
    scores, is_settled = _scores(kept, others)
    return Numbers(
        errors=tuple(scores),
        settled=is_settled,
        motion=motion(kept),
        vibration=vibration(events),
    )


def _ten_a_second(table: Table) -> Table:
    """Return the rows that the verdict judges: whose estimate says that it is of use."""
    status = table.column("status")
    rows = np.flatnonzero((status >= Status.ATTITUDE) & (status != Status.INVALID))
    if len(rows):
        rows = rows[np.diff(table.stamp_ns[rows] // SLOT_NS, prepend=-1) != 0]
    return Table(stamp_ns=table.stamp_ns[rows], values=table.values[rows])


def _scores(table: Table, others: Sequence[Trajectory]) -> tuple[list[Score], bool]:
    """Return the errors once the estimate has settled; of a short flight, all of them."""
    if not len(table):
        return [], True
    ours = of_table(table, "ekf-companion")
    first = ours.pos_t_ns if len(ours.pos_t_ns) else ours.att_t_ns
    if not len(first):
        return [], True
    begins = (int(first[0]) + difference.SETTLED_NS, int(first[0]))
    for begin_ns in begins:
        found = [score(ours, other, start_ns=begin_ns) for other in others]
        found = [one for one in found if one.end_ns > one.start_ns]
        if found:
            return found, begin_ns == begins[0]
    return [], True


def motion(table: Table) -> Motion:
    """Return how far and fast a table went, of ten rows a second."""
    places = table.columns(GEODETIC)
    rows = np.flatnonzero(known_rows(places) & (table.column("status") >= Status.OK))
    if not len(rows):
        return Motion(way=np.nan, top_speed=np.nan, height=np.nan)
    places, resets = places[rows], table.column("reset_count")[rows]
    lat, lon = np.deg2rad(places[:, 0]), np.deg2rad(places[:, 1])
    ned = LocalFrame(float(lat[0]), float(lon[0]), float(places[0, 2])).to_ned(
        lat, lon, places[:, 2]
    )
    is_new = (np.diff(table.stamp_ns[rows]) > GAP_NS) | (np.diff(resets) != 0.0)
    speed = np.hypot(*table.columns(VELOCITY)[rows, :2].T)
    wind = MeanWind()
    wind.add(table)
    known = speed[np.isfinite(speed)]
    return Motion(
        way=_way(ned[:, :2], np.flatnonzero(is_new) + 1),
        top_speed=float(known.max()) if len(known) else np.nan,
        height=float(np.ptp(places[:, 2])),
        wind=wind.words,
    )


def _way(places: Array, begins: Indices) -> float:
    """Return the length of a way, m, which begins anew at some rows."""
    total, anew = 0.0, set(begins.tolist())
    north_0, east_0 = places[0].tolist()
    for row, (north, east) in enumerate(places.tolist()):
        step = ((north - north_0) ** 2 + (east - east_0) ** 2) ** 0.5
        if row in anew or step >= LEG:
            total += 0.0 if row in anew else step
            north_0, east_0 = north, east
    return float(total)


def vibration(events: Events) -> Vibration | None:
    """Return what the inertial samples shake."""
    imu = events.take((events.kind == Kind.IMU) & known_rows(events.values[:, :6]))
    steps = np.diff(imu.t_ns)
    if not (steps > 0).any():
        return None
    step = float(np.median(steps[steps > 0]))
    width = round(SMOOTH_S * 1e9 / step)
    if width < 3 or len(imu) < 10 * width:
        return None
    values, t_ns = imu.values[:, :6], imu.t_ns
    # The mean of means has no lobes: what is faster keeps its size within 5 %
    smooth = _means(_means(values, width), width)
    before, count = width - 1, len(smooth)
    shaken, at_ns = values[before : before + count] - smooth, t_ns[before : before + count]
    # A mean over a gap is none of motion
    spans = t_ns[2 * before :] - t_ns[:count]
    is_even = (spans > 0) & (spans < 3.0 * width * step)
    shaken, at_ns = shaken[is_even], at_ns[is_even]
    if not len(shaken):
        return None
    square = np.square(shaken)
    rms = np.sqrt(square.mean(axis=0)).tolist()
    worst, worst_ns = _worst_second(square[:, 3:], at_ns)
    return Vibration(
        rate=1e9 / step,
        gyro=(rms[0], rms[1], rms[2]),
        accel=(rms[3], rms[4], rms[5]),
        worst=worst,
        worst_ns=worst_ns,
        gyro_clipped=_clipped(values[:, :3], LEAST_RATE),
        accel_clipped=_clipped(values[:, 3:], LEAST_FORCE),
        samples=len(values),
    )


def _means(values: Array, width: int) -> Array:
    """Return the means of each so many consecutive rows."""
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values - values[0]]), axis=0)
    return np.asarray((sums[width:] - sums[:-width]) / width + values[0])


def _worst_second(square: Array, at_ns: Stamps) -> tuple[float, int]:
    """Return the largest RMS of a whole second of any axis, and when it began."""
    begins = np.flatnonzero(np.diff(at_ns // 1_000_000_000, prepend=-1))
    counts = np.diff(begins, append=len(at_ns))
    means = (np.add.reduceat(square, begins) / counts[:, None]).max(axis=1)
    means[counts < 0.5 * np.median(counts)] = 0.0
    worst = int(np.argmax(means))
    return float(np.sqrt(means[worst])), int(at_ns[begins[worst]])


def _clipped(values: Array, least: float) -> int:
    """Return in how many samples an axis repeats its largest reading, where that is large."""
    size = np.abs(values)
    is_at_end = (size > least) & (size >= size.max(axis=0) * (1.0 - SAME))
    is_clipped = np.zeros(len(values), dtype=bool)
    for axis in range(values.shape[1]):
        rows = np.flatnonzero(is_at_end[:, axis])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if len(run) < 2 or values[run[0], axis] * values[run[-1], axis] < 0.0:
                continue
            beside = values[[max(run[0] - 1, 0), min(run[-1] + 1, len(values) - 1)], axis]
            steps = np.abs(beside - values[run[0], axis])
            if steps.max() > STEEP * size[run[0], axis]:
                is_clipped[run] = True
    return int(np.count_nonzero(is_clipped))
