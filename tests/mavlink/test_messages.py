"""The layouts against pymavlink's own packers."""

import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS, LAYOUTS, by_name
from tests.definitions import NEWER, PAGE, definitions

LAGGING = {"TIMESYNC"}
MISSING = {300: ("PROTOCOL_VERSION", 217, 22), 396: ("COMPONENT_INFORMATION_BASIC", 50, 160)}
"""Name, CRC_EXTRA and size by id, as the C headers of the common definitions give them."""
TYPES = {"B": "uint8_t", "H": "uint16_t", "I": "uint32_t", "Q": "uint64_t", "s": "char"}


def length(field):
    """Return an array's length as CRC_EXTRA is computed over it."""
    return chr(field.length) if field.length else ""


def test_every_message_of_the_dialect_has_a_layout():
    """A pymavlink that has a new one wants `make reference`."""
    assert set(LAYOUTS) == {*dialect.mavlink_map, *NEWER, *MISSING}
    assert len(IDS) == len(LAYOUTS) == len(CRC_EXTRAS)
    assert PAGE.read_text() == definitions()


@pytest.mark.parametrize("message_id", MISSING)
def test_a_message_that_the_dialect_lacks_lies_as_it_is_defined(message_id):
    name, crc_extra, size = MISSING[message_id]
    layout = by_name(name)
    assert LAYOUTS[message_id] is layout
    assert (layout.message_id, layout.crc_extra, layout.size) == (message_id, crc_extra, size)
    words = f"{name} " + "".join(f"{TYPES[f.code]} {f.name} " + length(f) for f in layout.fields)
    crc = crc16.mcrf4xx(words.encode("latin-1"))
    assert crc & 0xFF ^ crc >> 8 == crc_extra


@pytest.mark.parametrize("message_id", sorted({**dialect.mavlink_map, **NEWER}))
def test_a_layout_agrees_with_its_definition(message_id):
    layout, definition = LAYOUTS[message_id], {**dialect.mavlink_map, **NEWER}[message_id]
    assert layout.name == definition.msgname
    assert CRC_EXTRAS[message_id] == bytes([definition.crc_extra])
    if layout.name not in LAGGING:
        assert layout.struct.format == definition.unpacker.format
        assert list(layout.names) == definition.ordered_fieldnames
    assert layout.dtype.itemsize == layout.size
    assert layout.dtype.names == layout.names
    assert layout.record._fields == layout.names


def test_timesync_has_its_targets():
    assert by_name("TIMESYNC").size == 18
