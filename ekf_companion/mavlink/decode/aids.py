"""Messages of the aids that declare themselves, each with the rate that it is asked for at."""

from __future__ import annotations

from typing import ClassVar

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.decode.preference import Preference
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.measurements import Kind, RangeSample

DOWN = 25
"""MAV_SENSOR_ROTATION_PITCH_270."""
UNKNOWN_VARIANCE = (0, 255)
"""cm^2; ArduPilot sends 0, MAVLink means 255."""
INVALID = 1
"""Of signal_quality; 0: not known, 100: best."""


class Reader:
    """Reads the message of one aid."""

    kind: ClassVar[Kind]
    """Of its measurements."""
    message: ClassVar[str]
    rate: ClassVar[float]
    """At which the message is asked for, Hz."""

    def __init__(self, context: Context) -> None:
        """Begin with nothing read."""
        self._context = context
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""

    def read(self, frame: Frame) -> Measurements:
        """Return the measurements of a frame of this message."""
        raise NotImplementedError


class RangeFinder(Reader):
    """Reads the distance to the ground; of several range finders, the first that speaks."""

    kind = Kind.RANGE
    message, rate = "DISTANCE_SENSOR", 10.0

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._sources = Preference()
        self._ids: list[int] = []

    def read(self, frame: Frame) -> Measurements:
        """Read DISTANCE_SENSOR; what is at an end of its range is no distance."""
        m = unpack(frame)
        if m.orientation != DOWN:
            return []
        out, t_ns = self._context.follow_ms(m.time_boot_ms, self.message)
        if t_ns is None:
            return out
        if not m.min_distance < m.current_distance < m.max_distance or m.signal_quality == INVALID:
            self._context.refuse("range: out of the sensor's range")
            return out
        if m.id not in self._ids:
            self._ids.append(m.id)
        if self._sources.admit(self._ids.index(m.id), t_ns):
            is_known = m.covariance not in UNKNOWN_VARIANCE
            std = m.covariance**0.5 * 0.01 if is_known else None
            out.append(RangeSample(t_ns=t_ns, range=m.current_distance * 0.01, std=std))
        return out


READERS: tuple[type[Reader], ...] = (RangeFinder,)
SOURCES = {one.kind: one.message for one in READERS}
"""The message of each, by kind."""
RATES = {one.message: one.rate for one in READERS}
"""Hz, by message."""
