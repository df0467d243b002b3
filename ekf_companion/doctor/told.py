"""What the autopilot tells of itself, kept as it is told."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

from ekf_companion.doctor.evidence import Feedback, Receiver
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Frame

_TEXTS = 16
_CRITICAL = 2
_FIX_3D = 3


class Told:
    """The autopilot's receiver, filter and texts."""

    def __init__(self) -> None:
        self.receiver = Receiver()
        self._texts: deque[str] = deque(maxlen=_TEXTS)
        self._flags: int | None = None
        self._worst_ratio = math.nan
        self._handlers: dict[str, Callable[[Any], None]] = {
            "EKF_STATUS_REPORT": self._take_ekf_status,
            "ESTIMATOR_STATUS": self._take_estimator_status,
            "GPS_RAW_INT": self._take_receiver,
            "STATUSTEXT": self._take_text,
        }

    def take(self, name: str, frame: Frame) -> None:
        """Take a frame of the autopilot's, by its message's name."""
        if (handler := self._handlers.get(name)) is not None:
            handler(unpack(frame))

    def feedback(self) -> Feedback:
        """Give what it says of its filter and of our messages."""
        return Feedback(texts=tuple(self._texts), flags=self._flags, worst_ratio=self._worst_ratio)

    def _take_ekf_status(self, m: Any) -> None:
        self._flags = m.flags
        self._worst_ratio = _largest(m.velocity_variance, m.pos_horiz_variance, m.pos_vert_variance)

    def _take_estimator_status(self, m: Any) -> None:
        self._flags = m.flags
        self._worst_ratio = _largest(m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio)

    def _take_receiver(self, m: Any) -> None:
        has_fix = m.fix_type >= _FIX_3D
        self.receiver = Receiver(
            messages=self.receiver.messages + 1,
            fix_type=m.fix_type,
            satellites=m.satellites_visible,
            has_accuracy=m.h_acc != 0,
            without_time=self.receiver.without_time + (has_fix and m.time_usec == 0),
        )

    def _take_text(self, m: Any) -> None:
        text = m.text.decode("utf-8", "replace")
        if (m.severity <= _CRITICAL or "ODOMETRY" in text) and text not in self._texts:
            self._texts.append(text)


def _largest(*ratios: float) -> float:
    return max((ratio for ratio in ratios if math.isfinite(ratio)), default=math.nan)
