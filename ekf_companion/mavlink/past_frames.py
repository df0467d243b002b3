"""The frames of the last seconds, to tell one that comes again from news.

A link that stalls, a router, a second path and whoever recorded a flight deliver frames a second
time. The bytes of a message that holds a stamp are its identity, whatever its sequence number and
signature: no sensor says the same at the same time twice. So one that was heard, and is older than
the newest of its kind, says nothing of the vehicle, and of the clock only that it is the old one.

A late frame that was not heard before is told from one of a clock that was set back by its place:
its sequence number lies between those of the frames of its kind before and after it, and none of
the frames that came between had it. The numbers of a clock that was set back go on.

Frames are kept as they are, and looked through when one comes whose stamp is behind.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Callable, Iterable
from itertools import islice
from struct import calcsize

from ekf_companion.mavlink.frame import Frame, Frames
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.timebase import TimeBase

KEPT = 8192
"""Frames: 20 s of a usual stream, four of the fastest."""
SLACK_US = 30_000
"""Messages of one cycle of the autopilot are stamped by up to so much before one another."""
STEADY_NS = SECOND_NS
"""Frames that come again for so long come by a second path; a burst is over sooner."""
_PAUSE_NS = SECOND_NS
"""Frames that come again after such a pause are of another time."""
SAMPLES = frozenset(IDS[name] for name in ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU"))
"""Theirs are behind by no more than a millisecond, to which other stamps are rounded."""
_FIXES = frozenset({IDS["GPS_RAW_INT"], IDS["GPS2_RAW"]})
"""Their stamps are those of the receiver's fixes, behind all others."""
_SAMPLE = IDS["HIGHRES_IMU"]
_SAMPLE_SIZE = 32
"""Bytes of its stamp, accelerations and rates: what else it holds depends on the link."""
_NAMES = {"time_usec": 1, "time_boot_ms": 1000}
"""Stamps by the autopilot's clock, and their unit, us."""
_HALF = 128
"""Of the sequence numbers: of two that lie further apart it is not known which was first."""
_MILLISECONDS = IDS["OPTICAL_FLOW"]
"""ArduPilot, from whom alone it is read, fills its time_usec with ms."""


_READ = (
    *("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE"),
    *("GPS_RAW_INT", "GPS2_RAW", "GLOBAL_POSITION_INT", "ATTITUDE", "SYSTEM_TIME"),
)
"""What the decoder reads, and is stamped, beside the messages of the aids."""


class _Order:
    """The order in which the frames of one autopilot were heard: their numbers and stamps."""

    def __init__(self) -> None:
        self._numbers: list[int] = []
        self._first = 0
        """How many were heard before those in it."""
        self._kinds: dict[int, list[tuple[int, int]]] = {}
        """Stamps, and how many frames were heard before each, by message id; by stamp."""

    def clear(self) -> None:
        self._numbers.clear()
        self._kinds.clear()
        self._first = 0

    def add(self, message: int, sequence: int, stamp: int | None) -> None:
        """Add the next frame; ``stamp`` is None where it has none that is read."""
        if len(self._numbers) == 2 * KEPT:
            del self._numbers[:KEPT]
            self._first += KEPT
            for heard in self._kinds.values():
                heard[:] = [one for one in heard if one[1] >= self._first]
        if stamp is not None:
            insort(self._kinds.setdefault(message, []), (stamp, self._first + len(self._numbers)))
        self._numbers.append(sequence)

    def misses(self, message: int, sequence: int, stamp: int) -> bool:
        """Return whether a frame lacks at its place: with this number, at this time."""
        heard = self._kinds.get(message, [])
        after = bisect_left(heard, (stamp, 0))
        if not 0 < after < len(heard):
            return False
        begin, end = (heard[i][1] - self._first for i in (after - 1, after))
        if not 0 < end - begin < _HALF:
            return False
        first, last = self._numbers[begin], self._numbers[end]
        count = (last - first) & 0xFF
        is_between = 0 < (sequence - first) & 0xFF < count < _HALF
        return is_between and sequence not in self._numbers[begin:end]


def _places(names: Iterable[str]) -> dict[int, tuple[int, int, int]]:
    """Return where the stamp lies in messages: begin, end, and its unit, us."""
    places = {}
    for number in (IDS[name] for name in names):
        layout = LAYOUTS[number]
        start = 0
        for field in layout.fields:
            width = calcsize(f"<{field.code}")
            if field.name in _NAMES and not field.length:
                unit = 1000 if number == _MILLISECONDS else _NAMES[field.name]
                places[number] = (start, start + width, unit)
                break
            start += width * (field.length or 1)
    return places


class PastFrames:
    """The frames of one autopilot that were heard lately."""

    def __init__(self, aids: Iterable[str] = ()) -> None:
        """Begin with none; ``aids`` names the messages of the aids that declare themselves."""
        self._places = _places((*_READ, *aids))
        self.again = 0
        """Frames that came again."""
        self.lag_us = 0
        """By how much the last of them were behind, at most."""
        self.is_named = False
        """Whether somebody was told of a second path."""
        self.is_late = False
        """Whether the last frame was behind, and not heard before."""
        self.is_in_place = False
        """Whether it was, and lacked at its place: it is late, and its clock the old one."""
        self._waiting: deque[Frame | tuple[Frames, int, int]] = deque(maxlen=KEPT)
        """What was heard and not looked through yet."""
        self.note: Callable[[Frame], None] = self._waiting.append
        """Keep a frame that was heard, where no run is kept: of a live stream."""
        self._more = 0
        """Frames of the runs in it, but for one of each."""
        self._keys: dict[tuple[int, bytes], None] = {}
        self._order = _Order()
        self.newest: dict[int, int] = {}
        """Stamps, us or ms, of the newest frames that were looked through, by message id. Those of
        fixes are of all that came, which the compiled reader notes too."""
        self._since_ns: int | None = None
        self._until_ns = 0

    def forget(self) -> None:
        """Forget all: another autopilot speaks, or this one's clock began anew."""
        self._waiting.clear()
        self._keys.clear()
        self._order.clear()
        self.newest.clear()
        self._more, self._since_ns = 0, None

    def keep(self, item: Frame | tuple[Frames, int, int]) -> None:
        """Keep a frame that was heard, or a run of them; drop what is too old."""
        if len(self._waiting) == KEPT:
            self._more -= _size(self._waiting[0]) - 1  # it makes room
        self._waiting.append(item)
        while (count := len(self._waiting) + self._more) > KEPT:
            size = _size(self._waiting[0])
            if count - size < KEPT:
                break
            self._waiting.popleft()
            self._more -= size - 1

    def keep_run(self, frames: Frames, begin: int, end: int) -> None:
        """Keep frames of a recording that were read, from one on."""
        begin = max(begin, end - KEPT)
        self._more += end - begin - 1
        self.keep((frames, begin, end))

    def is_stamped(self, number: int) -> bool:
        """Return whether a message is read, and says when it was true."""
        return number in self._places

    def is_behind(self, frame: Frame, clock: TimeBase) -> bool:
        """Return whether a frame may have been heard before, by its stamp."""
        if (place := self._places.get(frame.message_id)) is None:
            return False
        if (stamp := _stamp(frame.payload, place)) == 0:
            return False  # which is no time
        if frame.message_id in _FIXES:
            newest = self.newest.get(frame.message_id, 0)
            self.newest[frame.message_id] = max(newest, stamp)
            return stamp < newest
        behind = clock.behind(stamp, is_ms=place[2] != 1)
        return behind is not None and behind > (1000 if frame.message_id in SAMPLES else SLACK_US)

    def holds(self, frame: Frame, clock: TimeBase, now_ns: int) -> bool:
        """Return whether a frame was heard before and is old; keep it if it was not."""
        self.is_late, self.is_in_place = self.is_behind(frame, clock), False
        if not self.is_late:
            self.keep(frame)
            return False
        self._read(frame[1:3])
        number, place = frame.message_id, self._places[frame.message_id]
        stamp = _stamp(frame.payload, place)
        if stamp >= self.newest.get(number, 0):
            self.keep(frame)
            return False
        if _key(number, frame.payload) not in self._keys:
            self.is_in_place = self._order.misses(number, frame.sequence, stamp)
            return False  # not kept: of a clock that began anew, a copy says nothing of the old one
        self.is_late = False
        self.again += 1
        if self._since_ns is None or now_ns - self._until_ns > _PAUSE_NS:
            self._since_ns, self.lag_us = now_ns, 0
        self.lag_us = max(self.lag_us, clock.behind(stamp, is_ms=place[2] != 1) or 0)
        self._until_ns = now_ns
        return True

    @property
    def is_second_path(self) -> bool:
        """Whether frames have come again for longer than a burst lasts."""
        return self._since_ns is not None and self._until_ns - self._since_ns >= STEADY_NS

    def _read(self, source: tuple[int, int]) -> None:
        """Look through the frames of an autopilot that wait, and have come with others in a log."""
        for item in self._waiting:
            if isinstance(item, Frame):
                self._add(item)
                continue
            frames, begin, end = item
            for i in range(begin, end):
                if (frame := frames.frame(i))[1:3] == source:
                    self._add(frame)
        self._waiting.clear()
        self._more = 0
        if (excess := len(self._keys) - KEPT) > 0:
            for key in list(islice(self._keys, excess)):
                del self._keys[key]

    def _add(self, frame: Frame) -> None:
        number, payload = frame.message_id, frame.payload
        if (place := self._places.get(number)) is None:
            self._order.add(number, frame.sequence, None)
            return
        self._keys[_key(number, payload)] = None
        stamp = _stamp(payload, place)
        self._order.add(number, frame.sequence, stamp)
        if stamp > self.newest.get(number, 0):
            self.newest[number] = stamp


def _size(item: Frame | tuple[Frames, int, int]) -> int:
    return 1 if isinstance(item, Frame) else item[2] - item[1]


def _stamp(payload: bytes, place: tuple[int, int, int]) -> int:
    """Return a stamp as the message holds it; zeros at the payload's end may be missing."""
    return int.from_bytes(payload[place[0] : place[1]], "little")


def _key(number: int, payload: bytes) -> tuple[int, bytes]:
    return number, payload[:_SAMPLE_SIZE] if number == _SAMPLE else payload
