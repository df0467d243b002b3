"""How each message lies on the wire, from the table ``definitions.txt``.

Fields are in wire order: the base fields by falling size of their type, then the extensions. The
table is made of pymavlink's dialect ardupilotmega and compared with it by a test; pymavlink itself
is not needed.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

import numpy as np


class Field(NamedTuple):
    """One field on the wire."""

    name: str
    code: str
    """Struct code of one element; ``s`` for text."""
    length: int
    """Elements, or bytes of text; 0: a scalar."""


@dataclass(frozen=True)
class Layout:
    """One message: its number, its seed of the checksum and its fields."""

    message_id: int
    name: str
    crc_extra: int
    """Seed byte that ties the checksum to the definition."""
    fields: tuple[Field, ...]
    """In wire order."""

    @cached_property
    def struct(self) -> Struct:
        """The whole payload, extensions included."""
        return Struct("<" + "".join(f"{field.length or ''}{field.code}" for field in self.fields))

    @cached_property
    def size(self) -> int:
        """Bytes of the whole payload, extensions included."""
        return self.struct.size

    def unpack(self, payload: bytes) -> tuple[Any, ...]:
        """Return the values in wire order; what the payload lacks at its end reads as zero."""
        return self.struct.unpack(payload.ljust(self.size, b"\0")[: self.size])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Field names in wire order."""
        return tuple(field.name for field in self.fields)

    @cached_property
    def record(self) -> Any:
        """The named tuple that holds one message's fields, in wire order."""
        return namedtuple(self.name, self.names)

    @cached_property
    def places(self) -> tuple[int | slice, ...] | None:
        """Where each field lies among the unpacked values; None: no arrays."""
        places: list[int | slice] = []
        start = 0
        for field in self.fields:
            count = 1 if field.code == "s" else field.length or 1
            places.append(start if count == 1 else slice(start, start + count))
            start += count
        return tuple(places) if start > len(places) else None

    @cached_property
    def has_text(self) -> bool:
        """Whether a field is text."""
        return any(field.code == "s" for field in self.fields)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The payload as a packed numpy record, to view many payloads as columns."""
        return np.dtype([_column(field) for field in self.fields])


def _column(field: Field) -> tuple[str, str, tuple[int, ...]]:
    if field.code == "s":
        return field.name, f"S{field.length}", ()
    code = "S1" if field.code == "c" else f"<{field.code}"
    return field.name, code, (field.length,) if field.length else ()


def _read() -> dict[int, tuple[str, int, str]]:
    """Return name, CRC_EXTRA and fields of each message by its id."""
    found = {}
    for line in _DEFINITIONS.read_text(encoding="ascii").splitlines():
        if not line.startswith("#"):
            number, name, crc_extra, fields = line.split(" ", 3)
            found[int(number)] = name, int(crc_extra), fields
    return found


def _from_words(message_id: int, name: str, crc_extra: int, words: str) -> Layout:
    pairs = (pair.split(" ") for pair in words.split(", "))
    fields = tuple(Field(field, kind[-1], int(kind[:-1] or 0)) for kind, field in pairs)
    return Layout(message_id, name, crc_extra, fields)


class _Layouts(Mapping[int, Layout]):
    """Layouts by message id, each made when first asked for: a start needs few of them."""

    def __init__(self) -> None:
        self._made: dict[int, Layout] = {}

    def __getitem__(self, message_id: int) -> Layout:
        if message_id not in self._made:
            self._made[message_id] = _from_words(message_id, *_KNOWN[message_id])
        return self._made[message_id]

    def __iter__(self) -> Iterator[int]:
        return iter(_KNOWN)

    def __len__(self) -> int:
        return len(_KNOWN)


_DEFINITIONS = Path(__file__).with_name("definitions.txt")
_KNOWN = _read()

LAYOUTS: Mapping[int, Layout] = _Layouts()
"""Every known message by id."""

IDS: Mapping[str, int] = {name: number for number, (name, _, _) in _KNOWN.items()}
"""Message id by name."""

CRC_EXTRAS: Mapping[int, bytes] = {number: bytes([seed]) for number, (_, seed, _) in _KNOWN.items()}
"""Seed of the checksum by message id, as the byte that is appended."""


def by_name(name: str) -> Layout:
    """Return the layout of a message by its name in capitals; KeyError if there is none."""
    return LAYOUTS[IDS[name]]
