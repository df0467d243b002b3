"""One pass over the scans that keeps a few numbers of each: what the recording as a whole shows."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from ekf_companion.lidar.readers.source import Source, Stored, StoredScan
from ekf_companion.nav.arrays import Array, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Numbers of each scan, in the recorded order."""

    stamp: Array
    """Of the header, as stored."""
    returns: Indices
    """Points that are finite and not 0 0 0."""
    times: Array
    """Lowest, 5 %, median, 95 % and highest of the points' times, as stored, shape (n, 5); NaN."""
    reach: Array
    """Median range of each scan, in the recording's unit; NaN."""
    digest: Indices
    """Equal for equal points."""
    has_times: bool
    """Whether any scan has times of its points that differ."""
    has_doppler: bool
    """Whether all scans have radial speeds."""
    has_speed: bool
    """Whether one of these is not 0: drivers of lidars leave such a field empty."""


def survey(source: Source) -> Survey:
    """Return the numbers of all scans of a source."""
    stamps, returns, times, reach, digests = [], [], [], [], []
    is_timed, has_doppler, has_speed = False, True, False
    for scan in source.scans():
        good = is_return(scan)
        has_doppler &= scan.doppler is not None
        has_speed |= scan.doppler is not None and bool(scan.doppler[good].any())
        stamps.append(scan.stamp)
        returns.append(int(good.sum()))
        quantiles = np.full(5, np.nan)
        if scan.times is not None and good.any():
            quantiles = _quantiles(scan.times[good])
            is_timed |= bool(quantiles[4] > quantiles[0])
        times.append(quantiles)
        points = scan.points[good]
        reach.append(float(np.median(np.linalg.norm(points, axis=1))) if len(points) else np.nan)
        digests.append(crc32(np.ascontiguousarray(points).view(np.uint8).data))
    return Survey(
        np.array(stamps, np.float64),
        np.array(returns, np.int64),
        np.array(times, np.float64).reshape(-1, 5),
        np.array(reach, np.float64),
        np.array(digests, np.int64),
        is_timed,
        has_doppler,
        has_speed,
    )


def _quantiles(times: Stored) -> Array:
    values = times[np.isfinite(times)].astype(np.float64)
    if not len(values):
        return np.full(5, np.nan)
    return np.percentile(values, (0, 5, 50, 95, 100))


def is_return(scan: StoredScan) -> Mask:
    """Return which points are returns: finite, and not the 0 0 0 of an organised cloud."""
    x, y, z = scan.points.T
    mask: Mask = np.isfinite(x + y + z) & ((x != 0) | (y != 0) | (z != 0))
    return mask if scan.doppler is None else mask & np.isfinite(scan.doppler)
