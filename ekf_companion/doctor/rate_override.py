"""Whether somebody overrides the rates of our streams after they were granted to us.

A ground station asks for all groups of messages at one rate, again and again. A rate measured over
a whole examination, in which we ask again too, would show neither its rate nor ours.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from statistics import median

from ekf_companion.mavlink.audit import INERTIAL
from ekf_companion.mavlink.stamp import SECOND_NS

GROUND = 12.0
"""Highest rate that a ground station sets, Hz."""
ALIKE = 0.25
"""Streams whose rates differ by no more than this share were set by one program."""
STREAMED = (
    *INERTIAL,
    *("GPS_RAW_INT", "ATTITUDE", "GLOBAL_POSITION_INT", "SCALED_PRESSURE", "VFR_HUD"),
    *("SYS_STATUS", "RC_CHANNELS", "SERVO_OUTPUT_RAW", "AHRS2", "VIBRATION", "LOCAL_POSITION_NED"),
)
"""The messages whose rates a ground station sets."""
_WINDOW_NS = 2 * SECOND_NS
"""Eight messages at 4 Hz; and less time than we take to notice, and to ask again."""
_FASTER = 1.5
"""Factor by which the inertial message is slowed more than the others; no slow link does that."""


class RateOverride:
    """Measures the rates of streams in windows between our requests."""

    def __init__(self) -> None:
        self.rate = 0.0
        """Common rate at which they last came, Hz; 0 if they never had one."""
        self._counts: Counter[str] = Counter()
        self._begin_ns: int | None = None

    def restart(self) -> None:
        """Begin a new window, as we are setting rates ourselves."""
        self._begin_ns = None

    def add(self, name: str, now_ns: int, granted: Callable[[], Mapping[str, float]]) -> None:
        """Count a message of the autopilot; ``granted`` returns the rates granted to us, Hz."""
        if self._begin_ns is not None and now_ns - self._begin_ns >= _WINDOW_NS:
            seconds = (now_ns - self._begin_ns) * 1e-9
            rates = {one: count / seconds for one, count in self._counts.items()}
            self._judge(rates, granted())
            self._begin_ns = None
        if self._begin_ns is None:
            self._begin_ns = now_ns
            self._counts.clear()
        self._counts[name] += 1

    def _judge(self, rates: Mapping[str, float], granted: Mapping[str, float]) -> None:
        slowed = {
            name: rates[name]
            for name in STREAMED
            if 0.0 < rates.get(name, 0.0) < granted.get(name, 0.0) * (1.0 - ALIKE)
        }
        inertial = next((name for name in INERTIAL if name in slowed), None)
        if inertial is None or len(slowed) < 3:
            return
        usual = median(slowed.values())
        alike = [name for name, rate in slowed.items() if abs(rate - usual) <= ALIKE * usual]
        shares = [slowed[name] / granted[name] for name in alike if name != inertial]
        if inertial not in alike or len(alike) < 3 or usual > GROUND:
            return
        if median(shares) > _FASTER * slowed[inertial] / granted[inertial]:
            self.rate = usual
