"""Telemetry logs (.tlog): stamped MAVLink frames, found in damaged files too.

A record is 8 bytes of microseconds, big-endian, by the recorder's clock (the low two bits are the
link's number; they are kept), and one frame, MAVLink 1 or 2. A frame is valid where its checksum is
right. Where none is, the search goes on byte by byte for a stamp near the last good one, followed
by a frame with a right checksum. The checksum of a frame of an unknown id cannot be tested: it is
valid where another record follows at its end.

:mod:`ekf_companion.mavlink` decodes the frames of a .tlog into events, as it does live ones. This
module finds the frames, and reads columns of their fields.
"""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError
from ekf_companion.logs import tlog_search
from ekf_companion.logs.recording import (
    CLOCK_SET_S,
    CUT,
    UNDAMAGED,
    Damage,
    counted,
    damaged_places,
)
from ekf_companion.logs.source import Source
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.mavlink.frame import STX_2, Frames
from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS, LAYOUTS
from ekf_companion.nav.arrays import Indices, Mask, Stamps

RECORD = np.dtype([("stamp_us", "<i8"), ("place", "<i8"), ("size", "<u2"), ("message_id", "<i4")])
"""The recorder's clock as recorded, the frame's position in the file and its size, bytes, its id.
They are small, but of hours there are millions."""

KIND = "telemetry log (.tlog)"
STAMP, ORDER = "@stamp_us", "@order"
"""Columns before a message's own: the recorder's stamp, and the record's number."""
_HEAD = [(STAMP, "<i8"), (ORDER, "<i8")]
BLOCK = 1 << 20
"""Bytes that are searched at once."""
LONGEST = 8 * BLOCK
"""Bytes in which those lie that are read at once."""
SILENCE_US = 1_000_000
"""A longer time between two records is none in which messages came at their rate, us."""
MOST_ROWS = 200_000
"""Of a message for which some are enough: two hours at 25 Hz, and 50 MB of all that is made of
them."""


@dataclass(frozen=True, slots=True)
class Autopilot:
    """The source of the telemetry that is used."""

    system_id: int
    component_id: int
    family: str
    """``px4``, ``ardupilot`` or ``unknown``."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Tlog:
    """The records of a log, in file order."""

    source: Source
    """The file, of which only pieces are in memory."""
    records: StoredRows
    """As :data:`RECORD`."""
    counts: Mapping[int, int]
    """Number of records by the id of the message."""
    damaged: int
    """Number of runs of bytes that are no record."""
    notes: tuple[str, ...] = field(default=())
    damage: Damage = UNDAMAGED
    back: int = 0
    """Number of records that the recorder stamped earlier than the one before."""

    @property
    def began_s(self) -> float | None:
        """When the recording began, s since 1970, by its recorder's clock; None: it was not set."""
        first_s = float(self.records.read(0, 1)["stamp_us"][0]) * 1e-6
        return first_s if first_s > CLOCK_SET_S else None

    def __len__(self) -> int:
        return len(self.records)

    def frames(self) -> Iterator[tuple[int, bytes]]:
        """Yield each record's stamp (us, the recorder's clock) and raw frame, in file order."""
        for piece in self.pieces():
            for i, stamp_us in enumerate(piece.stamp_us.tolist()):
                yield stamp_us, piece.raw(i)

    def pieces(self) -> Iterator[Frames]:
        """Yield the frames, many at once."""
        for _, rows in self.records.parts():
            start = rows["place"].copy()
            end = start + rows["size"]
            begin = int(start[0])
            yield Frames(
                data=self.source.read(begin, int(end[-1])),
                stamp_us=rows["stamp_us"].copy(),
                start=start - begin,
                end=end - begin,
                message_id=rows["message_id"].copy(),
            )

    def columns(
        self,
        names: Sequence[str],
        system_id: int,
        component_id: int | None = None,
        *,
        rates: Mapping[str, float] | None = None,
        fields: Mapping[str, Sequence[str]] | None = None,
        only: Indices | None = None,
    ) -> dict[str, Column]:
        """Return the fields of messages as one table each, in file order; skip absent messages.

        Args:
            names: Of the messages, in capitals.
            system_id: Their source.
            component_id: Likewise; None: all components count.
            rates: Hz, by name: of a more frequent message only every n-th is returned, and of each
                that is named ``MOST_ROWS`` at most.
            fields: Those to return, by name; of a message that is not named, all.
            only: Numbers of records, ascending; None: of all.

        Returns:
            Tables by name: ``STAMP``, ``ORDER`` and the message's own fields in
            wire order and wire units. Fields that a short MAVLink payload omits are 0.
        """
        most = len(self) if only is None else len(only)
        counts = {name: min(self.counts.get(IDS[name], 0), most) for name in names}
        strides = self._strides(counts, rates or {})
        # At once: parts that were put together at the end would take twice the room
        tables = {
            name: np.empty(-(-count // strides[name]), _dtype(name, fields or {}))
            for name, count in counts.items()
        }
        seen, filled = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
        for some, rows in self._parts(only):
            places = {name: np.flatnonzero(rows["message_id"] == IDS[name]) for name in names}
            places = {name: place for name, place in places.items() if len(place)}
            if not places:
                continue
            begin = min(int(rows["place"][place[0]]) for place in places.values())
            last = rows[max(int(place[-1]) for place in places.values())]
            end = int(last["place"]) + int(last["size"])
            raw = np.frombuffer(self.source.read(begin, end), dtype=np.uint8)
            for name, place in places.items():
                place = place[_is_from(raw, rows["place"][place] - begin, system_id, component_id)]
                kept = place[-seen[name] % strides[name] :: strides[name]]
                seen[name] += len(place)
                first, filled[name] = filled[name], filled[name] + len(kept)
                if len(kept):
                    table = tables[name][first : filled[name]]
                    _fill(table, raw, begin, rows[kept], some[kept], IDS[name])
        return {name: table[: filled[name]] for name, table in tables.items() if filled[name]}

    def bytes_of(
        self, message_ids: Sequence[int]
    ) -> Iterator[tuple[Column, npt.NDArray[np.uint8], int]]:
        """Yield the records of some messages, bytes of the file, and the place of the first."""
        for _, rows in self._parts(None):
            rows = rows[np.isin(rows["message_id"], message_ids)]
            if len(rows):
                begin, last = int(rows["place"][0]), rows[-1]
                raw = self.source.read(begin, int(last["place"]) + int(last["size"]))
                yield rows, np.frombuffer(raw, dtype=np.uint8), begin

    def last_before(self, names: Sequence[str], order: Indices) -> Indices:
        """Return the number of the last record of some messages before each record of an order.

        The numbers in ``order`` ascend; -1 where there is none before.
        """
        ids = [IDS[name] for name in names]
        before = np.full(len(order), -1)
        newest = np.array([-1])
        for first, rows in self.records.parts():
            chosen = np.append(newest, first + np.flatnonzero(np.isin(rows["message_id"], ids)))
            begin, end = np.searchsorted(order, (first, first + len(rows)))
            before[begin:end] = chosen[np.searchsorted(chosen, order[begin:end]) - 1]
            newest = chosen[-1:]
        return before

    def _parts(self, only: Indices | None) -> Iterator[tuple[Indices, Column]]:
        """Yield the numbers of records, ascending, and these, as many as are read at once."""
        for first, rows in self.records.parts():
            some = np.arange(first, first + len(rows))
            if only is not None:
                begin, end = np.searchsorted(only, (first, first + len(rows)))
                some, rows = only[begin:end], rows[only[begin:end] - first]
            while len(some):
                # Damaged bytes may lie between, or many others
                count = int(np.searchsorted(rows["place"], rows["place"][0] + LONGEST))
                yield some[:count], rows[:count]
                some, rows = some[count:], rows[count:]

    def _strides(self, counts: Mapping[str, int], rates: Mapping[str, float]) -> dict[str, int]:
        """Return of how many messages one is enough for its rate, Hz, exceeded by 10 % at most."""
        seconds = self._seconds() if rates else 0.0
        enough = {name: min(rate * seconds, MOST_ROWS) for name, rate in rates.items()}
        return {
            name: max(1, math.ceil(count / enough[name] - 0.1)) if enough.get(name) else 1
            for name, count in counts.items()
        }

    def _seconds(self) -> float:
        """Return for how long messages came."""
        spent_us = 0
        newest = self.records.read(0, 1)["stamp_us"]
        for _, rows in self.records.parts():
            steps = np.diff(rows["stamp_us"], prepend=newest)
            # A stamp may be damaged, the clock set, the recorder silent for hours
            spent_us += int(np.clip(steps, 0, SILENCE_US).sum())
            newest = rows["stamp_us"][-1:]
        return spent_us * 1e-6


def _is_from(
    raw: npt.NDArray[np.uint8], place: Stamps, system_id: int, component_id: int | None
) -> Mask:
    """Return which frames, by their places in ``raw``, are of a source."""
    system = place + np.where(raw[place] == STX_2, 5, 3)
    is_from = np.asarray(raw[system] == system_id)
    return is_from if component_id is None else is_from & (raw[system + 1] == component_id)


def _fill(
    table: Column,
    raw: npt.NDArray[np.uint8],
    begin: int,
    records: Column,
    order: Indices,
    message_id: int,
) -> None:
    """Write records of one message, with their numbers, into a table of as many rows."""
    place = records["place"] - begin
    payload = place + np.where(raw[place] == STX_2, 10, 6)
    wire = _payloads(raw, payload, raw[place + 1], message_id)
    table[STAMP], table[ORDER] = records["stamp_us"], order
    for name in (table.dtype.names or ())[len(_HEAD) :]:
        table[name] = wire[name]


def _dtype(name: str, fields: Mapping[str, Sequence[str]]) -> np.dtype[np.void]:
    """Return the type of the table of a message, with all of its fields or those that are named."""
    wire = LAYOUTS[IDS[name]].dtype
    chosen = fields.get(name, wire.names or ())
    return np.dtype([*_HEAD, *((one, wire[one]) for one in chosen)])


def _payloads(
    raw: npt.NDArray[np.uint8], place: Stamps, size: npt.NDArray[np.uint8], message_id: int
) -> Column:
    """Return payloads as a table in wire order, zeros where they are cut short."""
    dtype = LAYOUTS[message_id].dtype
    rows = np.zeros((len(place), dtype.itemsize), dtype=np.uint8)
    for length in np.flatnonzero(np.bincount(size)).tolist():
        same = np.flatnonzero(size == length)
        used = min(length, dtype.itemsize)  # newer definitions add fields at the end
        if used:
            windows = np.lib.stride_tricks.sliding_window_view(raw, used)
            rows[same, :used] = windows[place[same]]
    return rows.view(dtype)[:, 0]


def read(path: Path) -> Tlog:
    """Find the records of a log.

    Raises:
        LogError: The file is missing, empty, or holds no MAVLink frame.
    """
    source = Source(path, KIND)
    records, damaged = _find_records(source)
    if not len(records):
        raise LogError(
            f"{path}: holds no stamped MAVLink frame, so it is not a {KIND}; "
            "a raw stream of MAVLink without stamps cannot be read"
        )
    gaps = _gaps(records)
    return Tlog(
        source=source,
        records=records,
        counts=_counts(records),
        damaged=damaged,
        notes=(*source.notes, *_left_out(source, gaps)),
        damage=_damage(source, gaps),
        back=_back(records),
    )


def _back(records: StoredRows) -> int:
    """Return how many records are stamped earlier than the one before."""
    found, newest = 0, records.read(0, 1)["stamp_us"]
    for _, rows in records.parts():
        stamps = rows["stamp_us"]
        found += int(np.count_nonzero(stamps < np.append(newest, stamps[:-1])))
        newest = stamps[-1:]
    return found


def _counts(records: StoredRows) -> dict[int, int]:
    """Return the number of records by the id of the message."""
    counts: Counter[int] = Counter()
    for _, rows in records.parts():
        ids, numbers = np.unique(rows["message_id"], return_counts=True)
        counts.update(dict(zip(ids.tolist(), numbers.tolist(), strict=True)))
    return counts


class _Gaps(NamedTuple):
    """The bytes before and between the records that are in none."""

    runs: int
    bytes: int
    end: int
    """Of the last record."""


def _gaps(records: StoredRows) -> _Gaps:
    """Find what is in no record."""
    runs = lost = end = 0
    for _, rows in records.parts():
        ends = rows["place"] + rows["size"]
        gaps = rows["place"] - 8 - np.append(end, ends[:-1])
        runs, lost, end = runs + int(np.count_nonzero(gaps)), lost + int(gaps.sum()), int(ends[-1])
    return _Gaps(runs, lost, end)


def _damage(source: Source, gaps: _Gaps) -> Damage:
    """Return what the damaged bytes are for the verdict, and their share of the file."""
    places = f"{damaged_places(gaps.runs)} in the file ({gaps.bytes / 1e3:.3g} kB)"
    words = [places] if gaps.runs else []
    words += [CUT] if gaps.end < len(source) else []
    return Damage(", ".join(words), gaps.bytes / len(source))


def _left_out(source: Source, gaps: _Gaps) -> Iterator[str]:
    """Describe the bytes that are in no record."""
    if gaps.runs:
        runs = counted(gaps.runs, "run")
        were = "was" if gaps.runs == 1 else "were"
        yield f"{runs} of damaged bytes, {gaps.bytes} bytes in all, {were} left out"
    if rest := len(source) - gaps.end:
        tail = range(gaps.end, len(source), BLOCK)
        is_zeros = not any(any(source.read(place, place + BLOCK)) for place in tail)
        what = "zeros" if is_zeros else "no whole record"
        yield f"the last {rest} bytes are {what}: the recording was cut off there"


def _find_records(source: Source) -> tuple[StoredRows, int]:
    """Return the records, as :data:`RECORD`, and the number of bad runs."""
    steps, moves = tlog_search.byte_steps(), tlog_search.zero_moves()
    extras = np.full(max(CRC_EXTRAS) + 1, -1, dtype=np.int16)
    for number, extra in CRC_EXTRAS.items():
        extras[number] = extra[0]
    sums = np.empty(BLOCK + 1, dtype=np.uint16)
    found = np.empty((BLOCK // 16 + 1, 4), dtype=np.int64)
    state = array("q", [0] * tlog_search.STATE)
    records = StoredRows(RECORD)
    place = 0
    is_end = False
    while not is_end:
        block = memoryview(source.read(place, place + BLOCK))
        is_end = place + len(block) == len(source)
        tlog_search.checksum_all(block, steps, sums)
        n, after = tlog_search.find_records(block, sums, steps, moves, extras, state, found, is_end)
        found[:n, 1] += place
        rows = np.empty(n, dtype=RECORD)
        for name, numbers in zip(records.names, found[:n].T, strict=True):
            rows[name] = numbers
        records.append(rows)
        place += after
    return records, state[-1]
