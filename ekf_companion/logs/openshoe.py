"""Inertial samples as the OpenShoe recorder wrote them: text, a MicroStrain 3DM-GX2 in a shoe.

A row is ``0xcb``, specific force x y z (g), rate x y z (rad/s), the sensor's counter, a checksum
that may be blank (so that all that follows stands one field further left), a number, three times
of the host (s since 1970), a rate (Hz) and the magnetic field. Only the first seven fields have a
place that is certain. The sensor's z axis points up: x stays forward, y and z change their sign.

The host's times jitter by milliseconds, the sensor does not: samples are laid an equal time apart,
that of the host's times from first to last, or 4 ms where there are none.

Source: header of the file; Nilsson, Skog, Haendel, Hari 2012, "Foot-mounted INS for everybody".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording
from ekf_companion.logs.source import read_bytes
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events, Kind

KIND = "OpenShoe text log"
MARK = b"0xcb"
"""With which a row of samples begins."""
NOMINAL = 0.004
"""From one sample to the next where no times are, s: 250 Hz."""
EPOCH = (1e9, 1e10)
"""Between these a number is a time of the host, s: 2001 to 2286; a counter has no point."""
LONGEST = 0.1
"""A mean step of the host's times beyond this, or none, is not the sensor's, s."""


def read(path: Path) -> Recording:
    """Read a log.

    Raises:
        LogError: The file is missing, empty, some other text, or holds no whole row.
    """
    lines = read_bytes(path, KIND).splitlines()
    rows = [fields for line in lines if (fields := line.split()) and fields[0].lower() == MARK]
    if not rows:
        raise LogError(
            f"{path}: no line begins with {MARK.decode()}, so this is no {KIND}; other text is "
            "read as .csv, with a header or a .columns.yaml beside it"
        )
    samples: list[tuple[float, ...]] = []
    times: list[float] = []
    for fields in rows:
        if (sample := _sample(fields)) is not None:
            samples.append(sample)
            times.append(_time(fields))
    if not samples:
        raise LogError(f"{path}: none of {len(rows)} rows is whole; record or download it again")
    step, is_measured = _step(np.array(times))
    notes = []
    if cut := len(rows) - len(samples):
        notes.append(f"{cut} rows that were cut short or damaged were dropped")
    if not is_measured:
        notes.append(f"no times of the host: samples taken to be {1.0 / NOMINAL:g} per second")
    values = np.array(samples)
    turn = np.array([1.0, -1.0, -1.0])
    t_ns = np.rint(np.arange(len(values)) * step * 1e9).astype(np.int64)
    events = Events.from_columns(
        t_ns, Kind.IMU, *(values[:, 3:6] * turn).T, *(values[:, 0:3] * turn * STANDARD_GRAVITY).T
    )
    return Recording(family="unknown", events=events, notes=tuple(notes))


def _sample(fields: list[bytes]) -> tuple[float, ...] | None:
    """Give the six readings of a row; None: it does not reach beyond them, or is no number."""
    # The last of the six may have lost its end if nothing follows it.
    if len(fields) < 8:
        return None
    try:
        sample = tuple(float(field) for field in fields[1:7])
    except ValueError:
        return None
    return sample if np.isfinite(sample).all() else None


def _time(fields: list[bytes]) -> float:
    """Give the first time of the host in a row, wherever it stands; NaN: none."""
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


def _step(times: np.ndarray) -> tuple[float, bool]:
    """Give the time from one sample to the next, s, and whether it was measured."""
    known = np.flatnonzero(np.isfinite(times))
    if len(known) < 2:
        return NOMINAL, False
    few = min(len(known) // 2, 100)
    first, last = known[:few], known[-few:]
    across = float(np.median(last) - np.median(first))
    step = float(np.median(times[last]) - np.median(times[first])) / across
    return (step, True) if 0.0 < step < LONGEST else (NOMINAL, False)
