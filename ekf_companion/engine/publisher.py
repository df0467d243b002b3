"""Estimates as messages, each at its rate by the stamps of the inertial samples."""

from __future__ import annotations

import math
from collections.abc import Callable

from ekf_companion.config.config import Config
from ekf_companion.engine.health import Aid, Health
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import EstimatorHealth, Label, StatusFlag, label
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.state import Status

STREAMS = ("ODOMETRY", "ESTIMATOR_STATUS", "GPS_GLOBAL_ORIGIN")
"""What is sent of an estimate, and may be asked for."""
_LARGEST = {Family.ARDUPILOT: 50.0}
"""Of ODOMETRY, Hz: its EKF throws away what comes faster."""
_SMALLEST = {"ODOMETRY": 1.0}
_SELDOM = 0.1
"""Hz; more rarely is as good as never."""
_ANY = 1000.0
_BUSY = (math.inf, -math.inf)
"""A span that no stamp is in."""


def largest_rate(name: str, family: Family) -> float:
    """Give the rate above which a message is of no use to the autopilot, Hz."""
    return _LARGEST.get(family, _ANY) if name == "ODOMETRY" else _ANY


def smallest_rate(name: str) -> float:
    """Give the rate below which a message is as good as switched off, Hz."""
    return _SMALLEST.get(name, _SELDOM)


def default_rate(name: str, config: Config, family: Family) -> float:
    """Give the rate at which a message is sent where nobody asks for another, Hz."""
    if name != "ODOMETRY":
        return 1.0
    return min(config.output.odometry.rate, largest_rate(name, family))


class Due:
    """Says when something periodic is due, by the stamps of what drives it."""

    def __init__(self, rate: float) -> None:
        self._next_ns: int | None = None
        self._is_asked = False
        self.set_rate(rate)

    def set_rate(self, rate: float) -> None:
        """Go on at another rate, Hz; 0: only when asked."""
        self._period_ns = round(SECOND_NS / rate) if rate > 0.0 else 0

    def ask(self) -> None:
        """Have it due at the next stamp, out of turn."""
        self._is_asked = True

    @property
    def idle_ns(self) -> tuple[float, float]:
        """From and until which stamp nothing is due, while nobody asks."""
        if not self._period_ns:
            return -math.inf, math.inf
        if self._next_ns is None:
            return _BUSY
        return self._next_ns - self._period_ns, self._next_ns

    def is_due(self, t_ns: int) -> bool:
        """Whether a period has passed; a stamp far from the plan makes a new plan."""
        if self._is_asked or not self._period_ns:
            is_asked, self._is_asked = self._is_asked, False
            return is_asked
        if self._next_ns is not None and 0 < self._next_ns - t_ns <= self._period_ns:
            return False
        if self._next_ns is None or abs(t_ns - self._next_ns) > self._period_ns:
            self._next_ns = t_ns
        self._next_ns += self._period_ns
        return True


class Publisher:
    """Turns a pipeline's estimates into messages, each at its rate."""

    def __init__(
        self, config: Config, pipeline: Pipeline, family: Family, ours: Label | None = None
    ) -> None:
        """Begin with nothing published.

        Args:
            config: The rates, and what ODOMETRY is to say of itself.
            pipeline: Whose estimates.
            family: The listener's.
            ours: What ODOMETRY says of itself, whatever the configuration says.
        """
        self._pipeline, self._family = pipeline, family
        self._due = {name: Due(default_rate(name, config, family)) for name in STREAMS}
        self._account = Due(1.0)
        odometry = config.output.odometry
        self.label = ours or label(family, odometry.frame, odometry.estimator_type)
        """What every ODOMETRY says of itself."""
        self._was_invalid = False
        self._idle_ns = _BUSY
        self._origin: tuple[float, float, float] | None = None

    def retune(self, config: Config) -> None:
        """Send each at the rate of another configuration."""
        for name in STREAMS:
            self.set_rate(name, default_rate(name, config, self._family))

    def set_rate(self, name: str, rate: float) -> None:
        """Send a message at this rate, Hz; 0: only when asked."""
        self._due[name].set_rate(rate)
        self._idle_ns = _BUSY

    def ask(self, name: str) -> bool:
        """Have a message sent with the next estimate; False: there is none."""
        if name == "ODOMETRY":
            odometry = self._pipeline.odometry()
            has_one = odometry is not None and odometry.quality >= 0
        else:
            has_one = self._pipeline.origin is not None
        if has_one:
            self._due[name].ask()
            self._idle_ns = _BUSY
        return has_one

    def publish(self, send: Callable[[str, bytes], None]) -> Health | None:
        """Send what is due at the newest stamp; once a second give the filter's account."""
        t_ns = self._pipeline.stamp_ns
        begin_ns, end_ns = self._idle_ns
        if begin_ns <= t_ns < end_ns:
            return None
        if is_due := self._due["ODOMETRY"].is_due(t_ns):
            self._notice_origin()
        if self._due["GPS_GLOBAL_ORIGIN"].is_due(t_ns) and (origin := self._pipeline.origin):
            send("GPS_GLOBAL_ORIGIN", encode.gps_global_origin(*origin, t_ns=t_ns))
        if is_due:
            self._publish_odometry(send)
        if self._due["ESTIMATOR_STATUS"].is_due(t_ns) and self._pipeline.origin is not None:
            health = _judge(self._pipeline.health(), t_ns)
            send("ESTIMATOR_STATUS", encode.estimator_status(health))
        is_account_due = self._account.is_due(t_ns)
        spans = [due.idle_ns for due in (*self._due.values(), self._account)]
        self._idle_ns = max(begin for begin, _ in spans), min(end for _, end in spans)
        return self._pipeline.health() if is_account_due else None

    def _notice_origin(self) -> None:
        """Have a new origin sent before the first ODOMETRY that is about it."""
        origin = self._pipeline.origin
        if origin is not None and origin != self._origin:
            self._due["GPS_GLOBAL_ORIGIN"].ask()
        self._origin = origin

    def _publish_odometry(self, send: Callable[[str, bytes], None]) -> None:
        odometry = self._pipeline.odometry()
        if odometry is None:
            return
        # An invalid estimate is said to be so once, and then not sent
        is_invalid = odometry.quality < 0
        if not (is_invalid and self._was_invalid):
            ours = self.label
            send("ODOMETRY", encode.odometry(odometry, frame=ours.frame, estimator=ours.estimator))
        self._was_invalid = is_invalid


def _judge(health: Health, t_ns: int) -> EstimatorHealth:
    """Say the filter's health in the words of ESTIMATOR_STATUS."""
    flags = StatusFlag.ATTITUDE | StatusFlag.VELOCITY_HORIZ | StatusFlag.VELOCITY_VERT
    flags |= StatusFlag.POS_HORIZ_REL | StatusFlag.POS_HORIZ_ABS | StatusFlag.POS_VERT_ABS
    if health.status == Status.DEAD_RECKONING:
        flags &= ~StatusFlag.POS_HORIZ_ABS
        flags |= StatusFlag.PRED_POS_HORIZ_REL
    elif health.status == Status.INVALID:
        flags = StatusFlag.ATTITUDE
    if max(health.ratios[Aid.POSITION], health.ratios[Aid.VELOCITY]) > 1.0:
        flags |= StatusFlag.GPS_GLITCH
    return EstimatorHealth(
        t_ns=t_ns,
        flags=flags,
        vel_ratio=math.sqrt(health.ratios[Aid.VELOCITY]),
        pos_horiz_ratio=math.sqrt(health.ratios[Aid.POSITION]),
        pos_vert_ratio=math.sqrt(health.ratios[Aid.HEIGHT]),
        heading_ratio=math.sqrt(health.ratios[Aid.HEADING]),
        std_horiz=health.std_horizontal,
        std_vert=health.std_vertical,
    )
