"""The frames of the last seconds, to tell one that comes again from news.

A link that stalls, a router, a second path and whoever recorded a flight deliver frames a second
time. The bytes of a message that holds a stamp are its identity, whatever its sequence number and
signature: no sensor says the same at the same time twice. So one that was heard, and is older than
the newest of its kind, says nothing of the vehicle, and of the clock only that it is the old one.

Frames are kept as they are, and looked through when one comes whose stamp is behind.
"""

from __future__ import annotations

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
_SAMPLES = frozenset(IDS[name] for name in ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU"))
"""Theirs are behind by no more than a millisecond, to which other stamps are rounded."""
_FIXES = frozenset({IDS["GPS_RAW_INT"], IDS["GPS2_RAW"]})
"""Their stamps are those of the receiver's fixes, behind all others."""
_SAMPLE = IDS["HIGHRES_IMU"]
_SAMPLE_SIZE = 32
"""Bytes of its stamp, accelerations and rates: what else it holds depends on the link."""
_NAMES = {"time_usec": 1, "time_boot_ms": 1000}
"""Stamps by the autopilot's clock, and their unit, us."""
_MILLISECONDS = IDS["OPTICAL_FLOW"]
"""ArduPilot, from whom alone it is read, fills its time_usec with ms."""


_READ = (
    *("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE"),
    *("GPS_RAW_INT", "GPS2_RAW", "GLOBAL_POSITION_INT", "ATTITUDE", "SYSTEM_TIME"),
)
"""What the decoder reads, and is stamped, beside the messages of the aids."""


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
        self._waiting: deque[Frame | tuple[Frames, int, int]] = deque(maxlen=KEPT)
        """What was heard and not looked through yet."""
        self.note: Callable[[Frame], None] = self._waiting.append
        """Keep a frame that was heard, where no run is kept: of a live stream."""
        self._more = 0
        """Frames of the runs in it, but for one of each."""
        self._keys: dict[tuple[int, bytes], None] = {}
        self.newest: dict[int, int] = {}
        """Stamps, us or ms, of the newest frames that were looked through, by message id. Those of
        fixes are of all that came, which the compiled reader notes too."""
        self._since_ns: int | None = None
        self._until_ns = 0

    def forget(self) -> None:
        """Forget all: another autopilot speaks, or this one's clock began anew."""
        self._waiting.clear()
        self._keys.clear()
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
        return behind is not None and behind > (1000 if frame.message_id in _SAMPLES else SLACK_US)

    def holds(self, frame: Frame, clock: TimeBase, now_ns: int) -> bool:
        """Return whether a frame was heard before and is old; keep it if it was not."""
        self.is_late = self.is_behind(frame, clock)
        if not self.is_late:
            self.keep(frame)
            return False
        self._read()
        number, place = frame.message_id, self._places[frame.message_id]
        stamp = _stamp(frame.payload, place)
        if stamp >= self.newest.get(number, 0):
            self.keep(frame)
            return False
        if _key(number, frame.payload) not in self._keys:
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

    def _read(self) -> None:
        """Look through the frames that wait."""
        for item in self._waiting:
            if isinstance(item, Frame):
                self._add(item.message_id, item.payload)
                continue
            frames, begin, end = item
            for i in range(begin, end):
                frame = frames.frame(i)
                self._add(frame.message_id, frame.payload)
        self._waiting.clear()
        self._more = 0
        if (excess := len(self._keys) - KEPT) > 0:
            for key in list(islice(self._keys, excess)):
                del self._keys[key]

    def _add(self, number: int, payload: bytes) -> None:
        if (place := self._places.get(number)) is None:
            return
        self._keys[_key(number, payload)] = None
        stamp = _stamp(payload, place)
        if stamp > self.newest.get(number, 0):
            self.newest[number] = stamp


def _size(item: Frame | tuple[Frames, int, int]) -> int:
    return 1 if isinstance(item, Frame) else item[2] - item[1]


def _stamp(payload: bytes, place: tuple[int, int, int]) -> int:
    """Return a stamp as the message holds it; zeros at the payload's end may be missing."""
    return int.from_bytes(payload[place[0] : place[1]], "little")


def _key(number: int, payload: bytes) -> tuple[int, bytes]:
    return number, payload[:_SAMPLE_SIZE] if number == _SAMPLE else payload
