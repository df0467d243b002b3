"""The autopilot's clock out of its messages' stamps: one time base, that nothing wild can move.

Stamps are microseconds since boot or since 1970, told apart by their size, or milliseconds since
boot that wrap after 49.7 days. The base is the one that the inertial messages use; what is
stamped on the other is moved over by SYSTEM_TIME, which names both.

One stamp far from the others says nothing: it may be an old packet, or a field that was never
set. So a leap is held back until a second stamp goes on from it: forward, that was a gap, which so
costs one message; back (or to the other base, or by more than an hour), the clock began anew, if
for a quarter of a second nothing else is heard. What is far is measured by the pace of the stamps:
where they come more rarely than once a second, two of their steps are not.

A step back by less than a second is at first taken for packets that were overtaken. Those have
others before and after them that are not; where all stamps stay behind while they go on by a
quarter of a second, the clock itself was set back.
"""

from __future__ import annotations

from enum import Enum

UNIX_FROM_US = 1_234_567_890_000_000
"""A stamp above is unix time; the bound that PX4 and MAVROS use (a day in 2009)."""
LAST_US = 4_000_000_000_000_000
"""The year 2096: what is stamped later holds no time."""
WRAP_US = (1 << 32) * 1000
"""The milliseconds since boot go round."""
BACK_US = 1_000_000
"""A clock that goes back by more has begun anew; by less, it may be that packets overtook one
another."""
AHEAD_US = 1_000_000
"""A link may be silent for so long without a doubt about the next stamp."""
SLOW_US = AHEAD_US // 2
"""A step above is that of a stream which may be silent for longer: for two such steps."""
LONG_US = 10_000_000
"""From a stamp that is held back another goes on if it is no further away; at no pace is more
taken unseen."""
GAP_US = 3_600_000_000
"""A leap of more than an hour is another clock, not a gap."""
SURE_US = 250_000
"""So long only the new clock must be heard: an old packet has others behind it that are not."""


class Step(Enum):
    """What a stamp did to the clock."""

    FOLLOWED = "followed"
    HELD = "held"
    """A leap that nothing has confirmed: what it stamps is of no known time."""
    BEGUN = "begun"
    """The clock began anew."""
    SET = "set"
    """The clock was set back by less than a second; the stamps since then are to be taken anew."""


class Count:
    """A count of microseconds, from stamps that may come late, or mean nothing."""

    __slots__ = ("ahead_us", "behind_us", "latest_us", "leap_us")

    def __init__(self) -> None:
        self.latest_us: int | None = None
        self.ahead_us = AHEAD_US
        """How far ahead the next may be without a doubt."""
        self.behind_us: int | None = None
        """The first of the stamps that have all been behind the latest; None: it is not so."""
        self.leap_us: int | None = None
        """The first stamp after a leap that is held back."""

    def take(self, stamp_us: int) -> Step:
        """Take the next stamp."""
        if self.latest_us is None:
            self.latest_us = stamp_us
            return Step.FOLLOWED
        step = stamp_us - self.latest_us
        if -BACK_US <= step <= self.ahead_us:
            self.leap_us = None
            return self._follow(stamp_us, step)
        if self.leap_us is None or not -BACK_US <= stamp_us - self.leap_us <= LONG_US:
            self.leap_us = stamp_us
            return Step.HELD
        is_gap = 0 < step <= GAP_US
        step = stamp_us - self.leap_us
        if step < (1 if is_gap else SURE_US):
            return Step.HELD
        self.latest_us, self.leap_us, self.behind_us = stamp_us, None, None
        self.ahead_us = _ahead(step)
        return Step.FOLLOWED if is_gap else Step.BEGUN

    def _follow(self, stamp_us: int, step: int) -> Step:
        """Take a stamp that goes on, or is behind: late, or of a clock that was set back."""
        if step >= 0:
            self.latest_us, self.behind_us, self.ahead_us = stamp_us, None, _ahead(step)
            return Step.FOLLOWED
        if self.behind_us is None or stamp_us < self.behind_us:
            self.behind_us = stamp_us
        if stamp_us - self.behind_us < SURE_US:
            return Step.FOLLOWED
        self.latest_us, self.behind_us = self.behind_us - 1, None
        return Step.SET


def _ahead(step_us: int) -> int:
    """Give how far ahead a stamp may be after a step."""
    return min(max(AHEAD_US, 2 * step_us), LONG_US)


class TimeBase:
    """One clock, from the stamps of one autopilot."""

    def __init__(self) -> None:
        self._main = Count()
        self._boot = Count()  # of the milliseconds, where the base is unix
        self._unix_minus_boot_us: int | None = None
        self._held_relation_us: int | None = None

    @property
    def latest_us(self) -> int | None:
        """The newest stamp, on the base of the inertial messages."""
        return self._main.latest_us

    @property
    def latest_ns(self) -> int | None:
        """The newest stamp as a time of validity for what has no stamp of its own."""
        latest = self._main.latest_us
        return None if latest is None else latest * 1000

    @property
    def is_behind(self) -> bool:
        """Whether the last stamps were all behind: late, or of a clock that was set back."""
        return self._main.behind_us is not None

    @property
    def is_unix(self) -> bool:
        """Whether the inertial messages are stamped in unix time."""
        latest = self._main.latest_us
        return latest is not None and latest > UNIX_FROM_US

    def goes_on(self, stamp_us: int) -> bool:
        """Take a stamp that the base follows, if it is the next; else leave it to ``advance``."""
        main = self._main
        latest = main.latest_us
        if latest is None or main.leap_us is not None or not 0 < stamp_us - latest <= SLOW_US:
            return False
        main.latest_us, main.behind_us, main.ahead_us = stamp_us, None, AHEAD_US
        return True

    def advance(self, stamp_us: int) -> Step:
        """Take a stamp that the base follows."""
        step = self._main.take(stamp_us)
        if step in (Step.BEGUN, Step.SET):
            # What is known of the milliseconds was so of the old clock
            self._boot = Count()
            self._unix_minus_boot_us = self._held_relation_us = None
        return step

    def advance_boot_ms(self, boot_ms: int) -> Step:
        """Take a stamp in milliseconds since boot."""
        if self.is_unix:
            step = self._boot.take(_unwrapped(boot_ms, self._boot.latest_us))
            if step in (Step.BEGUN, Step.SET):
                self._unix_minus_boot_us = self._held_relation_us = None
            return step
        leap = self._main.leap_us
        step = self.advance(_unwrapped(boot_ms, self._main.latest_us))
        if leap is not None and (leap > UNIX_FROM_US or _agrees(boot_ms, leap)):
            # It says nothing against an inertial clock in unix time, or many wraps on
            self._main.leap_us = self._main.leap_us or leap
        return step

    def relate(self, unix_us: int, boot_ms: int) -> Step:
        """Take a SYSTEM_TIME (unix 0: not known yet)."""
        step = self.advance_boot_ms(boot_ms)
        if step is not Step.HELD and UNIX_FROM_US < unix_us <= LAST_US:
            reference = self._boot.latest_us if self.is_unix else self._main.latest_us
            self._learn(unix_us - _unwrapped(boot_ms, reference))
        return step

    def _learn(self, unix_minus_boot_us: int) -> None:
        """Take a relation; one far from the last must be said twice."""
        known = (self._unix_minus_boot_us, self._held_relation_us)
        is_confirmed = any(
            one is not None and abs(unix_minus_boot_us - one) <= BACK_US for one in known
        )
        if known[0] is None or is_confirmed:
            self._unix_minus_boot_us, self._held_relation_us = unix_minus_boot_us, None
        else:
            self._held_relation_us = unix_minus_boot_us

    def from_us(self, stamp_us: int) -> int | None:
        """Give a stamp of either base in ns on ours; None: nothing relates the two yet."""
        if (stamp_us > UNIX_FROM_US) == self.is_unix:
            return stamp_us * 1000
        if self._unix_minus_boot_us is None:
            return None
        moved = self._unix_minus_boot_us if self.is_unix else -self._unix_minus_boot_us
        return (stamp_us + moved) * 1000

    def from_boot_ms(self, boot_ms: int) -> int | None:
        """Give a stamp in milliseconds since boot in ns; None: nothing relates it to ours yet."""
        reference = self._boot.latest_us if self.is_unix else self._main.latest_us
        return self.from_us(_unwrapped(boot_ms, reference))


def _unwrapped(boot_ms: int, latest_us: int | None) -> int:
    """Give milliseconds since boot in us, with the wraps that the newest stamp has behind it.

    A clock that began anew has none behind it. That, and no wrap, is what a leap ahead of more
    than an hour across the wrap would be.
    """
    if latest_us is None:
        return boot_ms * 1000
    latest_ms = latest_us // 1000
    wrap_ms = WRAP_US // 1000
    step_ms = (boot_ms - latest_ms + wrap_ms // 2) % wrap_ms - wrap_ms // 2
    is_across = (latest_ms + step_ms) // wrap_ms != latest_ms // wrap_ms
    if step_ms * 1000 < -BACK_US or (is_across and step_ms * 1000 > GAP_US):
        return boot_ms * 1000
    return max(latest_ms + step_ms, 0) * 1000


def _agrees(boot_ms: int, stamp_us: int) -> bool:
    """Whether milliseconds may be of a clock in microseconds, after any number of wraps."""
    away = (boot_ms * 1000 - stamp_us + WRAP_US // 2) % WRAP_US - WRAP_US // 2
    return abs(away) <= LONG_US
