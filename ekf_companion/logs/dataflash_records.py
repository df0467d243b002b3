"""The records of a DataFlash log (.bin), as one table per message.

A record is 0xA3 0x95, a type, and fields as the log's own FMT records lay them out; there is no
checksum. A record is valid where the next one begins at its end; where none does, it is dropped and
the search goes on inside it. So damage costs the records that it touched and the one before.

Source: ArduPilot libraries/AP_Logger (LogStructure.h: format characters).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError
from ekf_companion.logs.source import read_bytes

Column = npt.NDArray[np.void]
Columns = dict[str, Column]

OFFSET = "@"
"""Name of the first column of every table: the record's position in the file, bytes."""

KIND = "DataFlash .bin log of ArduPilot"

_FMT = 0x80
_FMT_SIZE = 89
_MAGIC = b"\xa3\x95"
_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,3}")

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

    @property
    def table(self) -> np.dtype[np.void]:
        """Return the type of the fields in their units, scaled ones as float64, after OFFSET."""
        fields: list[tuple[str, str]] = [(OFFSET, "<i8")]
        for name, character in zip(self.names, self.characters, strict=True):
            code, scale = _TYPES[character]
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


def _find_records(data: bytes) -> tuple[dict[int, _Format], dict[int, list[int]], int]:
    """Return the layouts, the positions of each type's records, and the number of bad runs."""
    formats: dict[int, _Format] = {}
    sizes = [0] * 256
    sizes[_FMT] = _FMT_SIZE
    places: list[list[int]] = [[] for _ in range(256)]
    damaged = 0
    end = len(data)
    place, last = 0, -1
    while place + 3 <= end:
        kind = data[place + 2]
        size = sizes[kind]
        if data[place] == 0xA3 and data[place + 1] == 0x95 and size:
            if place + size > end:
                break
            places[kind].append(place)
            if kind == _FMT and (parsed := _parse_format(data[place : place + size])):
                # The first layout of a type is kept: a later, different one is damage
                formats.setdefault(*parsed)
                sizes[parsed[0]] = formats[parsed[0]].wire.itemsize
            last = place
            place += size
            continue
        # The last record ends where none begins: it, or what follows it, is damaged.
        if last >= 0:
            places[data[last + 2]].pop()
        place = _resume(data, sizes, last + 3 if last >= 0 else place + 1)
        last = -1
        damaged += place < end
    return formats, {kind: places[kind] for kind in formats if places[kind]}, damaged


def _resume(data: bytes, sizes: list[int], place: int) -> int:
    """Return the next position where a record of known type begins and another at its end."""
    end = len(data)
    while (place := data.find(_MAGIC, place)) >= 0 and place + 3 <= end:
        after = place + sizes[data[place + 2]]
        is_followed = data[after : after + 2] == _MAGIC and after + 3 <= end
        if after > place and (after == end or (is_followed and sizes[data[after + 2]])):
            return place
        place += 1
    return end


def _gather(data: bytes, places: list[int], layout: _Format) -> Column:
    """Return the records of one type as a table in their units."""
    raw = np.frombuffer(data, dtype=np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(raw, layout.wire.itemsize)
    wire = windows[np.array(places)].view(layout.wire)[:, 0]
    table = np.zeros(len(places), dtype=layout.table)
    table[OFFSET] = places
    for name, character in zip(layout.names, layout.characters, strict=True):
        scale = _TYPES[character][1]
        # Dividing by the exact inverse gives the nearest double: 1.23, not 1.2300000000000002.
        table[name] = wire[name] if scale == 1 else wire[name] / round(1.0 / scale)
    return table


@np.errstate(invalid="ignore", over="ignore")  # damaged bytes make any number
def read_columns(path: Path) -> tuple[Columns, list[str]]:
    """Return every message of a log as a table, and a sentence for each fault of the file.

    The fields are in their units, the records in file order.

    Raises:
        LogError: The file is missing, empty, or holds no FMT record.
    """
    formats, places, damaged = _find_records(data := read_bytes(path, KIND))
    if not formats:
        raise LogError(f"{path}: holds no FMT record, so it is not a {KIND}; check the file")
    tables: Columns = {}
    for kind, found in places.items():
        table = _gather(data, found, formats[kind])
        name = formats[kind].name
        # Two types of one name come from a damaged FMT: keep the one with more rows
        if name not in tables or len(table) > len(tables[name]):
            tables[name] = table
    notes = [f"{damaged} damaged places in the file: the records there are lost"] if damaged else []
    return tables, notes
