"""Frames read back, for the tests of the fake autopilot."""

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS

US, THEM = (1, 194), (1, 1)
SECOND_NS = 1_000_000_000


def read(frames):
    """Return name and frame of each."""
    found = Splitter().feed(b"".join(frames))
    return [(LAYOUTS[frame.message_id].name, frame) for frame in found if frame.message_id >= 0]


def named(messages, name):
    """Return the fields of those with a name."""
    return [unpack(frame) for is_name, frame in messages if is_name == name]


def command(number, *parameters):
    values = {f"param{i}": value for i, value in enumerate(parameters, 1)}
    return Sender(*US).message(
        "COMMAND_LONG", command=number, target_system=1, target_component=1, **values
    )


def ask(name, rate):
    return command(511, IDS[name], 1e6 / rate)
