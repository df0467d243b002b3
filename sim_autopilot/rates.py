"""Which messages are due: what was asked for, and what the autopilot makes of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from ekf_companion.mavlink.messages import by_name
from sim_autopilot.config import SimConfig
from sim_autopilot.personality import DENIED, Pacing, Personality

ACCEPTED = 0
GNSS = "GPS_RAW_INT"
_SECOND_NS = 1_000_000_000
_CONSTANT = frozenset({"HEARTBEAT"})
"""Never slowed down by the link's budget."""
_OVERHEAD = 12
"""Of a frame, bytes."""
_SLOWEST = 0.05
"""A stream is never slowed down further than to this part (PX4)."""
_EARLY = 0.05
"""Part of a turn that a stream may come before its time (PX4 main loop's tolerance)."""
_LOOP_SHARE = 0.8
"""Of the loop's rate, that a stream may have at most (ArduPilot)."""

GROUPS: Mapping[int, tuple[str, ...]] = {
    1: ("RAW_IMU", "SCALED_IMU2", "SCALED_PRESSURE"),
    2: (GNSS,),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    12: ("SYSTEM_TIME",),
}
"""Messages of REQUEST_DATA_STREAM by MAV_DATA_STREAM (ArduPilot); 0 stands for all."""


class Streams:
    """The rates of one link."""

    def __init__(
        self, personality: Personality, config: SimConfig, parameters: Mapping[str, float]
    ) -> None:
        """Begin with the rates of a fresh start; ``parameters`` is looked at, not copied."""
        own = personality.streams
        if own is None:
            own = {name: getattr(config.streams, name) for name in config.streams.__slots__}
        self._default = own
        self._asked = dict(own)
        self._personality = personality
        self._parameters = parameters
        self._turn_rate = personality.loop_rate or config.imu.rate
        if personality.vehicle_imu_rate:
            self._turn_rate = min(self._turn_rate, personality.vehicle_imu_rate)
        self._fix_rate = config.gnss.rate
        self._fixes = 0
        self._every: dict[str, int] = {}
        self._next_ns: dict[str, int] = dict.fromkeys(own, 0)
        self.lay_out()

    def __contains__(self, name: str) -> bool:
        """Whether there is such a message."""
        return name in self._asked

    def ask(self, name: str, interval_us: float) -> int:
        """Take SET_MESSAGE_INTERVAL; give the result that is told, whatever becomes of it."""
        if name not in self._asked:
            return self._personality.no_such_stream
        rate = self._default[name]
        if interval_us > 0.0:
            rate = 1e6 / interval_us
            if self._personality.pacing is Pacing.MILLISECONDS:
                rate = 1e3 / max(1, int(interval_us / 1e3))
                if rate > self._fastest:
                    return DENIED
        elif interval_us < 0.0:
            rate = 0.0
        self._asked[name] = rate
        self._next_ns[name] = 0
        self.lay_out()
        return ACCEPTED

    def ask_group(self, group: int, rate: float) -> None:
        """Take REQUEST_DATA_STREAM; a rate too high becomes the highest that there is."""
        groups: Iterable[int] = GROUPS if group == 0 else (group,)
        for name in (name for one in groups for name in GROUPS.get(one, ())):
            if name in self._asked:
                self._asked[name] = min(rate, self._fastest)
        self.lay_out()

    def due(self, number: int, t_ns: int, has_fix: bool) -> list[str]:
        """Give what is to be sent in a turn, by its number and its time."""
        if self._personality.pacing is Pacing.MILLISECONDS:
            return [name for name in self._asked if self._is_over(name, t_ns)]
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
        return self._asked.get(name, 0.0) > 0.0

    def lay_out(self) -> None:
        """Turn rates into whole numbers of turns, within the budget; after any change."""
        scale = self._scale()
        self._every = {
            name: self._divide(name, rate if name in _CONSTANT else rate * scale)
            for name, rate in self._asked.items()
        }

    @property
    def _fastest(self) -> float:
        # Whole milliseconds, rounded in the stream's favour
        return 1e3 / int(1e3 / (_LOOP_SHARE * self._turn_rate))

    def _is_over(self, name: str, t_ns: int) -> bool:
        rate = self._asked[name]
        if rate <= 0.0 or t_ns < self._next_ns[name]:
            return False
        interval_ns = round(1e3 / rate) * 1_000_000
        planned = self._next_ns[name] + interval_ns
        self._next_ns[name] = planned if planned > t_ns else t_ns + interval_ns
        return True

    def _source_rate(self, name: str) -> float:
        return self._fix_rate if name == GNSS else self._turn_rate

    def _divide(self, name: str, rate: float) -> int:
        """Give the turns (of GPS_RAW_INT: fixes) from one message to the next; 0: none."""
        if rate <= 0.0:
            return 0
        turns = self._source_rate(name) / rate
        if self._personality.pacing is Pacing.DIVISION:
            return max(1, math.ceil(turns - _EARLY))
        return max(1, round(turns))

    def _scale(self) -> float:
        """Give the part of their rates that the streams get."""
        budget = self._parameters.get("MAV_1_RATE", 0.0) or self._personality.link_rate
        if not self._personality.link_rate:
            return 1.0
        constant = varying = 0.0
        for name, rate in self._asked.items():
            load = min(rate, self._source_rate(name)) * (by_name(name).size + _OVERHEAD)
            if name in _CONSTANT:
                constant += load
            else:
                varying += load
        return min(1.0, max(_SLOWEST, (budget - constant) / varying)) if varying else 1.0
