"""Messages of the aids that declare themselves, each with the rate that it is asked for at."""

from __future__ import annotations

from typing import ClassVar, Protocol

from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.measurements import Kind


class Reader(Protocol):
    """Reads the message of one aid."""

    kind: ClassVar[Kind]
    """Of its measurements."""
    message: ClassVar[str]
    rate: ClassVar[float]
    """At which the message is asked for, Hz."""

    def __init__(self, context: Context) -> None: ...

    def forget(self) -> None:
        """Forget everything after a reboot."""

    def read(self, frame: Frame) -> Measurements:
        """Return the measurements of a frame of this message."""


READERS: tuple[type[Reader], ...] = ()
SOURCES = {one.kind: one.message for one in READERS}
"""The message of each, by kind."""
RATES = {one.message: one.rate for one in READERS}
"""Hz, by message."""
