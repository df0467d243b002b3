"""What the autopilot reports of its receiver, of its filter and in texts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ekf_companion.doctor.evidence import Feedback, Receiver
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Frame

_TEXTS = 16
_CRITICAL = 2
_FIX_3D = 3
_UNKNOWN_16 = 65535


class AutopilotReports:
    """Keeps the last report of each kind."""

    def __init__(self) -> None:
        self.receiver = Receiver()
        self.feedback = Feedback()
        """Its reports on its filter and on our messages."""
        self._fix: tuple[int, tuple[int, ...]] = (0, ())
        self._fix_ns = 0
        self._handlers: dict[str, Callable[[Any, int], None]] = {
            "EKF_STATUS_REPORT": self._on_ekf_status,
            "ESTIMATOR_STATUS": self._on_estimator_status,
            "GPS_RAW_INT": self._on_receiver,
            "STATUSTEXT": self._on_text,
        }

    def receive(self, name: str, frame: Frame, now_ns: int) -> None:
        """Process a frame from the autopilot; ``name`` is that of its message."""
        if (handler := self._handlers.get(name)) is not None:
            handler(unpack(frame), now_ns)

    def _on_ekf_status(self, m: Any, now_ns: int) -> None:
        worst = _largest(m.velocity_variance, m.pos_horiz_variance, m.pos_vert_variance)
        self.feedback = replace(self.feedback, flags=m.flags, worst_ratio=worst)

    def _on_estimator_status(self, m: Any, now_ns: int) -> None:
        worst = _largest(m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio)
        self.feedback = replace(self.feedback, flags=m.flags, worst_ratio=worst)

    def _on_receiver(self, m: Any, now_ns: int) -> None:
        has_fix = m.fix_type >= _FIX_3D
        still_s = self._repeated_s(m, now_ns) if has_fix else 0.0
        self.receiver = Receiver(
            messages=self.receiver.messages + 1,
            fix_type=m.fix_type,
            satellites=m.satellites_visible,
            has_accuracy=m.h_acc != 0,
            without_time=self.receiver.without_time + (has_fix and m.time_usec == 0),
            still_s=still_s,
            longest_still_s=max(self.receiver.longest_still_s, still_s),
        )

    def _repeated_s(self, m: Any, now_ns: int) -> float:
        """Return for how long the same fix has been repeated, s, by its time or by its numbers.

        Equal numbers count, whatever the time, only in motion: at rest a receiver may hold them.
        """
        (time_usec, numbers), fix = self._fix, (m.time_usec, (m.lat, m.lon, m.alt, m.vel, m.cog))
        self._fix = fix
        is_timed, is_moving = m.time_usec > 0, 0 < m.vel < _UNKNOWN_16
        has_time = is_timed and m.time_usec == time_usec
        has_numbers = fix[1] == numbers and (is_moving or not is_timed)
        if not (has_time or has_numbers):
            self._fix_ns = now_ns
        return (now_ns - self._fix_ns) * 1e-9

    def _on_text(self, m: Any, now_ns: int) -> None:
        text = m.text.decode("utf-8", "replace")
        texts = self.feedback.texts
        if (m.severity <= _CRITICAL or "ODOMETRY" in text) and text not in texts:
            self.feedback = replace(self.feedback, texts=(*texts, text)[-_TEXTS:])


def _largest(*ratios: float) -> float:
    return max((ratio for ratio in ratios if math.isfinite(ratio)), default=math.nan)
