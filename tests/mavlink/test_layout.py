"""The layouts against pymavlink's own packers."""

import pytest
from pymavlink.dialects.v10 import ardupilotmega as dialect_1
from pymavlink.dialects.v20 import ardupilotmega as dialect_2

from ekf_companion.mavlink.layout import IDS, LAYOUTS, by_name

LAGGING = {"TIMESYNC"}


def test_every_message_of_the_dialect_has_a_layout():
    assert set(LAYOUTS) == set(dialect_2.mavlink_map)
    assert len(IDS) == len(LAYOUTS)


@pytest.mark.parametrize("message_id", sorted(dialect_2.mavlink_map))
def test_a_layout_agrees_with_its_definition(message_id):
    layout, definition = LAYOUTS[message_id], dialect_2.mavlink_map[message_id]
    assert layout.name == definition.msgname
    if layout.name not in LAGGING:
        assert layout.struct.format == definition.unpacker.format
        assert list(layout.names) == definition.ordered_fieldnames
    assert layout.dtype.itemsize == layout.size
    assert layout.dtype.names == layout.names
    assert layout.record._fields == layout.names


@pytest.mark.parametrize("message_id", sorted(dialect_1.mavlink_map))
def test_the_base_size_is_what_mavlink_1_carries(message_id):
    assert LAYOUTS[message_id].base_size == dialect_1.mavlink_map[message_id].unpacker.size


def test_timesync_has_its_targets():
    assert by_name("TIMESYNC").size == 18
    assert by_name("TIMESYNC").base_size == 16
