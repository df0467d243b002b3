"""UTC of a log by its receiver: the median over the rows with a 3-D fix.

Before a fix a receiver sends the date of its firmware, or of its battery-backed clock, and for some
seconds after the first fix it may be off by the leap seconds. A receiver whose week number has
rolled over sends a date 1024 weeks early, which is before the firmware that wrote the log.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.logs.recording import CLOCK_SET_S
from ekf_companion.nav.arrays import Mask, Stamps

ROLLOVER_NS = 1024 * 604_800 * 1_000_000_000
"""Period of the ten-bit week number of GPS."""


def utc_zero_ns(
    utc_ns: Stamps, t_ns: Stamps, is_fix: Mask, earliest: str, notes: list[str]
) -> int | None:
    """Return the UTC at which a log's clock was zero, ns since 1970; None: not known.

    Args:
        utc_ns: UTC by the receiver, shape (n,); 0: not sent.
        t_ns: Stamps of the rows.
        is_fix: Whether a row holds a 3-D fix.
        earliest: Earliest date at which the log can have been written, ``2016-05``.
        notes: Receives a sentence if the receiver's date cannot be right.
    """
    known = is_fix & (utc_ns > CLOCK_SET_S * 1_000_000_000)
    if not known.any():
        return None
    # Not their mean: of such large numbers floats hold no ns
    offsets = np.sort(utc_ns[known] - t_ns[known])
    zero_ns = int(offsets[len(offsets) // 2])
    earliest_ns = int(np.datetime64(earliest, "ns").astype(np.int64))
    began_ns = zero_ns + int(t_ns[known][0])
    if began_ns >= earliest_ns:
        return zero_ns
    date = np.datetime_as_string(np.datetime64(began_ns, "ns"), unit="D")
    what = f"the receiver's date, {date}, is before the firmware that wrote this log ({earliest})"
    if began_ns + ROLLOVER_NS < earliest_ns:
        notes.append(f"{what}: it is not used, and times count from the boot")
        return None
    right = np.datetime_as_string(np.datetime64(began_ns + ROLLOVER_NS, "ns"), unit="D")
    notes.append(
        f"{what}: its count of GPS weeks began anew after 1024; {right} is taken, 1024 weeks later"
    )
    return zero_ns + ROLLOVER_NS
