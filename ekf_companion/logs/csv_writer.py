"""Writing of estimates as comma-separated text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import orjson

from ekf_companion.logs.writer import STATUS_NAMES, EstimateWriter
from ekf_companion.nav.state import COLUMNS, Table

_STATUS = COLUMNS.index("status") - 1
_NAMES = [name.encode() for name in STATUS_NAMES]


class Writer(EstimateWriter):
    """Writes estimates as CSV, every number with enough digits to be read back to the bit."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.file.write(",".join(COLUMNS).encode() + b"\n")

    def write(self, table: Table) -> None:
        """Append a line for each estimate."""
        if len(table) == 0:
            return
        values = table.values
        # JSON prints the shortest digits that read back the same, and does it fast
        text = orjson.dumps(
            np.ascontiguousarray(values[:, :_STATUS]), option=orjson.OPT_SERIALIZE_NUMPY
        )
        bodies = text[2:-2].replace(b"null", b"").split(b"],[")
        stamps = orjson.dumps(table.stamp_ns // 1000, option=orjson.OPT_SERIALIZE_NUMPY)
        times = stamps[1:-1].split(b",")
        names = [_NAMES[status] for status in values[:, _STATUS].astype(int).tolist()]
        resets = values[:, _STATUS + 1].astype(int).tolist()
        lines = [b"%s,%s,%s,%d\n" % line for line in zip(times, bodies, names, resets, strict=True)]
        self.file.write(b"".join(lines))
