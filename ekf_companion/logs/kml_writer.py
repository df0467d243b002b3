"""Writing of estimates as KML 2.2: a line per stretch of one status, with times, in its colour.

Heights are absolute, above mean sea level. Times count from 1970 where the autopilot's clock counts
from its boot and the log does not hold the time of the boot.

Source: OGC 07-147r2 (KML 2.2); Google's extension gx:Track.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ekf_companion.logs.map_time import UNNAMED, Label, utc
from ekf_companion.logs.writer import STATUS_NAMES, EstimateWriter, with_position
from ekf_companion.nav.state import Status, Table

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">
<Document><name>{}</name>
"""
_COLOURS = {
    Status.OK: "ff3cb44b",
    Status.DEGRADED: "ff00c8ff",
    Status.DEAD_RECKONING: "ff0066ff",
    Status.INVALID: "ff0000ff",
}
"""Alpha, blue, green, red."""
_STYLE = '<Style id="{}"><LineStyle><color>{}</color><width>3</width></LineStyle></Style>\n'


class Writer(EstimateWriter):
    """Writes a point for each estimate with a position."""

    def __init__(self, path: Path, label: Label = UNNAMED) -> None:
        super().__init__(path)
        self._zero_ns, self.points = label.zero_ns, 0
        styles = [_STYLE.format(STATUS_NAMES[one], colour) for one, colour in _COLOURS.items()]
        self.file.write((_HEAD.format(label.text) + "".join(styles)).encode())
        self._last: Table | None = None  # ends one stretch and begins the next

    def write(self, table: Table) -> None:
        """Append a line for each stretch of one status."""
        table = with_position(table)
        self.points = (self.points or 0) + len(table)
        status = table.column("status").astype(int)
        for rows in np.split(np.arange(len(table)), np.flatnonzero(np.diff(status)) + 1):
            if len(rows):
                name = STATUS_NAMES[status[rows[0]]]
                part = Table(stamp_ns=table.stamp_ns[rows], values=table.values[rows])
                self._write_line(name, part)
                self._last = Table(stamp_ns=part.stamp_ns[-1:], values=part.values[-1:])

    def _write_line(self, name: str, part: Table) -> None:
        tables = [part] if self._last is None else [self._last, part]
        coordinates = np.concatenate(
            [one.columns(("lon_deg", "lat_deg", "alt_m")) for one in tables]
        )
        times = utc(np.concatenate([one.stamp_ns for one in tables]), self._zero_ns)
        lines = [f"<when>{time}</when>\n" for time in times]
        lines += [
            f"<gx:coord>{lon:.9f} {lat:.9f} {alt:.3f}</gx:coord>\n"
            for lon, lat, alt in coordinates.tolist()
        ]
        self.file.write(
            f"<Placemark><name>{name}</name><styleUrl>#{name}</styleUrl><gx:Track>"
            f"<altitudeMode>absolute</altitudeMode>\n{''.join(lines)}"
            "</gx:Track></Placemark>\n".encode()
        )

    def finish(self) -> None:
        """Close the document."""
        self.file.write(b"</Document>\n</kml>\n")
