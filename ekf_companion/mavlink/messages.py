"""How each message lies on the wire, from the definitions that pymavlink carries.

Fields are in wire order: the base fields by falling size of their type, then the extensions. The
dialect is imported as a module of definitions only; none of pymavlink's parsers runs.
"""

from __future__ import annotations

import re
from collections import namedtuple
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect


class Field(NamedTuple):
    """One field on the wire."""

    name: str
    code: str
    """Struct code of one element; ``s`` for text."""
    length: int
    """Elements, or bytes of text; 0: a scalar."""


_EXTENSIONS = {"TIMESYNC": (Field("target_system", "B", 0), Field("target_component", "B", 0))}
"""Extension fields that the definitions have gained since the packaged pymavlink was made."""

_MISSING = (
    (
        300,
        "PROTOCOL_VERSION",
        217,
        "H version, H min_version, H max_version, 8B spec_version_hash, 8B library_version_hash",
    ),
    (
        396,
        "COMPONENT_INFORMATION_BASIC",
        50,
        "Q capabilities, I time_boot_ms, "
        "I time_manufacture_s, 32s vendor_name, 32s model_name, 24s software_version, "
        "24s hardware_version, 32s serial_number",
    ),
)
"""Messages of the common definitions that no packaged dialect has: id, name, CRC_EXTRA, fields."""


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


def _from_words(message_id: int, name: str, crc_extra: int, words: str) -> Layout:
    pairs = (pair.split(" ") for pair in words.split(", "))
    fields = tuple(Field(field, kind[-1], int(kind[:-1] or 0)) for kind, field in pairs)
    return Layout(message_id, name, crc_extra, fields)


def _from_definition(definition: Any) -> Layout:
    tokens = re.findall(r"(\d*)([a-zA-Z])", definition.unpacker.format)
    fields = [
        Field(name, code, int(count or 0))
        for name, (count, code) in zip(definition.ordered_fieldnames, tokens, strict=True)
    ]
    extensions = _EXTENSIONS.get(definition.msgname, ())
    fields += [field for field in extensions if field.name not in definition.ordered_fieldnames]
    return Layout(definition.id, definition.msgname, definition.crc_extra, tuple(fields))


class _Layouts(Mapping[int, Layout]):
    """Layouts by message id, each made when first asked for: a start needs few of them."""

    def __init__(self) -> None:
        self._made = {missing[0]: _from_words(*missing) for missing in _MISSING}

    def __getitem__(self, message_id: int) -> Layout:
        if message_id not in self._made:
            self._made[message_id] = _from_definition(dialect.mavlink_map[message_id])
        return self._made[message_id]

    def __iter__(self) -> Iterator[int]:
        return iter(CRC_EXTRAS)

    def __len__(self) -> int:
        return len(CRC_EXTRAS)


LAYOUTS: Mapping[int, Layout] = _Layouts()
"""Every known message by id."""

_KNOWN = [(one.id, one.msgname, one.crc_extra) for one in dialect.mavlink_map.values()]
_KNOWN += [missing[:3] for missing in _MISSING]

IDS: Mapping[str, int] = {name: number for number, name, _ in _KNOWN}
"""Message id by name."""

CRC_EXTRAS: Mapping[int, bytes] = {number: bytes([seed]) for number, _, seed in _KNOWN}
"""Seed of the checksum by message id, as the byte that is appended."""


def by_name(name: str) -> Layout:
    """Return the layout of a message by its name in capitals; KeyError if there is none."""
    return LAYOUTS[IDS[name]]
