"""The records of a DataFlash log (.bin), as one table per message: stored while they are found.

A record is 0xA3 0x95, a type, and fields as the log's own FMT records lay them out; there is no
checksum. A record is valid where the next one begins at its end; where none does, it is dropped and
the search goes on inside it. So damage costs the records that it touched and the one before.

Source: ArduPilot libraries/AP_Logger (LogStructure.h: format characters).
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs import dataflash_search
from ekf_companion.logs.recording import CUT, Damage, cut_off, damaged_places
from ekf_companion.logs.source import MappedFile
from ekf_companion.logs.stored_rows import Column, StoredRows
from ekf_companion.nav.arrays import Stamps

Tables = dict[str, StoredRows]

OFFSET = "@"
"""Name of the first column of every table: the record's position in the file, bytes."""

KIND = "DataFlash .bin log of ArduPilot"

AT_ONCE = 1 << 16
"""Records that are searched at a time."""
_FMT = 0x80
_FMT_SIZE = 89
_MAGIC = b"\xa3\x95"
_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,3}")

Wanted = Mapping[str, Collection[str] | None] | None
"""Names of messages, with the columns to keep of each (None: all); None: all messages."""

_TYPES: dict[str, tuple[str, float]] = {
    "a": ("(32,)<i2", 1),
    "b": ("i1", 1),
    "B": ("u1", 1),
    "c": ("<i2", 1e-2),
    "C": ("<u2", 1e-2),
    "d": ("<f8", 1),
    "e": ("<i4", 1e-2),
    "E": ("<u4", 1e-2),
    "f": ("<f4", 1),
    "g": ("<f2", 1),
    "h": ("<i2", 1),
    "H": ("<u2", 1),
    "i": ("<i4", 1),
    "I": ("<u4", 1),
    "L": ("<i4", 1e-7),
    "M": ("u1", 1),
    "n": ("S4", 1),
    "N": ("S16", 1),
    "q": ("<i8", 1),
    "Q": ("<u8", 1),
    "Z": ("S64", 1),
}
"""The field's type in the file and its scale, by format character."""
_TEXT = "nNZ"
"""The characters of text."""
_TEXTS = ("Name", "Message")
"""Columns that are read as text. A damaged FMT may declare any column as anything."""


@dataclass(frozen=True, slots=True)
class _Format:
    """One valid FMT record."""

    name: str
    names: tuple[str, ...]
    characters: str

    @property
    def wire(self) -> np.dtype[np.void]:
        """Return the type of the record in the file, header included, packed."""
        types = [_TYPES[character][0] for character in self.characters]
        return np.dtype([("header", "V3"), *zip(self.names, types, strict=True)])

    def table(self, kept: Collection[str]) -> np.dtype[np.void]:
        """Return the type of the fields kept, in their units, scaled ones float64, after OFFSET."""
        fields: list[tuple[str, str]] = [(OFFSET, "<i8")]
        for name, character in zip(self.names, self.characters, strict=True):
            code, scale = _TYPES[character]
            if name in kept:
                fields.append((name, code if scale == 1 else "<f8"))
        return np.dtype(fields)


def _parse_format(record: bytes) -> tuple[int, _Format] | None:
    """Return the type and the layout that an FMT record declares, or None if it is damaged."""
    name, characters, columns = (
        part.rstrip(b"\0").decode("latin-1") for part in (record[5:9], record[9:25], record[25:89])
    )
    names = tuple(columns.split(",")) if columns else ()
    is_valid = (
        _NAME.fullmatch(name) is not None
        and len(names) == len(characters) == len(set(names))
        and all(column.isidentifier() for column in names)
        and all(character in _TYPES for character in characters)
    )
    if not is_valid:
        return None
    layout = _Format(name, names, characters)
    return (record[3], layout) if layout.wire.itemsize == record[4] else None


class _Found(NamedTuple):
    """The records of a log."""

    formats: dict[int, _Format]
    """By type."""
    tables: dict[int, StoredRows]
    """Of the records wanted, by type, in file order."""
    counts: Stamps
    """Of all records, by type, shape (256,)."""
    damaged: int
    """Runs of bytes that are not records."""
    rest: int
    """Bytes at the end that are an incomplete record."""


def _find_records(file: MappedFile, names: Wanted) -> _Found:
    """Find the records of some names."""
    data = file.data
    formats: dict[int, _Format] = {}
    tables: dict[int, StoredRows] = {}
    sizes, counts = np.zeros((256, 2), dtype=np.int32), np.zeros(256, dtype=np.int64)
    sizes[_FMT] = _FMT_SIZE, 1
    state = array("q", [-1, 0])
    found, n = np.empty((AT_ONCE, 2), dtype=np.int64), 0

    def store(records: Stamps) -> None:
        places, types = records[:, 0], records[:, 1].astype(np.uint8)
        for kind in np.unique(types).tolist():
            if kind in formats and sizes[kind, 1]:
                layout, kept = formats[kind], _kept(formats[kind], names)
                rows = _gather(file, places[types == kind], layout, kept)
                tables.setdefault(kind, StoredRows(rows.dtype)).append(rows)
        file.release()

    place = 0
    while place + 3 <= len(data):
        n, place = dataflash_search.find_records(data, place, sizes, counts, state, found, n)
        last = state[0]
        if last >= 0 and data[last + 2] == _FMT and place == last + _FMT_SIZE:
            parsed = _parse_format(bytes(data[last:place]))
            # The first layout of a type is kept: a later, different one is damage
            if parsed is not None and parsed[0] not in formats:
                kind, layout = parsed
                formats[kind] = layout
                sizes[kind] = layout.wire.itemsize, names is None or layout.name in names
        if n == len(found):
            # The last one waits: it counts only if a record begins at its end
            store(found[: n - 1])
            found[0], n = found[n - 1], 1
    store(found[:n])
    last = state[0]  # -1: no whole record ends the file, and damage before it is counted
    rest = len(data) - last - int(sizes[data[last + 2], 0]) if last >= 0 else 0
    return _Found(formats, tables, counts, state[1], rest)


def _kept(layout: _Format, names: Wanted) -> Collection[str]:
    """Return the columns that are kept of a message; no text where a number is wanted."""
    if names is None:
        return layout.names
    wanted = names[layout.name]
    return [
        name
        for name, character in zip(layout.names, layout.characters, strict=True)
        if (wanted is None or name in wanted)
        and (character in _TEXT) == (name in _TEXTS)
        and character != "a"
    ]


def _gather(file: MappedFile, places: Stamps, layout: _Format, kept: Collection[str]) -> Column:
    """Return the records of one type as a table of columns in their units."""
    raw = np.frombuffer(file.data, dtype=np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(raw, layout.wire.itemsize)
    table = np.zeros(len(places), dtype=layout.table(kept))
    table[OFFSET] = places
    wire = windows[places].view(layout.wire)[:, 0]
    for name, character in zip(layout.names, layout.characters, strict=True):
        if name not in kept:
            continue
        scale = _TYPES[character][1]
        # Dividing by the exact inverse gives the nearest double: 1.23, not 1.2300000000000002.
        table[name] = wire[name] if scale == 1 else wire[name] / round(1.0 / scale)
    return table


@np.errstate(invalid="ignore", over="ignore")  # damaged bytes make any number
def read_tables(path: Path, names: Wanted = None) -> tuple[Tables, list[str], set[str], Damage]:
    """Return messages of a log as one table each, and a sentence for each fault of the file.

    The fields are in their units, the records in file order.

    Args:
        path: The log.
        names: What to keep of it.

    Returns:
        The tables, the sentences, the names of the messages that the log holds besides, and the
        faults as the verdict counts them.

    Raises:
        LogError: The file is missing, empty, or holds no FMT record; there is no room for a
            temporary file.
    """
    file = MappedFile(path, KIND)
    found = _find_records(file, names)
    if not found.formats:
        raise LogError(f"{path}: holds no FMT record, so it is not a {KIND}; check the file")
    tables: Tables = {}
    for kind in found.formats:
        # Two types of one name come from a damaged FMT: keep the one with more rows
        name = found.formats[kind].name
        if kind in found.tables and len(found.tables[kind]) > len(tables.get(name, ())):
            tables[name] = found.tables[kind]
    others = {layout.name for kind, layout in found.formats.items() if found.counts[kind]}
    notes, damage = file.notes, Damage()
    if found.damaged:
        notes.append(f"{damaged_places(found.damaged)} in the file: the records there are lost")
        records = int(sum(found.counts)) + found.damaged
        damage = Damage(f"{damaged_places(found.damaged)} in the file", found.damaged / records)
    if found.rest:
        notes.append(cut_off(found.rest, "record"))
        damage = Damage(", ".join([damage.words, CUT] if damage.words else [CUT]), damage.share)
    return tables, notes, others - {*tables}, damage
