"""The messages that are due: the requested rates, and the autopilot's own rules."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from ekf_companion.mavlink.messages import by_name
from sim_autopilot.config import SimConfig
from sim_autopilot.personality import DENIED, Kind, Pacing, Personality

ACCEPTED = 0
GNSS = "GPS_RAW_INT"
_SECOND_NS = 1_000_000_000
_CONSTANT = frozenset({"HEARTBEAT"})
"""Messages that the limit of the link never slows down."""
_OVERHEAD = 12
"""Bytes of a frame beside its payload."""
_SLOWEST = 0.05
"""Smallest part of its rate that a stream keeps (PX4)."""
_EARLY = 0.05
"""Part of a loop iteration that a stream may be early (PX4 main loop's tolerance)."""
_LOOP_SHARE = 0.8
"""Largest rate of a stream, as a part of the loop's rate (ArduPilot)."""

GROUPS: Mapping[int, tuple[str, ...]] = {
    1: ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE"),
    2: (GNSS, "GPS2_RAW"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    12: ("SYSTEM_TIME",),
}
"""Messages of REQUEST_DATA_STREAM by MAV_DATA_STREAM (ArduPilot); 0 stands for all."""


class Streams:
    """The rates of one link."""

    def __init__(
        self,
        personality: Personality,
        config: SimConfig,
        parameters: Mapping[str, float],
        also: Iterable[str] = (),
    ) -> None:
        """Begin with the default rates; ``parameters`` is read at each update, not copied.

        The messages ``also`` are not sent until they are requested.
        """
        own = personality.streams
        if own is None:
            own = {name: getattr(config.streams, name) for name in config.streams.__slots__}
        own = {**_spares(config, personality.kind), **own}
        own = {**own, **dict.fromkeys(also, 0.0)}
        self._default = own
        self._rates = dict(own)
        self._personality = personality
        self._parameters = parameters
        self._loop_rate = personality.loop_rate or config.imu.rate
        if personality.vehicle_imu_rate:
            self._loop_rate = min(self._loop_rate, personality.vehicle_imu_rate)
        self._fix_rate = config.gnss.rate
        self._fixes = 0
        self._every: dict[str, int] = {}
        self._next_ns: dict[str, int] = dict.fromkeys(own, 0)
        self.update()

    def __contains__(self, name: str) -> bool:
        """Whether there is such a message."""
        return name in self._rates

    def request(self, name: str, interval_us: float) -> int:
        """Execute SET_MESSAGE_INTERVAL; return the result of its COMMAND_ACK."""
        if name not in self._rates:
            return self._personality.no_such_stream
        rate = self._default[name]
        if interval_us > 0.0:
            rate = 1e6 / interval_us
            if self._personality.pacing is Pacing.MILLISECONDS:
                rate = 1e3 / max(1, int(interval_us / 1e3))
                if self.is_too_fast(name, interval_us):
                    return DENIED
        elif interval_us < 0.0:
            rate = 0.0
        self._rates[name] = rate
        self._next_ns[name] = 0
        self.update()
        return ACCEPTED

    def is_too_fast(self, name: str, interval_us: float) -> bool:
        """Whether the loop is too slow for a message at this interval (ArduPilot)."""
        if self._personality.pacing is not Pacing.MILLISECONDS or name not in self._rates:
            return False
        return interval_us > 0.0 and 1e3 / max(1, int(interval_us / 1e3)) > self._fastest

    def request_group(self, group: int, rate: float) -> None:
        """Execute REQUEST_DATA_STREAM; a rate too high becomes the highest possible."""
        for number, names in GROUPS.items():
            if group in (0, number):
                own = [name for name in names if name in self._rates]
                self._rates |= dict.fromkeys(own, min(rate, self._fastest))
        self.update()

    def due(self, number: int, t_ns: int, has_fix: bool) -> list[str]:
        """Return the messages of a loop iteration, by its number and its time."""
        if self._personality.pacing is Pacing.MILLISECONDS:
            return [name for name in self._rates if self._is_over(name, t_ns)]
        names = [
            name
            for name, every in self._every.items()
            if name != GNSS and every and number % every == 0
        ]
        if has_fix:
            self._fixes += 1
            if self._every.get(GNSS) and self._fixes % self._every[GNSS] == 0:
                names.append(GNSS)
        return names

    def is_wanted(self, name: str) -> bool:
        """Whether a message is streamed at all."""
        return self._rates.get(name, 0.0) > 0.0

    def update(self) -> None:
        """Convert rates to whole numbers of loop iterations, within the limit of the link."""
        scale = self._scale()
        self._every = {
            name: self._divide(name, rate if name in _CONSTANT else rate * scale)
            for name, rate in self._rates.items()
        }

    @property
    def _fastest(self) -> float:
        # Whole milliseconds, rounded towards the higher rate
        return 1e3 / int(1e3 / (_LOOP_SHARE * self._loop_rate))

    def _is_over(self, name: str, t_ns: int) -> bool:
        rate = self._rates[name]
        if rate <= 0.0 or t_ns < self._next_ns[name]:
            return False
        interval_ns = round(1e3 / rate) * 1_000_000
        planned = self._next_ns[name] + interval_ns
        self._next_ns[name] = planned if planned > t_ns else t_ns + interval_ns
        return True

    def _source_rate(self, name: str) -> float:
        return self._fix_rate if name == GNSS else self._loop_rate

    def _divide(self, name: str, rate: float) -> int:
        """Return the iterations (of GPS_RAW_INT: fixes) between two messages; 0: none is sent."""
        if rate <= 0.0:
            return 0
        iterations = self._source_rate(name) / rate
        if self._personality.pacing is Pacing.DIVISION:
            return max(1, math.ceil(iterations - _EARLY))
        return max(1, round(iterations))

    def _scale(self) -> float:
        """Return the part of their rates that the streams get."""
        budget = self._parameters.get("MAV_1_RATE", 0.0) or self._personality.link_rate
        loads = {
            name: min(rate, self._source_rate(name)) * (by_name(name).size + _OVERHEAD)
            for name, rate in self._rates.items()
        }
        constant = sum(load for name, load in loads.items() if name in _CONSTANT)
        varying = sum(load for name, load in loads.items() if name not in _CONSTANT)
        if not self._personality.link_rate or not varying:
            return 1.0
        return min(1.0, max(_SLOWEST, (budget - constant) / varying))


def _spares(config: SimConfig, kind: Kind) -> dict[str, float]:
    """Return the messages of sensors that not every vehicle has, with the rates of unasked ones.

    PX4 has no AIRSPEED: its airspeed is in VFR_HUD, and SYS_STATUS tells of the sensor.
    """
    spare = config.spare
    boards = ("SCALED_IMU2", "SCALED_IMU3")[: max(spare.compasses, spare.units)]
    asked = (
        *boards,
        *("GPS2_RAW",) * spare.receivers,
        *("DISTANCE_SENSOR",) * config.range_finder.fitted,
        *("AIRSPEED",) * (config.airspeed.fitted and kind is Kind.ARDUPILOT),
        *("WHEEL_DISTANCE",) * config.wheel.fitted,
        *("OPTICAL_FLOW" if kind is Kind.ARDUPILOT else "OPTICAL_FLOW_RAD",) * config.flow.fitted,
    )
    rates = dict.fromkeys(asked, 0.0)
    if config.airspeed.fitted and kind is Kind.PX4:
        rates |= {"VFR_HUD": 4.0, "SYS_STATUS": 1.0}
    return rates
