"""Writing of estimates as a GPX 1.1 track: heights above mean sea level, a segment per gap.

Times count from 1970 where the autopilot's clock counts from its boot and the log does not hold the
time of the boot.

Source: GPX 1.1 schema documentation, topografix.com/gpx/1/1.
"""

from __future__ import annotations

from pathlib import Path

from ekf_companion.logs.map_time import UNNAMED, Label, utc
from ekf_companion.logs.writer import EstimateWriter, with_position
from ekf_companion.nav.state import GEODETIC, Table

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="ekf-companion" xmlns="http://www.topografix.com/GPX/1/1">
<trk><name>{}</name><trkseg>
"""
GAP_NS = 5_000_000_000
"""Time without an estimate after which a new segment begins."""


class Writer(EstimateWriter):
    """Writes a point for each estimate with a position."""

    def __init__(self, path: Path, label: Label = UNNAMED) -> None:
        super().__init__(path)
        self._zero_ns, self.points = label.zero_ns, 0
        self.file.write(_HEAD.format(label.text).encode())
        self._last_ns: int | None = None

    def write(self, table: Table) -> None:
        """Append points."""
        table = with_position(table)
        self.points = (self.points or 0) + len(table)
        rows = zip(
            table.stamp_ns.tolist(),
            *table.columns(GEODETIC).T.tolist(),
            utc(table.stamp_ns, self._zero_ns),
            strict=True,
        )
        lines = []
        for stamp_ns, lat, lon, alt, time in rows:
            if self._last_ns is not None and not 0 <= stamp_ns - self._last_ns <= GAP_NS:
                lines.append("</trkseg><trkseg>\n")
            self._last_ns = stamp_ns
            lines.append(
                f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><ele>{alt:.3f}</ele>'
                f"<time>{time}</time></trkpt>\n"
            )
        self.file.write("".join(lines).encode())

    def finish(self) -> None:
        """Close the track."""
        self.file.write(b"</trkseg></trk>\n</gpx>\n")
