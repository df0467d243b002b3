"""What all readers of one autopilot share: whose habits, what time, what was refused and told."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from ekf_companion.mavlink.timebase import LAST_US, Step, TimeBase
from ekf_companion.nav.measurements import Measurement, Restart

Measurements = list[Measurement]
NOTES = 32
"""Notes that wait to be read, at most; the oldest go first."""


class Family(str, Enum):
    """Whose habits apply."""

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


class Door:
    """The one place that messages come in by."""

    def __init__(
        self, family: Family, options: DecoderOptions, forget: Callable[[Step], None]
    ) -> None:
        """Open it.

        Args:
            family: Whose habits apply.
            options: How messages that leave something open are read.
            forget: Called when the autopilot's clock began anew or was set, after the clock took
                the new time.
        """
        self.family = family
        self.options = options
        self.is_ours = self.is_yaw_ours = False
        """Whether the autopilot's own position, and its yaw, are made of our ODOMETRY."""
        self.clock = TimeBase()
        self.refused: Counter[str] = Counter()
        """How often, by reason: ``message: why``."""
        self.notes: deque[str] = deque(maxlen=NOTES)
        """What a human should hear of, oldest first; whoever reads takes them out."""
        self._forget = forget
        self._told: set[str] = set()

    def refuse(self, reason: str) -> Measurements:
        """Count a refusal; give nothing."""
        self.refused[reason] += 1
        return []

    def tell(self, note: str) -> None:
        """Leave a note."""
        self.notes.append(note)

    def tell_once(self, note: str) -> None:
        """Leave a note that has not been left before."""
        if note not in self._told:
            self._told.add(note)
            self.notes.append(note)

    def follow_us(self, stamp_us: int, message: str) -> Measurements | None:
        """Let the clock follow a stamp; give what that says of a reboot.

        None: the stamp is no time, or a leap that nothing has confirmed yet; that is counted.
        """
        if self.clock.goes_on(stamp_us):
            return []
        if not 0 < stamp_us <= LAST_US:
            self.refuse(f"{message}: no time")
            return None
        step = self.clock.advance(stamp_us)
        return [] if step is Step.FOLLOWED else self._leapt(step, message)

    def follow_ms(self, boot_ms: int, message: str) -> tuple[Measurements, int | None]:
        """Let the clock follow milliseconds since boot; give what that says of a reboot, and ns.

        None for the time: as above, or nothing relates the milliseconds to the inertial stamps:
        not yet, or since the reboot no more.
        """
        out: Measurements = []
        # 0 is no time, so it says nothing of a reboot
        if boot_ms != 0:
            step = self.clock.advance_boot_ms(boot_ms)
            if step is not Step.FOLLOWED:
                leapt = self._leapt(step, message)
                if leapt is None:
                    return [], None
                out = leapt
        t_ns = self.clock.from_boot_ms(boot_ms)
        if t_ns is None:
            self.refuse(f"{message}: time base unknown")
        return out, t_ns

    def relate(self, unix_us: int, boot_ms: int) -> Measurements:
        """Take a SYSTEM_TIME; give what it says of a reboot."""
        step = self.clock.relate(unix_us, boot_ms)
        return [] if step is Step.FOLLOWED else self._leapt(step, "SYSTEM_TIME") or []

    def _leapt(self, step: Step, message: str) -> Measurements | None:
        if step is Step.HELD:
            self.refuse(f"{message}: stamp leaps")
            return None
        self._forget(step)
        if step is Step.SET:
            self.refused["clock set back"] += 1
            self.tell("The autopilot's clock was set back by less than a second; going on by it")
        return [Restart(goes_on=step is Step.SET)]
