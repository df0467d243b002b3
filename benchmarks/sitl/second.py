"""A second companion that sends VISION_POSITION_ESTIMATE beside the daemon."""

from __future__ import annotations

import math
import os
import threading
import time
from types import TracebackType
from typing import Any

os.environ.setdefault("MAVLINK20", "1")

from pymavlink import mavutil

from benchmarks.sitl.place import HOME, Places, from_home

_COMPONENT = 197
"""MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY."""
_RATE = 20.0
"""Hz."""
_OFF = 2.8
"""How far east of the truth it is, m."""
_SIMSTATE, _SIM_STATE = 164, 108
"""Place and yaw; altitude."""


class SecondCompanion:
    """Sends the simulator's truth, displaced, from a link of its own."""

    def __init__(self, link: str) -> None:
        """Connect, and ask for the simulator's truth."""
        self._link: Any = mavutil.mavlink_connection(
            link, source_system=1, source_component=_COMPONENT
        )
        self._link.wait_heartbeat(timeout=10.0)
        self._is_ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> SecondCompanion:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._is_ending.set()
        self._thread.join()
        self._link.close()

    def _run(self) -> None:
        mav, next_beat, next_sent = self._link.mav, 0.0, 0.0
        for number in (_SIMSTATE, _SIM_STATE):
            mav.command_long_send(1, 1, 511, 0, number, 1e6 / _RATE, 0, 0, 0, 0, 0)
        yaw, place, height = 0.0, None, None
        while not self._is_ending.is_set():
            now = time.monotonic()
            if now >= next_beat:
                next_beat = now + 1.0
                mav.heartbeat_send(18, 8, 0, 0, 4)
            while (message := self._link.recv_match(blocking=False)) is not None:
                if message.get_srcComponent() != 1:
                    continue
                if message.get_type() == "SIMSTATE":
                    lat, lon = message.lat * 1e-7, message.lng * 1e-7
                    place, yaw = (lat, lon), message.yaw
                elif message.get_type() == "SIM_STATE":
                    height = message.alt - float(HOME.alt)
            if place is not None and height is not None and now >= next_sent:
                next_sent = now + 1.0 / _RATE
                n, e, _ = from_home(Places(*place, HOME.alt)).tolist()
                mav.vision_position_estimate_send(
                    int(now * 1e6), n, e + _OFF, -height, 0.0, 0.0, math.remainder(yaw, math.tau)
                )
            time.sleep(0.005)
