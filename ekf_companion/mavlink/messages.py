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
from typing import Any

import numpy as np
from fastcrc import crc16
from pymavlink.dialects.v20 import ardupilotmega as dialect

_TYPE_NAMES = {
    "s": "char",
    "c": "char",
    "b": "int8_t",
    "B": "uint8_t",
    "h": "int16_t",
    "H": "uint16_t",
    "i": "int32_t",
    "I": "uint32_t",
    "q": "int64_t",
    "Q": "uint64_t",
    "f": "float",
    "d": "double",
}
"""Struct code to the type's name in the definitions, which the CRC_EXTRA is computed over."""

_EXTENSIONS = {"TIMESYNC": (("target_system", "B", 0), ("target_component", "B", 0))}
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


@dataclass(frozen=True, slots=True)
class Field:
    """One field on the wire."""

    name: str
    code: str
    """Struct code of one element; ``s`` for text."""
    length: int
    """Elements, or bytes of text; 0: a scalar."""

    @property
    def format(self) -> str:
        """The field's part of a struct format."""
        return f"{self.length or ''}{self.code}"


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
        return Struct("<" + "".join(field.format for field in self.fields))

    @cached_property
    def size(self) -> int:
        """Bytes of the whole payload, extensions included."""
        return self.struct.size

    @cached_property
    def base_size(self) -> int:
        """Bytes of the payload without extensions: what a MAVLink 1 frame carries.

        The definitions do not say where the extensions begin, but the CRC_EXTRA covers the base
        fields only, which lie by falling size: they are the longest such prefix that gives it.
        """
        text, size, found, width = f"{self.name} ".encode(), 0, self.size, 8
        for field in self.fields:
            if Struct(field.code).size > width:
                break
            width = Struct(field.code).size
            text += f"{_TYPE_NAMES[field.code]} {field.name} ".encode()
            text += bytes([field.length]) if field.length else b""
            size += Struct("<" + field.format).size
            crc = crc16.mcrf4xx(text)
            if (crc & 0xFF) ^ (crc >> 8) == self.crc_extra:
                found = size
        return found

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Field names in wire order."""
        return tuple(field.name for field in self.fields)

    @cached_property
    def record(self) -> Any:
        """The named tuple that holds one message's fields, in wire order."""
        return namedtuple(self.name, self.names)

    @cached_property
    def spans(self) -> tuple[tuple[str, int, int], ...] | None:
        """Name, first and last place of each field among the unpacked values; None: no arrays."""
        if not any(field.length and field.code != "s" for field in self.fields):
            return None
        spans, start = [], 0
        for field in self.fields:
            count = field.length if field.length and field.code != "s" else 1
            spans.append((field.name, start, start + count))
            start += count
        return tuple(spans)

    @cached_property
    def has_text(self) -> bool:
        """Whether a field is text."""
        return any(field.code == "s" for field in self.fields)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The payload as a packed numpy record, to view many payloads as columns."""
        return np.dtype([_column(field) for field in self.fields])


def _column(field: Field) -> tuple[str, str] | tuple[str, str, tuple[int]]:
    if field.code == "s":
        return field.name, f"S{field.length}"
    code = np.dtype({"c": "S1"}.get(field.code, f"<{field.code}")).str
    return (field.name, code, (field.length,)) if field.length else (field.name, code)


class _Layouts(Mapping[int, Layout]):
    """Layouts by message id, each made when first asked for."""

    def __init__(self) -> None:
        self._made = {missing[0]: _from_words(*missing) for missing in _MISSING}
        self._ids = tuple({**dialect.mavlink_map, **self._made})

    def __getitem__(self, message_id: int) -> Layout:
        if message_id not in self._made:
            self._made[message_id] = _from_definition(dialect.mavlink_map[message_id])
        return self._made[message_id]

    def __iter__(self) -> Iterator[int]:
        return iter(self._ids)

    def __len__(self) -> int:
        return len(self._ids)


def _from_words(message_id: int, name: str, crc_extra: int, words: str) -> Layout:
    fields = [field.split(" ") for field in words.split(", ")]
    return Layout(
        message_id,
        name,
        crc_extra,
        tuple(Field(field, kind[-1], int(kind[:-1] or 0)) for kind, field in fields),
    )


def _from_definition(definition: Any) -> Layout:
    tokens = re.findall(r"(\d*)([a-zA-Z])", definition.unpacker.format)
    fields = [
        Field(name, code, int(count or 0))
        for name, (count, code) in zip(definition.ordered_fieldnames, tokens, strict=True)
    ]
    have = {field.name for field in fields}
    fields += [
        Field(*extension)
        for extension in _EXTENSIONS.get(definition.msgname, ())
        if extension[0] not in have
    ]
    return Layout(definition.id, definition.msgname, definition.crc_extra, tuple(fields))


LAYOUTS: Mapping[int, Layout] = _Layouts()
"""Every known message by id."""

IDS: Mapping[str, int] = {
    **{definition.msgname: number for number, definition in dialect.mavlink_map.items()},
    **{name: number for number, name, _, _ in _MISSING},
}
"""Message id by name."""

CRC_EXTRAS: Mapping[int, bytes] = {
    **{number: bytes([definition.crc_extra]) for number, definition in dialect.mavlink_map.items()},
    **{number: bytes([seed]) for number, _, seed, _ in _MISSING},
}
"""Seed of the checksum by message id, as the byte that is appended."""


def by_name(name: str) -> Layout:
    """Return the layout of a message by its name in capitals; KeyError if there is none."""
    return LAYOUTS[IDS[name]]
