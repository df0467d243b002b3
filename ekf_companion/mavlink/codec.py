"""Payloads to named fields and back, and messages of ours to frames."""

from __future__ import annotations

import struct
from typing import Any

from fastcrc import crc16

from ekf_companion.mavlink.frame import SIGNED, Frame
from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS, LAYOUTS, by_name
from ekf_companion.mavlink.signing import Signing

_HEADER = struct.Struct("<BBBBBBHB")
_CRC = struct.Struct("<H")
_crc = crc16.mcrf4xx


def unpack(frame: Frame) -> Any:
    """Return the message's fields as a named tuple in wire order, named as the message.

    What the payload lacks at its end reads as zero, and what is beyond the known fields is ignored.
    Arrays are tuples, text is bytes up to the first zero. KeyError for an unknown id.
    """
    layout = LAYOUTS[frame.message_id]
    values = layout.unpack(frame.payload)
    if layout.places is not None:
        values = tuple(values[place] for place in layout.places)
    if layout.has_text:
        values = tuple(v.split(b"\0", 1)[0] if isinstance(v, bytes) else v for v in values)
    return layout.record._make(values)


def pack(name: str, **fields: Any) -> bytes:
    """Return the payload of a message in full size; fields that are not named are zero.

    Raises:
        KeyError: No such message.
        TypeError: The message has no such field, or an array has another length.
    """
    layout = by_name(name)
    values: list[Any] = []
    for field in layout.fields:
        value = fields.pop(field.name, None)
        if field.code == "s":
            values.append(value or b"")
        elif field.length:
            values.extend((0,) * field.length if value is None else value)
        else:
            values.append(0 if value is None else value)
    if fields:
        raise TypeError(f"{name} has no field {', '.join(sorted(fields))}")
    try:
        return layout.struct.pack(*values)
    except struct.error as error:
        raise TypeError(f"{name}: {error}") from None


class Sender:
    """Frames the messages of one component, and owns its sequence number."""

    def __init__(self, system_id: int, component_id: int, signing: Signing | None = None) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self._signing = signing
        self.sequence = 0
        """Of the next frame."""

    def frame(self, name: str, payload: bytes, now_ns: int = 0, *, is_draft: bool = False) -> bytes:
        """Return the next frame of a message, by its name and payload.

        Zeros at the payload's end are left out.

        Args:
            name: The message's.
            payload: In full size.
            now_ns: Unix time, ns, for the signature, where there is a key.
            is_draft: Without a signature, and with the number that the next frame has too.
        """
        is_signed = self._signing is not None and not is_draft
        payload, number = payload.rstrip(b"\0") or b"\0", IDS[name]
        ids = self.sequence, self.system_id, self.component_id, number & 0xFFFF, number >> 16
        body = _HEADER.pack(len(payload), SIGNED if is_signed else 0, 0, *ids) + payload
        data = b"\xfd" + body + _CRC.pack(_crc(body + CRC_EXTRAS[number]))
        if is_draft:
            return data
        self.sequence = (self.sequence + 1) & 0xFF
        return data if self._signing is None else self._signing.sign(data, now_ns)

    def message(self, name: str, **fields: Any) -> bytes:
        """Return the next frame of a message, from its fields."""
        return self.frame(name, pack(name, **fields))
