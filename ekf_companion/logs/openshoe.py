"""Reading of OpenShoe text logs: the inertial samples of a MicroStrain 3DM-GX2 in a shoe.

A row is ``0xcb``, specific force x y z (g), rate x y z (rad/s), the sensor's counter, a checksum
that may be blank (then all later fields move one to the left), a number, three times of the host
(s since 1970), a rate (Hz) and the magnetic field. Only the first seven fields are always in the
same place. The sensor's z axis points up: x stays forward, y and z change their sign.

The host's times jitter by milliseconds, the sensor does not: samples get equal steps of time, by
the host's times from first to last, or of 4 ms where there are none; missing samples leave a gap.
The counter, which begins anew about once a second, shows how many are missing; of more than a
second the host's time shows it.

Source: header of the file; Nilsson, Skog, Haendel, Hari 2012, "Foot-mounted INS for everybody".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording
from ekf_companion.logs.source import read_bytes
from ekf_companion.nav.arrays import Indices
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events, Kind

KIND = "OpenShoe text log"
MARK = b"0xcb"
"""The first field of a row of samples."""
NOMINAL = 0.004
"""Step from sample to sample where there are no times, s: 250 Hz."""
EPOCH = (1e9, 1e10)
"""Range of the host's times, s: 2001 to 2286. A counter has no decimal point."""
LONGEST = 0.1
"""Largest usual step of the host's times that can be the sensor's, s."""
HOLE = 0.1
"""Jump of the host's time, s, that means missing samples: it jitters by less."""
MANY = 250
"""Samples on either side that distinguish such a jump from a single late time."""
EVEN = 0.05
"""Largest fraction of a step by which the counter may miss a whole number of steps."""
UNEVEN = 0.02
"""Largest share of steps that may miss it by more."""
FEW = 50
"""Samples on either side by which the jump is measured."""


def read(path: Path) -> Recording:
    """Read a log.

    Raises:
        LogError: The file is missing, empty, some other text, or holds no complete row.
    """
    lines = read_bytes(path, KIND).splitlines()
    rows = [fields for line in lines if (fields := line.split()) and fields[0].lower() == MARK]
    if not rows:
        raise LogError(
            f"{path}: no line begins with {MARK.decode()}, so this is no {KIND}; other text is "
            "read as .csv, with a header or a .columns.yaml beside it"
        )
    whole = [
        (sample, _time(fields), _counter(fields))
        for fields in rows
        if (sample := _sample(fields)) is not None
    ]
    if not whole:
        raise LogError(f"{path}: none of {len(rows)} rows is whole; record or download it again")
    samples, times, counters = zip(*whole, strict=True)
    index = _numbers(np.array(counters))
    stamps, is_measured, holes = _clock(np.array(times), index)
    holes += int(np.count_nonzero(np.diff(index) > 1))
    notes = []
    if cut := len(rows) - len(samples):
        notes.append(f"{cut} rows that were cut short or damaged were dropped")
    if not is_measured:
        notes.append(f"no times of the host: samples taken to be {1.0 / NOMINAL:g} per second")
    if holes:
        notes.append(
            f"samples are missing at {holes} places, by the sensor's counter or the host's time"
        )
    values = np.array(samples)
    turn = np.array([1.0, -1.0, -1.0])
    t_ns = np.rint(stamps * 1e9).astype(np.int64)
    events = Events.from_columns(
        t_ns, Kind.IMU, *(values[:, 3:6] * turn).T, *(values[:, 0:3] * turn * STANDARD_GRAVITY).T
    )
    return Recording(family="unknown", events=events, notes=tuple(notes))


def _sample(fields: list[bytes]) -> tuple[float, ...] | None:
    """Return the six readings of a row, or None if it ends at them or one is no number."""
    # The last of the six may have lost its end if nothing follows it.
    if len(fields) < 8:
        return None
    try:
        sample = tuple(float(field) for field in fields[1:7])
    except ValueError:
        return None
    return sample if np.isfinite(sample).all() else None


def _time(fields: list[bytes]) -> float:
    """Return the first time of the host in a row, NaN if there is none."""
    for field in fields[7:13]:
        if b"." not in field:
            continue
        try:
            time = float(field)
        except ValueError:
            continue
        if EPOCH[0] < time < EPOCH[1]:
            return time
    return float("nan")


def _counter(fields: list[bytes]) -> float:
    """Return the sensor's counter in a row, NaN if there is none."""
    try:
        return float(int(fields[7]))
    except ValueError:
        return float("nan")


def _numbers(counters: np.ndarray) -> Indices:
    """Return the number of each sample, with gaps where the counter shows that some are missing.

    Without a counter of equal steps they are numbered as they come.
    """
    plain = np.arange(len(counters))
    steps = np.diff(counters)
    on, anew = steps[steps > 0.0], steps[steps <= 0.0]
    if not np.isfinite(counters).all() or len(on) < 2:
        return plain
    tick = float(np.median(on))
    # Where it begins anew it has gone on by as much as it usually does
    steps = np.where(steps > 0.0, steps, steps - (np.median(anew) if len(anew) else 0.0) + tick)
    apart = steps / tick
    if np.mean(np.abs(apart - np.rint(apart)) > EVEN) > UNEVEN:
        return plain
    return np.concatenate([[0], np.cumsum(np.maximum(np.rint(apart), 1.0))]).astype(np.int64)


def _clock(times: np.ndarray, index: Indices) -> tuple[np.ndarray, bool, int]:
    """Return the stamps of the samples, s, whether they were measured, and the number of holes.

    The host's times are by sample, s, NaN where there is none; the holes are those beside the gaps
    in the samples' numbers.
    """
    known = np.flatnonzero(np.isfinite(times))
    if len(known) < 2:
        return index * NOMINAL, False, 0
    usual = _slope(index[known], times[known])
    if not 0.0 < usual < LONGEST:
        return index * NOMINAL, False, 0
    # Where the host's time jumps relative to the samples, and stays so, samples are missing
    off = times[known] - usual * index[known]
    holes = [
        cut
        for cut in np.flatnonzero(np.diff(off) > HOLE) + 1
        if np.median(off[cut : cut + MANY]) - np.median(off[max(cut - MANY, 0) : cut]) > HOLE
    ]
    spans = [
        _drift(index[part], times[part] - usual * index[part]) for part in np.split(known, holes)
    ]
    step = usual + sum(span[0] for span in spans) / max(sum(span[1] for span in spans), 1.0)
    stamps = index * step
    for cut in holes:
        before, after = known[max(cut - FEW, 0) : cut], known[cut : cut + FEW]
        late = [np.median(times[part] - step * index[part]) for part in (before, after)]
        gone = late[1] - late[0]
        stamps[known[cut] :] += gone
    if not (np.diff(stamps) > 0.0).all() or np.abs(stamps).max() > EPOCH[1] - EPOCH[0]:
        return index * NOMINAL, False, 0  # no clock runs like this
    return stamps, True, len(holes)


def _slope(rows: np.ndarray, times: np.ndarray) -> float:
    """Return the usual time from one row to the next, s; few of the pairs span a hole."""
    apart = min(max(len(rows) // 8, 1), MANY)
    return float(np.median((times[apart:] - times[:-apart]) / (rows[apart:] - rows[:-apart])))


def _drift(rows: np.ndarray, off: np.ndarray) -> tuple[float, float]:
    """Return the drift of the host's time from the first rows to the last, s, and over how many."""
    few = min(len(rows) // 2, 100)
    if few == 0:
        return 0.0, 0.0
    gone, apart = (float(np.median(each[-few:]) - np.median(each[:few])) for each in (off, rows))
    return gone, apart
