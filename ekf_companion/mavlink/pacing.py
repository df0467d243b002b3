"""How many ODOMETRY a line takes: all of them, or every second, third, ...

What each says stays the same, so a replay is not concerned. Whole numbers keep the pauses alike.
Where our messages queue, by the answers to TIMESYNC, half as many are sent; after a while without a
queue the next higher rate is tried, ever more seldom where that fails. Onto a line that answers
nothing for a moment nothing is sent at all, so that the queue stays short. Of requests that our own
loop held back no line is to blame: that is reported instead.
"""

from __future__ import annotations

from collections import deque

from ekf_companion.mavlink.event import Emit, Noted
from ekf_companion.mavlink.frame import HEADER_SIZE, SIGNATURE_SIZE
from ekf_companion.mavlink.lag import CROWDED, Lag
from ekf_companion.mavlink.messages import by_name
from ekf_companion.mavlink.stamp import SECOND_NS

_LADDER = (1, 2, 3, 4, 6, 8, 10)
"""Of so many ODOMETRY one is sent."""
SLOWEST = 5.0
"""Hz. ArduPilot wants 4 to 50; what PX4 gets more rarely than every 0.2 s it does not fuse."""
_USUAL = 30.0
"""Hz, until it is known how many there are."""
SHARE = 0.75
"""Of a serial line whose rate is known, for what we send."""
_OTHERS = 600.0
"""Bytes/s of ours beside ODOMETRY: requests of the time and of parameters, heartbeat, status."""
_SIZE = HEADER_SIZE + by_name("ODOMETRY").size
_QUEUE_NS = SECOND_NS * 8 // 100
"""So much longer than the fastest, three times in a row, is a queue: two ODOMETRY at 57600 baud."""
_IN_A_ROW = 3
_ROW_NS = SECOND_NS // 5
"""Over so long at least: what a stall held back arrives at once."""
_FULL_NS = SECOND_NS * 15 // 100
_GAP_NS = SECOND_NS * 3 // 10
"""Before such a queue the next waits, for so long at most: PX4 ends its fusion after 0.4 s."""
_CALM_NS = SECOND_NS // 20
_STEP_NS = SECOND_NS
"""Between two steps down: a queue needs its time to drain."""
_TRY_NS = 10 * SECOND_NS
_LONGEST_TRY_NS = 160 * SECOND_NS
"""Until a higher rate is tried; doubled each time that it fails."""
_STUCK_NS = 4 * SECOND_NS
"""A queue that the lowest rate has not shortened by then is none: the way has become longer."""
_WATCH_NS, _SLOW_WATCH_NS = SECOND_NS // 10, SECOND_NS // 5
"""Between two requests of the time; on a slow line they are to take no more than 150 bytes/s."""
_BUSY_NS = SECOND_NS // 20
"""A request that waits longer than the fastest, by more than this and the pause between two, stands
in a queue. A single one that is lost looks no longer than that pause."""


class Pacing:
    """Decides which ODOMETRY are sent."""

    def __init__(self, lag: Lag, emit: Emit) -> None:
        """Begin with all of them, on a line of which ``lag`` is known."""
        self.every = 1
        """Of so many one is sent."""
        self.capacity: float | None = None
        """Of a line whose rate is known, bytes/s."""
        self.is_signed = False
        """Whether what we send is signed."""
        self.asked_ns: int | None = None
        """When the time was asked first since the last answer; None: no question is open."""
        self._lag, self._emit = lag, emit
        self._count = self._sent_ns = 0
        self._published: deque[int] = deque(maxlen=16)
        self._row: deque[tuple[int, int, int]] = deque(maxlen=_IN_A_ROW)
        """When the last answers came, by how much they were slowed, and what of it was a queue."""
        self._crowded_ns: int | None = None
        """When our own loop was reported last."""
        self._stepped_ns: int | None = None
        self._stepped_queue = 0
        """How long the queue was when the rate was lowered last."""
        self._stuck_ns = 0
        self._try_ns = _TRY_NS
        self._is_trial = False

    def takes(self, now_ns: int) -> bool:
        """Return whether the line takes the next ODOMETRY."""
        lag, asked_ns, is_busy = self._lag, self.asked_ns, False
        self._published.append(now_ns)
        self._count += 1
        if asked_ns is not None and lag.fastest_ns is not None:
            is_busy = now_ns - asked_ns - lag.fastest_ns > self.watch_ns + _BUSY_NS
        if self.capacity is not None:
            self.every = max(self.every, self._least_every(self.capacity))
        is_full = lag.queue_ns > _FULL_NS and now_ns - self._sent_ns < _GAP_NS
        if self._count < self.every or is_busy or is_full:
            return False
        self._count, self._sent_ns = 0, now_ns
        return True

    @property
    def watch_ns(self) -> int:
        """Time between two requests of the time."""
        return _WATCH_NS if self.every == 1 else _SLOW_WATCH_NS

    @property
    def rate(self) -> float:
        """How often there is an ODOMETRY, sent or not, Hz."""
        if len(self._published) < (self._published.maxlen or 0):
            return _USUAL
        span = (self._published[-1] - self._published[0]) * 1e-9
        return (len(self._published) - 1) / span if span > 0.0 else _USUAL

    def _least_every(self, capacity: float) -> int:
        """Return what a line of a known rate, bytes/s, asks for."""
        size = _SIZE + (SIGNATURE_SIZE if self.is_signed else 0)
        rate, room = self.rate, max(SHARE * capacity - _OTHERS, 1.0)
        fitting = [k for k in _LADDER if rate / k * size <= room and rate / k >= SLOWEST]
        return fitting[0] if fitting else self._most_every()

    def _most_every(self) -> int:
        return max((k for k in _LADDER if self.rate / k >= SLOWEST), default=1)

    def on_answer(self, now_ns: int) -> None:
        """Send fewer where they queue, and more again after a while without a queue."""
        queue = self._lag.queue_ns
        self._row.append((now_ns, self._lag.slowed_ns, queue))
        is_row = len(self._row) == _IN_A_ROW and now_ns - self._row[0][0] >= _ROW_NS
        slowed, least = (min(column) for column in list(zip(*self._row, strict=True))[1:])
        least_every = 1 if self.capacity is None else self._least_every(self.capacity)
        since = _LONGEST_TRY_NS if self._stepped_ns is None else now_ns - self._stepped_ns
        if is_row and least > _QUEUE_NS and since >= _STEP_NS:
            self._lower(now_ns, least)
        elif is_row and slowed > _QUEUE_NS and self._lag.is_loop(slowed * 1e-9):
            self._report_loop(now_ns)
        elif queue < _CALM_NS and since >= self._try_ns and self.every > least_every:
            self.every = max((k for k in _LADDER if k < self.every), default=1)
            self._stepped_ns, self._is_trial, self._stepped_queue = now_ns, True, 0

    def _report_loop(self, now_ns: int) -> None:
        """Report that our own loop, and not the line, holds back what is sent."""
        since = _LONGEST_TRY_NS if self._crowded_ns is None else now_ns - self._crowded_ns
        if since >= _LONGEST_TRY_NS:
            waits = f"This board lets the daemon wait for {self._lag.loop_ns * 1e-6:.0f} ms"
            self._emit(Noted(f"{waits}, so that ODOMETRY leaves late: {CROWDED}"))
        self._crowded_ns = now_ns

    def _lower(self, now_ns: int, queue: int) -> None:
        """Send half as many, unless the queue grows shorter already."""
        if self.every < (most := self._most_every()):
            if queue < self._stepped_queue:
                self._stepped_queue = queue
                self._stepped_ns = now_ns
                return
            is_new = not self._is_trial or self._stepped_ns is None
            is_new = is_new or now_ns - (self._stepped_ns or 0) > _LONGEST_TRY_NS
            if self._is_trial:
                self._try_ns = min(2 * self._try_ns, _LONGEST_TRY_NS)
            self._is_trial = False
            self.every = min(next((k for k in _LADDER if k >= 2 * self.every), most), most)
            self._stepped_ns = self._stuck_ns = now_ns
            self._stepped_queue = queue
            self._row.clear()
            words = f"ODOMETRY goes out at {self.rate / self.every:.0f} Hz of {self.rate:.0f}"
            if is_new:
                text = f"The line to the autopilot is full, {queue * 1e-6:.0f} ms wait: {words}"
                self._emit(Noted(text))
        elif now_ns - self._stuck_ns >= _STUCK_NS and queue >= self._stepped_queue:
            self._stuck_ns = now_ns
            self._lag.rebase()
            self._row.clear()
