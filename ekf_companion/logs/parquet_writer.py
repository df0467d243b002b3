"""Writing of estimates as Parquet: units and frames stand in the columns' metadata."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from ekf_companion.logs.writer import STATUS_NAMES, EstimateWriter
from ekf_companion.nav import reason
from ekf_companion.nav.state import (
    ACCEL_BIAS,
    COLUMNS,
    EULER,
    GYRO_BIAS,
    POSITION,
    QUATERNION,
    SIGMA,
    VELOCITY,
    WIND,
    WIND_SIGMA,
    Table,
)
from ekf_companion.version import __version__

_LOCAL = "north-east-down of the origin"
_BODY = "body: forward-right-down"
_UNITS: dict[str, tuple[str, str]] = {
    "time_us": ("us", "the autopilot's clock"),
    "lat_deg": ("deg", "WGS-84"),
    "lon_deg": ("deg", "WGS-84"),
    "alt_m": ("m", "above mean sea level"),
    **dict.fromkeys(POSITION, ("m", _LOCAL)),
    **dict.fromkeys(VELOCITY, ("m/s", _LOCAL)),
    **dict.fromkeys(QUATERNION, ("1", "from body (forward-right-down) to north-east-down")),
    **dict.fromkeys(EULER, ("rad", "from north-east-down to body; yaw from true north")),
    **dict.fromkeys(GYRO_BIAS, ("rad/s", _BODY)),
    **dict.fromkeys(ACCEL_BIAS, ("m/s2", _BODY)),
    **dict.fromkeys(SIGMA[:3], ("m", f"{_LOCAL}, one sigma")),
    **dict.fromkeys(SIGMA[3:6], ("m/s", f"{_LOCAL}, one sigma")),
    **dict.fromkeys(SIGMA[6:], ("rad", "one sigma")),
    **dict.fromkeys(WIND, ("m/s", "where the air moves to")),
    **dict.fromkeys(WIND_SIGMA, ("m/s", "one sigma")),
    "status": ("", "how far the estimate can be trusted"),
    "reset_count": ("1", "jumps on purpose so far"),
    "reasons": ("", "why the status is worse than ok, the foremost first, joined by +"),
}
_TYPES = {
    "time_us": pa.int64(),
    "status": pa.string(),
    "reset_count": pa.int32(),
    "reasons": pa.string(),
}
SCHEMA = pa.schema(
    [
        pa.field(
            name,
            _TYPES.get(name, pa.float64()),
            metadata=dict(zip(("unit", "frame"), _UNITS[name], strict=True)),
        )
        for name in COLUMNS
    ],
    metadata={"creator": f"ekf-companion {__version__}"},
)


class Writer(EstimateWriter):
    """Writes a row for each estimate; what is not known is null."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._parquet = parquet.ParquetWriter(self.file, SCHEMA, compression="zstd")

    def write(self, table: Table) -> None:
        """Append a row group."""
        if not len(table):
            return
        columns = [pa.array(table.stamp_ns // 1000)]
        for name in COLUMNS[1:]:
            values = table.column(name)
            if name == "status":
                words = np.array(STATUS_NAMES)[values.astype(int)]
                columns.append(pa.array(words.tolist(), type=pa.string()))
            elif name == "reasons":
                found, rows = np.unique(values.astype(int), return_inverse=True)
                words = np.array([reason.names(one) for one in found.tolist()])[rows]
                columns.append(pa.array(words.tolist(), type=pa.string()))
            elif name == "reset_count":
                columns.append(pa.array(values.astype(np.int32)))
            else:
                columns.append(pa.array(np.ascontiguousarray(values), from_pandas=True))
        self._parquet.write_table(pa.Table.from_arrays(columns, schema=SCHEMA))

    def finish(self) -> None:
        """Write the index."""
        self._parquet.close()
