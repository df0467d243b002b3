"""Writing of estimates as MCAP, for Foxglove and what else reads it.

Channels, as JSON with schemas: ``/estimate``, all numbers of each estimate, for plots; ``/pose``
and ``/tf`` in the frames of ROS REP 103 (``map``: east, north, up of the origin; ``base_link``:
forward, left, up); ``/location``, the position on a map; ``/log``, a line per change of the status
and per reset.

Source: MCAP specification, mcap.dev.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import orjson

from ekf_companion.logs import foxglove_schema as schema
from ekf_companion.logs.json_objects import HEAD, write_messages
from ekf_companion.logs.mcap_file import McapFile
from ekf_companion.logs.writer import (
    STATUS_NAMES,
    EstimateWriter,
    Thinning,
    east_north_up,
    with_position,
)
from ekf_companion.nav import reason
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.state import COLUMNS, GEODETIC, Reason, Status, Table
from ekf_companion.version import __version__

POSE_RATE = 25.0
"""Poses and transforms per second at most, Hz: more than a screen shows."""
AT_ONCE = 1024
"""Messages made at a time: their text stays in the processor's cache."""
LOCATION_RATE = 5.0
"""Fixes on the map per second at most, Hz."""
_SCHEMAS = {
    "/estimate": (
        "ekf_companion.Estimate",
        schema.object_of(
            **dict.fromkeys(COLUMNS[1:-3], schema.NUMBER),
            status=schema.TEXT,
            reset_count=schema.WHOLE,
            reasons=schema.TEXT,
        ),
    ),
    "/pose": schema.POSE,
    "/tf": schema.TRANSFORM,
    "/location": schema.LOCATION,
    "/log": schema.LOG,
}
"""Name and JSON schema of each channel."""


def _around(template: str) -> list[bytes]:
    """Return the texts around the numbers of an object, each a ``#`` in the template."""
    return [part.encode() for part in template.split("#")]


_ENDS = ("status", "reset_count", "reasons")
"""Columns at the end of a row that are not measured."""
_ESTIMATE = [b'%s"%s":' % (b"," if n else b"{", c.encode()) for n, c in enumerate(COLUMNS[1:-3])]
_POSE = _around(
    '{"frame_id":"map","pose":{"position":{"x":#,"y":#,"z":#},"orientation":{"w":#,"x":#,"y":#,"z":#}}'
)
_TRANSFORM = _around(
    '{"parent_frame_id":"map","child_frame_id":"base_link","translation":{"x":#,"y":#,"z":#},'
    '"rotation":{"w":#,"x":#,"y":#,"z":#}'
)
# position_covariance_type 2: the diagonal is known
_LOCATION = _around(
    '{"frame_id":"map","position_covariance_type":2,"latitude":#,"longitude":#,"altitude":#,'
    '"position_covariance":[#,0,0,0,#,0,0,0,#]'
)


class Writer(EstimateWriter):
    """Writes each estimate, and some of them as poses and fixes."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._mcap = McapFile(self.file, f"ekf-companion {__version__}")
        self._channels = {
            topic: self._mcap.add_channel(topic, name, orjson.dumps(of_channel))
            for topic, (name, of_channel) in _SCHEMAS.items()
        }
        self._text = bytearray()
        self._poses, self._locations = Thinning(POSE_RATE), Thinning(LOCATION_RATE)
        self._last: tuple[int, int, int] | None = None  # of a row: _ENDS

    def write(self, table: Table) -> None:
        """Append estimates.

        Raises:
            LogError: A time is before zero.
        """
        self.refuse_times_before_zero(table, "an .mcap")
        self._add_estimates(table)
        known = with_position(table)
        self._add_poses(self._poses.thin(known))
        self._add_locations(self._locations.thin(known))
        self._add_changes(table)

    def finish(self) -> None:
        """Write the index."""
        self._mcap.finish()

    def _add_stamped(self, topic: str, table: Table, numbers: Array, around: list[bytes]) -> None:
        """Add an object for each row: its numbers, the text around them, and the time."""
        *names, behind = around
        ends = [
            b'%s,"timestamp":{"sec":%d,"nsec":%d}}' % (behind, *divmod(stamp_ns, 1_000_000_000))
            for stamp_ns in table.stamp_ns.tolist()
        ]
        self._add_objects(topic, table.stamp_ns, numbers, names, ends)

    def _add_objects(
        self, topic: str, stamp_ns: Stamps, numbers: Array, names: list[bytes], ends: list[bytes]
    ) -> None:
        channel, around = self._channels[topic], HEAD + sum(map(len, names))
        for first in range(0, len(ends), AT_ONCE):
            rows = slice(first, first + AT_ONCE)
            # JSON has no NaN: orjson writes null, which Foxglove has no type for; it is left out
            part = np.ascontiguousarray(numbers[rows])
            text = orjson.dumps(part, option=orjson.OPT_SERIALIZE_NUMPY)
            size = len(text) + sum(map(len, ends[rows])) + around * len(part)
            if size > len(self._text):
                self._text = bytearray(size)
            stamps = np.ascontiguousarray(stamp_ns[rows])
            behind = np.empty(len(part), dtype=np.int64)
            has_gaps = topic == "/estimate"
            write_messages(text, names, ends[rows], channel, stamps, self._text, behind, has_gaps)
            self._mcap.add(channel, stamps, memoryview(self._text), behind)

    def _add_estimates(self, table: Table) -> None:
        words: dict[tuple[int, ...], bytes] = {}
        ends = []
        for row in table.columns(_ENDS).astype(int).tolist():
            end = words.get(key := tuple(row))
            if end is None:
                said = {"status": STATUS_NAMES[key[0]], "reset_count": key[1]}
                said["reasons"] = reason.names(key[2])
                end = words[key] = b"," + orjson.dumps(said)[1:]
            ends.append(end)
        self._add_objects("/estimate", table.stamp_ns, table.values[:, :-3], _ESTIMATE, ends)

    def _add_poses(self, table: Table) -> None:
        pos_enu, q = east_north_up(table)
        numbers = np.column_stack([pos_enu, q])
        self._add_stamped("/pose", table, numbers, _POSE)
        self._add_stamped("/tf", table, numbers, _TRANSFORM)

    def _add_locations(self, table: Table) -> None:
        variances = table.columns(("sd_pos_e", "sd_pos_n", "sd_pos_d")) ** 2
        numbers = np.column_stack([table.columns(GEODETIC), variances])
        self._add_stamped("/location", table, numbers, _LOCATION)

    def _add_changes(self, table: Table) -> None:
        """Add a line where status, foremost reason or resets differ from the row before."""
        now = table.columns(_ENDS).astype(int)
        now[:, 2] = reason.foremost_of(now[:, 2])
        is_new = np.ones(len(now), dtype=bool)
        is_new[1:] = (np.diff(now, axis=0) != 0).any(axis=1)
        for row in np.flatnonzero(is_new).tolist():
            status, resets, why = now[row].tolist()
            if self._last == (status, resets, why):
                continue
            words = f"status {STATUS_NAMES[status]}, {resets} resets so far"
            if why:
                words += f": {reason.WORDS[Reason(why)]}"
            line = {
                "timestamp": schema.time_of(int(table.stamp_ns[row])),
                "level": schema.INFO if status <= Status.OK else schema.WARNING,
                "message": words,
                "name": "ekf-companion",
                "file": "",
                "line": 0,
            }
            self._last = status, resets, why
            stamps = table.stamp_ns[row : row + 1]
            self._add_objects("/log", stamps, np.zeros((1, 0)), [], [orjson.dumps(line)])
