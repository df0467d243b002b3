"""What the readers of one autopilot's messages share.

The autopilot's family and clock, counts of what was refused, notes for a human, and the choice
among several sources of one thing.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.timebase import LAST_US, Step, TimeBase
from ekf_companion.nav.measurements import Measurement, Restart

Measurements = list[Measurement]
NOTES = 32
"""Notes that wait to be read, at most; the oldest are dropped first."""
ABSENT_NS = 3 * SECOND_NS
"""A better source must be silent for so long before the next one is used."""
STEADY_NS = SECOND_NS
"""A better source must speak steadily for so long before it is used instead of a worse one."""
_SHARE = 0.5
"""The better source must bring this share of the messages of the one in use: a message that was
requested once, or once a second, is none to fly on."""
_BURST = 8
"""Messages of the source in use behind one another; a steady source has spoken in between."""


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


class Context:
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


class _Challenger:
    """What is known of a source that is not in use, since it began to speak."""

    __slots__ = ("count", "first_ns", "since", "used")

    def __init__(self, t_ns: int, used: int) -> None:
        self.first_ns, self.count = t_ns, 1
        self.used = self.since = used
        """Messages of the source in use until it began, and until it last spoke."""


class Preference:
    """Uses, of several sources of one thing, the best that speaks steadily, by their own stamps.

    At the start the best is waited for.
    """

    __slots__ = ("_challengers", "_starving", "_used", "_waiting_ns", "rank", "sole")

    def __init__(self, starving: float = 0.0) -> None:
        """Begin with the best.

        A source in use that brings less than the share ``starving`` of the messages of a worse one,
        for three seconds, counts as silent.
        """
        self.rank = 0
        """Of the source in use: 0 is the best."""
        self.sole = 0
        """The same while no other source speaks: :meth:`admit` need not be asked then; else -1."""
        self._starving = starving
        self._used = 0
        """Messages of the source in use, counted while others speak."""
        self._waiting_ns: int | None = None
        """When a worse source first spoke since the one in use last did.

        Counted from there, so that a link's silence speaks against no source.
        """
        self._challengers: dict[int, _Challenger] = {}

    def use(self, rank: int) -> None:
        """Use the source of this rank at once: better ones are known to be silent."""
        self.rank = rank
        self.sole = -1 if self._challengers else rank

    def admit(self, rank: int, t_ns: int) -> bool:
        """Whether to use a source now, by its rank and its own stamp."""
        if rank == self.rank:
            self._used += 1
            self._waiting_ns = None
            return True
        one = self._challengers.get(rank)
        if one is None or t_ns < one.first_ns:
            one = self._challengers[rank] = _Challenger(t_ns, self._used)
            self.sole = -1
        else:
            one.count += 1
        is_taken = self._is_steady(one, t_ns) if rank < self.rank else self._is_needed(one, t_ns)
        if is_taken:
            self._challengers.clear()
            self._used, self._waiting_ns = 0, None
            self.use(rank)
        return is_taken

    def _is_steady(self, one: _Challenger, t_ns: int) -> bool:
        """Whether a better source has spoken long and often enough; if not, watch it anew."""
        used, is_burst = self._used - one.used, self._used - one.since > _BURST
        one.since = self._used
        if not is_burst and t_ns - one.first_ns < STEADY_NS:
            return False
        if not is_burst and one.count > _SHARE * used:
            return True
        one.first_ns, one.count, one.used = t_ns, 1, self._used
        return False

    def _is_needed(self, one: _Challenger, t_ns: int) -> bool:
        """Whether the source in use is silent, or as good as silent beside a worse one."""
        if self._waiting_ns is None or t_ns < self._waiting_ns:
            self._waiting_ns = t_ns
        if t_ns - self._waiting_ns > ABSENT_NS:
            return True
        if t_ns - one.first_ns <= ABSENT_NS:
            return False
        is_starving = self._used - one.used < self._starving * one.count
        one.first_ns, one.count, one.used = t_ns, 1, self._used
        return is_starving


class Pace:
    """Thins a stream to a rate by its own stamps."""

    __slots__ = ("_last_ns", "_period_ns")

    def __init__(self, rate: float) -> None:
        self._period_ns = round(SECOND_NS / rate * 0.99)  # stamps jitter
        self._last_ns: int | None = None

    def admit(self, t_ns: int) -> bool:
        """Whether a period has passed since the last that was admitted."""
        if self._last_ns is not None and 0 <= t_ns - self._last_ns < self._period_ns:
            return False
        self._last_ns = t_ns
        return True
