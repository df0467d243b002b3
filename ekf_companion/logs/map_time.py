"""Times as the formats of maps write them."""

from __future__ import annotations

import numpy as np

from ekf_companion.nav.arrays import Stamps


def utc(stamp_ns: Stamps) -> list[str]:
    """Return stamps as ``2026-11-22T19:00:00.123456Z``.

    A stamp that counts from the autopilot's boot becomes a time in 1970.
    """
    texts = np.datetime_as_string(stamp_ns.astype("datetime64[ns]"), unit="us")
    return [f"{text}Z" for text in texts.tolist()]
