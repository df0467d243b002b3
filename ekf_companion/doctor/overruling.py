"""Whether somebody sets our streams to a rate of his own, after they were granted to us.

A ground station asks for all groups of messages at one rate, again and again; what is measured
over a whole examination, in which we ask anew too, shows neither its rate nor ours.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from statistics import median

from ekf_companion.mavlink.audit import INERTIAL
from ekf_companion.mavlink.stamp import SECOND_NS

GROUND = 12.0
"""A ground station sets streams no faster than this, Hz."""
ALIKE = 0.25
"""Streams whose rates differ by no more, as a share, were set by one hand."""
STREAMED = (
    *INERTIAL,
    *("GPS_RAW_INT", "ATTITUDE", "GLOBAL_POSITION_INT", "SCALED_PRESSURE", "VFR_HUD"),
    *("SYS_STATUS", "RC_CHANNELS", "SERVO_OUTPUT_RAW", "AHRS2", "VIBRATION", "LOCAL_POSITION_NED"),
)
"""What a ground station's requests set."""
_WINDOW_NS = 2 * SECOND_NS
"""Eight of 4 Hz; and less than we take to notice, and ask anew."""
_FASTER = 1.5
"""The inertial message loses more than the others by so much: no link thins so."""


class Overruling:
    """Counts streams by windows, between our requests."""

    def __init__(self) -> None:
        self.rate = 0.0
        """At which they last came alike, Hz; 0: they never did."""
        self._counts: Counter[str] = Counter()
        self._begin_ns: int | None = None

    def restart(self) -> None:
        """Begin a window anew: we are setting rates ourselves."""
        self._begin_ns = None

    def take(self, name: str, now_ns: int, granted: Callable[[], Mapping[str, float]]) -> None:
        """Count a message of the autopilot's.

        Args:
            name: Which.
            now_ns: When it came.
            granted: Gives the rates granted to us, Hz.
        """
        if self._begin_ns is None:
            self._begin_ns = now_ns
            self._counts.clear()
        elif now_ns - self._begin_ns >= _WINDOW_NS:
            seconds = (now_ns - self._begin_ns) * 1e-9
            rates = {one: count / seconds for one, count in self._counts.items()}
            self._judge(rates, granted())
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
