"""Decide what the stamps of scans and the times of points count, and from where."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.order import untangle
from ekf_companion.lidar.readers.source import Source, StoredScan
from ekf_companion.lidar.readers.survey import Survey, is_return
from ekf_companion.lidar.readers.units import LENGTH, SECONDS, nearest
from ekf_companion.lidar.recording import Scan
from ekf_companion.nav.arrays import Array, Indices

USUAL_RANGE = 10.0
"""m: half the returns in a room are nearer than 5, in the open than 50."""
USUAL_PERIOD = 0.1
"""s: lidars turn at 5 to 20 Hz."""


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """How a stored scan becomes one with a stamp of its start and times after it."""

    stamp_unit: float
    """s."""
    time_unit: float
    """s."""
    period: float
    """s, from scan to scan."""
    origin: str
    """Of the points' times: `stamp`, `clock` (absolute), `own` (another clock), or `none`."""
    low: float
    """s, of the first points after the stamp."""
    high: float
    """s, of the last ones."""
    length_unit: float
    """m."""
    shift: float = 0.0
    """s, added to the stamps."""
    reverse: bool = False
    """Whether the points' times count backwards."""
    speed_unit: float = 1.0
    """m/s, of radial speeds; negative where they are positive towards the sensor."""

    def apply(self, stored: StoredScan) -> Scan:
        """Return a scan with its returns alone, and its times from its start on."""
        keep = is_return(stored)
        stamp = stored.stamp / round(1.0 / self.stamp_unit)
        if self.origin == "none" or stored.times is None:
            times = np.zeros(len(stored.points))
        else:
            times = self._after(stored, stamp)
            keep = keep & (np.abs(times - 0.5 * (self.low + self.high)) < self.reach())
        times = times[keep]
        if self.reverse:
            times = self.low + self.high - times
        start = float(times.min()) if len(times) else 0.0
        if self.low < -0.25 * self.period or (self.reverse and start < 0):
            stamp, times = stamp + start, times - start
        points = stored.points[keep].astype(np.float64)
        if self.length_unit != 1.0:
            points *= self.length_unit
        ring = None if stored.ring is None else stored.ring[keep]
        speed = None
        if stored.doppler is not None:
            speed = stored.doppler[keep].astype(np.float64) * self.speed_unit
        return Scan(stamp + self.shift, points, times, ring, speed)

    def reach(self) -> float:
        """Return how far from its middle a point of a scan can be, s: a scan is one period."""
        return 0.55 * max(self.period, self.high - self.low)

    def _after(self, stored: StoredScan, stamp: float) -> Array:
        """Return the times of points after the stamp, s; NaN stays NaN."""
        times = stored.times
        assert times is not None
        if self.origin == "stamp" or not len(times):
            # Divided, as n / 1e9 is the nearest number to n nanoseconds and n * 1e-9 is not
            relative: Array = times.astype(np.float64) / round(1.0 / self.time_unit)
            return relative
        # Differences first: nanoseconds since 1970 have no room in a double
        first = np.nanmin(times)
        after: Array = (times - first).astype(np.float64) / round(1.0 / self.time_unit)
        if self.origin == "own":
            return after
        return after + (float(first) * self.time_unit - stamp)


def decide_timing(
    source: Source, found: Survey, stamp: str | None, *, by_doppler: bool = False
) -> tuple[Timing, Indices, list[str]]:
    """Return how times count, which scans to read in which order, and sentences about it.

    The scan of a radar counts as taken at its stamp: it takes a part of the time between two only.

    Raises:
        LogError: There are no scans, or their stamps cannot be meant.
    """
    what = f"{source.name}: the scans"
    if not len(found.stamp):
        raise LogError(f"{source.name}: no scans in it; is it the right file, or topic?")
    if not found.returns.any():
        raise LogError(
            f"{what} are empty, all {len(found.stamp)} of them: no point is finite and nonzero"
        )
    order, sentences = _order(source, found)
    if len(order) < 2:
        raise LogError(
            f"{what} have {len(order)} different stamps, two at least are needed: "
            "the driver writes no stamps, or the recording was cut"
        )
    stamps = found.stamp[order]
    step = float(np.median(np.diff(stamps)))
    unit = source.stamp_unit or nearest(step, USUAL_PERIOD, SECONDS)
    period = step * unit
    if source.stamp_unit is None and unit != 1.0:
        sentences.append(f"stamps of scans are {SECONDS[unit]}, not seconds")
    sentences.append(f"{len(order)} scans, one in {period * 1e3:.1f} ms")
    jitter = 1.4826 * float(np.median(np.abs(np.diff(stamps) - step))) * unit / np.sqrt(2.0)
    if jitter > 0.01 * period:
        sentences.append(
            f"stamps of scans jitter by {jitter * 1e3:.1f} ms: no sensor is so uneven, they are "
            "times of arrival"
        )
    gaps = np.flatnonzero(np.diff(stamps) > 1.5 * step)
    if len(gaps):
        lost = (stamps[gaps + 1] - stamps[gaps]) * unit - period
        sentences.append(
            f"scans are missing {len(gaps)} times, {lost.sum():.1f} s in all (first at "
            f"{(stamps[gaps[0]] - stamps[0]) * unit:.1f} s)"
        )
    if by_doppler:
        length, said = _length(found, order)
        plain = Timing(unit, 1.0, period, "none", 0.0, 0.0, length)
        return plain, order, sentences + said
    timing, more = _of_points(source, found, order, unit, period)
    return _place(timing, stamp, more), order, sentences + more


def _order(source: Source, found: Survey) -> tuple[Indices, list[str]]:
    """Return the scans to read in the order of their stamps: each stamp once, none empty."""
    sentences = list[str]()
    stamp = found.stamp
    bad = ~np.isfinite(stamp)
    if bad.any():
        sentences.append(
            f"{bad.sum()} scans have no finite stamp (the first is scan "
            f"{np.flatnonzero(bad)[0]}): left out"
        )
    empty = (found.returns == 0) & ~bad
    if empty.any():
        sentences.append(
            f"{empty.sum()} scans are empty (the first is scan "
            f"{np.flatnonzero(empty)[0]}): left out"
        )
    order = np.flatnonzero(~bad & ~empty)
    kept, words = untangle(stamp[order], "scans")
    order = order[kept]
    sentences += words
    again = np.zeros(len(order), bool)
    steps = np.diff(stamp[order])
    # Two scans cannot begin within a tenth of one
    again[1:] = steps <= 0.1 * np.median(steps)
    if again.any():
        twins = int((again[1:] & (np.diff(found.digest[order]) == 0)).sum())
        first = int(order[np.flatnonzero(again)[0]])
        alike = (
            "copies of the one before"
            if twins == again.sum()
            else (f"other points in {again.sum() - twins}: their own stamp is lost")
        )
        sentences.append(
            f"{again.sum()} scans repeat the stamp of another (the first is scan {first}; "
            f"{alike}): left out"
        )
    return order[~again], sentences


def _length(found: Survey, order: Indices) -> tuple[float, list[str]]:
    """Return the unit of points, m, and a sentence where it is not the metre."""
    reach = float(np.nanmedian(found.reach[order]))
    length = nearest(reach, USUAL_RANGE, LENGTH)
    if length == 1.0:
        return length, []
    return length, [f"points are in {LENGTH[length]} (median range {reach:.0f}), not metres"]


def _of_points(
    source: Source, found: Survey, order: Indices, unit: float, period: float
) -> tuple[Timing, list[str]]:
    """Return the timing of points, as the values alone show it."""
    length, said = _length(found, order)
    plain = Timing(unit, 1.0, period, "none", 0.0, 0.0, length)
    name = source.time_field
    if not found.has_times:
        return plain, [
            *said,
            "points have no time of their own: a scan counts as taken at once, in its middle, and "
            "motion within it is not undone; have the driver write the time of each point",
        ]
    times = found.times[order]
    times = times[np.isfinite(times).all(axis=1)]
    stamps = found.stamp[order][np.isfinite(found.times[order]).all(axis=1)] * unit
    span = float(np.median(times[:, 3] - times[:, 1])) / 0.9
    if span <= 0:
        return plain, [*said, f"the points' times ({name}) are equal within a scan: not used"]
    tick = source.time_unit or nearest(span, period, SECONDS)
    middle = times[:, 2] * tick
    sentences = said
    # From the stamp, from the clock's origin, or from elsewhere: which is nearest
    if np.median(np.abs(middle)) <= 2 * period:
        origin, after = "stamp", times * tick
        counted = "after the stamp"
    elif np.median(np.abs(middle - stamps)) <= 2 * period:
        origin, after = "clock", times * tick - stamps[:, None]
        counted = "on the clock of the stamps"
    else:
        origin, after = "own", (times - times[:, :1]) * tick
        counted = (
            f"on another clock, {np.median(middle - stamps):.3f} s from the stamps: "
            "counted from the first point of each scan"
        )
    low, high = float(np.median(after[:, 1])), float(np.median(after[:, 3]))
    # The outer tenths hold as much as the inner ones
    low, high = low - (high - low) / 18, high + (high - low) / 18
    sentences.append(
        f"times of points ({name}) are {SECONDS[tick]} {counted}, {span * tick * 1e3:.1f} ms a scan"
    )
    timing = Timing(unit, tick, period, origin, low, high, length)
    centre = 0.5 * (low + high)
    wide = np.maximum(after[:, 4] - centre, centre - after[:, 0]) > timing.reach()
    if wide.any():
        sentences.append(
            f"{wide.sum()} scans have points with times outside the scan: those points are left out"
        )
    return timing, sentences


def _place(timing: Timing, stamp: str | None, sentences: list[str]) -> Timing:
    """Return the timing with the stamps at the start of the scans, by the values or as asked."""
    where = ("end", "middle", "start")[
        int(
            np.argmin([abs(timing.low + timing.high - side * timing.period) for side in (-1, 0, 1)])
        )
    ]
    if timing.origin == "none" or stamp is not None:
        where = stamp or "start"
        sentences.append(f"stamps are taken as of the {where} of a scan")
        back = {"start": 0.0, "middle": 0.5, "end": 1.0}[where]
        # Times that are negative say the same already
        if timing.low > -0.25 * timing.period:
            middle = 0.5 if timing.origin == "none" else 0.0
            timing = replace(timing, shift=(middle - back) * timing.period)
    else:
        sentences.append(f"stamps are of the {where} of a scan by the points' times")
    return timing
