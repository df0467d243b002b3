"""The autopilot's clock, from its messages' stamps: one time base that no wild stamp can move.

Stamps are microseconds since boot or since 1970, told apart by their size, or milliseconds since
boot that wrap after 49.7 days. Microseconds of 32 bits wrap after 71.6 minutes (RAW_IMU of
ArduPilot before 2021): the milliseconds beside them tell how often. The base is the one that the
inertial messages use; what is stamped on the other is moved over by SYSTEM_TIME, which names both.

One stamp far from the others proves nothing: it may be an old packet, or a field that was never
set (:mod:`ekf_companion.nav.stamps` has the rule of what is far). So a leap is held back until a
second stamp goes on from it. Forward, it was a gap, which thus costs one message. Backward (or to
the other base, or by more than an hour), the clock has restarted if nothing else is heard for a
quarter of a second. Where stamps come less often than once a second, two of their steps are not
far.

A stamp that is ahead by more than the stream's steps, and by less than a leap, is used, for packets
may have been lost before it; but the clock follows only when a second one goes on from it.

A step back by less than two seconds is at first taken for packets that were overtaken. Those have
others before and after them that are not; where all stamps stay behind while they go on by a
quarter of a second, the clock itself was set back.

Stamps that go on by a quarter of a second within milliseconds of our own clock are a burst of old
packets, and prove nothing; nor does a frame that was heard before (:mod:`.past_frames`), other than
that the old clock goes on. Nor does a late one whose place, by its number, is empty.
"""

from __future__ import annotations

from enum import Enum

from ekf_companion.mavlink.stamp import Stamp
from ekf_companion.nav.stamps import AHEAD_US, GAP_US, LONG_US, NEAR_US, SHORT, goes_on, rounds

UNIX_FROM_US = 1_234_567_890_000_000
"""A stamp above is unix time; the bound that PX4 and MAVROS use (a day in 2009)."""
LAST_US = 4_000_000_000_000_000
"""The year 2096: what is stamped later holds no time."""
SAME_US = 1_000_000
"""Two relations of unix time to the time since boot that differ by less are the same."""
STEPS = 16
"""Stamps after which a long step is all but forgotten; slow streams come several at a time."""
SURE_US = 250_000
"""Only the new clock must be heard for so long: an old packet is followed by others."""
PACE_US = SURE_US // 2
"""So long it takes by our clock at least: links deliver in pieces, and simulators run faster."""
FASTEST = 16
"""So much faster than time no simulator is flown: a stream that is has no times of arrival."""


class Step(Enum):
    """What a stamp means for the clock."""

    FOLLOWED = "followed"
    HELD = "held"
    """A leap that nothing has confirmed yet: the time of what it stamps is not known."""
    BEGUN = "begun"
    """The clock has restarted."""
    SET = "set"
    """The clock was set back by less than two seconds; the stamps since then must be read again."""


class Count:
    """A clock in microseconds, from stamps that may come late or be wrong."""

    def __init__(self) -> None:
        self.latest_us: int | None = None
        self.step_us: Stamp = 0
        """The longest of the last steps; in a slow stream the next may be twice as long."""
        self.doubt_us: int | None = None
        """A stamp so far ahead that the clock did not follow it, and that it has not reached."""
        self.is_doubtful = False
        """Whether the last stamp is that."""
        self._is_doubt_last = False
        self.behind_us: int | None = None
        """The first of the last stamps, which were all behind the latest; None: they were not."""
        self.behind_at_us: int | None = None
        """When it arrived, by our clock; None: not known."""
        self.leap_us: int | None = None
        """The first stamp after a leap that is held back."""
        self.leap_at_us: int | None = None
        """When it arrived, by our clock; None: not known."""
        self.leap_end_us: Stamp = 0
        """The last that went on from it."""
        self.first_us: Stamp = 0
        """The first stamp of this clock."""
        self.first_at_us: int | None = None
        """When it arrived, by our clock; None: not known."""

    def confirm(self) -> None:
        """Know that the clock goes on as it did: a frame of it was heard again, or late."""
        self.behind_us = self.leap_us = None

    def take(self, stamp_us: Stamp, now_us: int | None = None) -> Step:
        """Judge the next stamp, and follow it unless it is a leap.

        ``now_us`` is when it arrived, by our clock; None: not known.
        """
        self._is_doubt_last, self.is_doubtful = self.is_doubtful, False
        if self.latest_us is None:
            self._begin(stamp_us, now_us)
            return Step.FOLLOWED
        step = stamp_us - self.latest_us
        near = max(NEAR_US, min(2 * self.step_us, LONG_US))
        is_of_leap = self.leap_us is not None and 0 <= stamp_us - self.leap_end_us <= NEAR_US
        is_next = 0 <= step <= near or (goes_on(step, near) and not is_of_leap)
        if is_next or (step > near and self._is_confirmed(stamp_us)):
            self.leap_us = None
            return self._follow(stamp_us, step, now_us)
        if near < step <= AHEAD_US:
            self.leap_us, self.doubt_us, self.is_doubtful = None, stamp_us, True
            return Step.FOLLOWED
        if self.leap_us is None or not goes_on(stamp_us - self.leap_us, LONG_US):
            self.leap_us = self.leap_end_us = stamp_us
            self.leap_at_us = now_us
            return Step.HELD
        self.leap_end_us = stamp_us
        is_gap = step > 0 and goes_on(step, GAP_US)
        step = stamp_us - self.leap_us
        if step < (1 if is_gap else SURE_US):
            return Step.HELD
        if not is_gap and self._is_burst(self.leap_at_us, now_us):
            return Step.HELD
        self._begin(stamp_us, now_us)
        self.step_us = step
        self.leap_us = self.behind_us = self.doubt_us = None
        return Step.FOLLOWED if is_gap else Step.BEGUN

    def _begin(self, stamp_us: Stamp, now_us: int | None) -> None:
        self.latest_us = self.first_us = stamp_us
        self.first_at_us = now_us

    def _is_burst(self, since_us: int | None, now_us: int | None) -> bool:
        """Whether stamps came too fast since a time to be those of a clock that runs.

        Where the whole stream does, as that of a file that is read at once, arrival tells nothing.
        """
        if since_us is None or now_us is None or self.latest_us is None:
            return False
        if self.first_at_us is None:
            return False
        passed = self.latest_us - self.first_us
        return now_us - since_us < PACE_US and passed <= FASTEST * (now_us - self.first_at_us)

    def _is_confirmed(self, stamp_us: Stamp) -> bool:
        """Whether a stamp goes on from one that the clock did not follow."""
        if self.latest_us is None or self.doubt_us is None:
            return False
        if not self._is_doubt_last:
            # Others came between, as by a slower path: no other stray is so near
            return 0 < stamp_us - self.doubt_us <= NEAR_US
        far = max(AHEAD_US, min(2 * (self.doubt_us - self.latest_us), LONG_US))
        return -NEAR_US <= stamp_us - self.doubt_us <= far

    def _follow(self, stamp_us: Stamp, step: Stamp, now_us: int | None) -> Step:
        """Follow a stamp that goes on, or is behind: late, or of a clock that was set back."""
        if self.doubt_us is not None and stamp_us >= self.doubt_us - NEAR_US:
            self.doubt_us = None
        if step >= 0:
            self.latest_us, self.behind_us = stamp_us, None
            self.step_us = max(step, self.step_us - self.step_us // STEPS)
            return Step.FOLLOWED
        if self.behind_us is None:
            self.behind_us, self.behind_at_us = stamp_us, now_us
        self.behind_us = min(self.behind_us, stamp_us)
        if stamp_us - self.behind_us < SURE_US or self._is_burst(self.behind_at_us, now_us):
            return Step.FOLLOWED
        self.latest_us, self.behind_us = self.behind_us - 1, None
        return Step.SET


class TimeBase:
    """One clock, from the stamps of one autopilot."""

    def __init__(self) -> None:
        self.now_us: int | None = None
        """When the frame that is read arrived, by our clock; None: not known."""
        self.main = Count()
        """By the stamps of the base that the inertial messages use."""
        self._boot = Count()  # of the milliseconds, where the base is unix
        self._boot_us: int | None = None  # the last of the milliseconds, without those that leapt
        self._next_boot_us: int | None = None  # the last of all
        self._unix_minus_boot_us: int | None = None
        self._held_relation_us: int | None = None
        self.is_behind = False
        """Whether the last stamps were all behind: late, or of a clock that was set back."""

    @property
    def latest_us(self) -> int | None:
        """The newest stamp, on the base of the inertial messages."""
        return self.main.latest_us

    @property
    def latest_ns(self) -> int | None:
        """The newest stamp as a time of validity for what has no stamp of its own."""
        latest = self.main.latest_us
        return None if latest is None else latest * 1000

    @property
    def is_unix(self) -> bool:
        """Whether the inertial messages are stamped in unix time."""
        latest = self.main.latest_us
        return latest is not None and latest > UNIX_FROM_US

    @property
    def is_in_doubt(self) -> bool:
        """Whether the last stamp is so far ahead that the clock has not followed it."""
        return self.main.is_doubtful

    def follow(self, stamp_us: Stamp) -> bool:
        """Follow a stamp that plainly comes next; return False, changing nothing, for another."""
        main = self.main
        latest = main.latest_us
        if latest is None or main.leap_us is not None or not 0 < stamp_us - latest <= NEAR_US:
            return False
        if main.step_us > NEAR_US:
            return False
        main.latest_us, main.behind_us, main.is_doubtful = stamp_us, None, False
        if main.doubt_us is not None and stamp_us >= main.doubt_us - NEAR_US:
            main.doubt_us = None
        self.is_behind = False
        return True

    def advance(self, stamp_us: Stamp) -> Step:
        """Advance to a stamp of the inertial messages' base, or hold it back."""
        step = self.main.take(stamp_us, self.now_us)
        self.is_behind = self.main.behind_us is not None
        if step in (Step.BEGUN, Step.SET):
            # What is known of the milliseconds was so of the old clock
            self._boot = Count()
            self._unix_minus_boot_us = self._held_relation_us = None
            self._boot_us = self._next_boot_us = None
        return step

    def advance_boot_ms(self, boot_ms: Stamp) -> Step:
        """Advance to a stamp in milliseconds since boot, or hold it back."""
        self._note_boot(boot_ms)
        if self.is_unix:
            step = self._boot.take(_unwrapped(boot_ms, self._boot.latest_us), self.now_us)
            if step in (Step.BEGUN, Step.SET):
                self._unix_minus_boot_us = self._held_relation_us = None
            return step
        leap = self.main.leap_us
        step = self.advance(_unwrapped(boot_ms, self.main.latest_us))
        if leap is not None and (leap > UNIX_FROM_US or _agrees(boot_ms, leap)):
            # It does not contradict an inertial clock in unix time, or many wraps on
            self.main.leap_us = self.main.leap_us or leap
        return step

    def confirm(self) -> None:
        """Know that the clock goes on as it did: a frame of it was heard again, or late."""
        self.main.confirm()
        self._boot.confirm()

    def behind(self, stamp: Stamp, *, is_ms: bool) -> int | None:
        """Return by how much a stamp is behind the newest of its base, us; None: not known.

        The stamp is in us of either base, or in ms since boot.
        """
        if is_ms:
            latest = self._boot.latest_us if self.is_unix else self.main.latest_us
            stamp = _unwrapped(stamp, latest)
        else:
            stamp = self.widened(stamp)
            is_mains = (stamp > UNIX_FROM_US) == self.is_unix
            latest = self.main.latest_us if is_mains else self._boot.latest_us
            if latest is not None and (latest > UNIX_FROM_US) != (stamp > UNIX_FROM_US):
                return None
        return None if latest is None else latest - stamp

    def _note_boot(self, boot_ms: Stamp) -> None:
        """Note milliseconds since boot; those that leap count when others go on from them."""
        latest = self._boot.latest_us if self.is_unix else self.main.latest_us
        boot_us = _unwrapped(boot_ms, latest)
        if self._next_boot_us is None or abs(boot_us - self._next_boot_us) <= LONG_US:
            self._boot_us = boot_us
        self._next_boot_us = boot_us

    def widened(self, stamp_us: Stamp) -> Stamp:
        """Return microseconds since boot that may have 32 bits with the wraps that they lack."""
        reference = self._boot_us
        if reference is None:
            reference = self.main.latest_us
        if reference is None or stamp_us >= SHORT or reference > UNIX_FROM_US:
            return stamp_us
        return stamp_us + SHORT * int(rounds(stamp_us, reference, SHORT, LONG_US))

    def relate(self, unix_us: Stamp, boot_ms: Stamp) -> Step:
        """Advance by a SYSTEM_TIME, and learn how its two clocks are related (unix 0: unknown)."""
        step = self.advance_boot_ms(boot_ms)
        if step is not Step.HELD and UNIX_FROM_US < unix_us <= LAST_US:
            reference = self._boot.latest_us if self.is_unix else self.main.latest_us
            self._learn(unix_us - _unwrapped(boot_ms, reference))
        return step

    def _learn(self, unix_minus_boot_us: Stamp) -> None:
        """Learn how the clocks are related; a relation far from the last must come twice."""
        known = (self._unix_minus_boot_us, self._held_relation_us)
        is_confirmed = any(
            one is not None and abs(unix_minus_boot_us - one) <= SAME_US for one in known
        )
        if known[0] is None or is_confirmed:
            self._unix_minus_boot_us, self._held_relation_us = unix_minus_boot_us, None
        else:
            self._held_relation_us = unix_minus_boot_us

    def from_us(self, stamp_us: Stamp) -> int | None:
        """Return a stamp of either base in ns on ours; None if nothing relates the two yet."""
        if (stamp_us > UNIX_FROM_US) == self.is_unix:
            return stamp_us * 1000
        if self._unix_minus_boot_us is None:
            return None
        moved = self._unix_minus_boot_us if self.is_unix else -self._unix_minus_boot_us
        return (stamp_us + moved) * 1000

    def from_boot_ms(self, boot_ms: Stamp) -> int | None:
        """Return milliseconds since boot in ns on our base; None if nothing relates the two yet."""
        reference = self._boot.latest_us if self.is_unix else self.main.latest_us
        return self.from_us(_unwrapped(boot_ms, reference))


def _unwrapped(boot_ms: Stamp, latest_us: int | None) -> Stamp:
    """Return milliseconds since boot in us, with as many wraps added as the newest stamp has.

    A clock that has restarted has had no wrap. A leap ahead across a wrap by more than an hour is
    taken for a restart.
    """
    if latest_us is None:
        return boot_ms * 1000
    latest_ms = latest_us // 1000
    step_ms = (boot_ms - latest_ms + SHORT // 2) % SHORT - SHORT // 2
    is_across = (latest_ms + step_ms) // SHORT != latest_ms // SHORT
    if (step_ms < 0 or is_across) and not goes_on(step_ms * 1000, GAP_US):
        return boot_ms * 1000
    return max(latest_ms + step_ms, 0) * 1000


def _agrees(boot_ms: Stamp, stamp_us: Stamp) -> bool:
    """Whether milliseconds fit a clock in microseconds, after one wrap or more."""
    wrap_us = SHORT * 1000
    away = (boot_ms * 1000 - stamp_us + wrap_us // 2) % wrap_us - wrap_us // 2
    return abs(away) <= LONG_US < abs(boot_ms * 1000 - stamp_us)
