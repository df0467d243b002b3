"""What the readers of one autopilot's messages share.

The autopilot's family and clock, counts of what was refused, and notes for a human.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from ekf_companion.mavlink.decode.state import ContextState
from ekf_companion.mavlink.timebase import LAST_US, Step, TimeBase
from ekf_companion.nav.measurements import Measurement, Restart

Measurements = list[Measurement]
NOTES = 32
"""Notes that wait to be read, at most; the oldest are dropped first."""


class Family(str, Enum):
    """The autopilot's firmware: whose habits apply."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class DecoderOptions:
    """How messages that leave something open are read."""

    imu_id: int = 0
    """The instance in HIGHRES_IMU.id that is preferred; another is used while it is silent."""
    derived_rate: float = 5.0
    """Fixes per second taken from the autopilot's own position at most."""
    heading_rate: float = 10.0
    """Headings per second taken from the autopilot at most."""
    heading_std: float = math.radians(5.0)
    """One sigma of the autopilot's heading, rad: a compass in a drone, after its calibration."""
    is_dejittered: bool = True
    """Whether inertial stamps are brought back to when the samples were taken, where the
    autopilot stamps them as it sends them or in whole milliseconds."""


class Context(ContextState):
    """Family, clock, refusals and notes of one autopilot."""

    def __init__(
        self, family: Family, options: DecoderOptions, forget: Callable[[Step], None]
    ) -> None:
        """Begin with nothing known of its clock.

        ``forget`` is called when the autopilot's clock began anew or was set, after it took the new
        time.
        """
        self.family = family
        self.options = options
        self.is_submarine = False
        """Whether the air pressure is that within a hull."""
        self.is_ours = self.is_yaw_ours = False
        """Whether the autopilot's own position, and its yaw, are made of our ODOMETRY."""
        self.clock = TimeBase()
        self.refused: Counter[str] = Counter()
        """How often, by reason: ``message: why``."""
        self.notes: deque[str] = deque(maxlen=NOTES)
        """Sentences for a human, oldest first; whoever reads them takes them out."""
        self._forget = forget
        self._noted: set[str] = set()

    def refuse(self, reason: str) -> Measurements:
        """Count a refusal; return no measurements."""
        self.refused[reason] += 1
        return []

    def note_once(self, note: str) -> None:
        """Add a note unless it was added before."""
        if note not in self._noted:
            self._noted.add(note)
            self.notes.append(note)

    def follow_us(self, stamp_us: int, message: str) -> Measurements | None:
        """Advance the clock to a stamp; return the restart that it reveals, if any.

        None, counted as a refusal: the stamp is no time, or a leap that nothing has confirmed yet.
        """
        if self.clock.follow(stamp_us):
            return []
        if not 0 < stamp_us <= LAST_US:
            self.refuse(f"{message}: no time")
            return None
        step = self.clock.advance(stamp_us)
        return [] if step is Step.FOLLOWED else self._leapt(step, message)

    def follow_ms(self, boot_ms: int, message: str) -> tuple[Measurements, int | None]:
        """Advance the clock to milliseconds since boot; return a restart as above, and the time.

        The time is None as above, or where nothing relates the milliseconds to the inertial stamps:
        not yet, or no more since the reboot.
        """
        # 0 is no time, so it says nothing of a reboot
        step = self.clock.advance_boot_ms(boot_ms) if boot_ms != 0 else Step.FOLLOWED
        out = [] if step is Step.FOLLOWED else self._leapt(step, message)
        if out is None:
            return [], None
        t_ns = self.clock.from_boot_ms(boot_ms)
        if t_ns is None:
            self.refuse(f"{message}: time base unknown")
        return out, t_ns

    def relate(self, unix_us: int, boot_ms: int) -> Measurements:
        """Advance the clock by a SYSTEM_TIME; return the restart that it reveals, if any."""
        step = self.clock.relate(unix_us, boot_ms)
        return [] if step is Step.FOLLOWED else self._leapt(step, "SYSTEM_TIME") or []

    def _leapt(self, step: Step, message: str) -> Measurements | None:
        if step is Step.HELD:
            self.refuse(f"{message}: stamp leaps")
            return None
        self._forget(step)
        if step is Step.SET:
            self.refused["clock set back"] += 1
            self.notes.append(
                "The autopilot's clock was set back by less than two seconds; going on by it"
            )
        return [Restart(goes_on=step is Step.SET)]
