"""A ground station that flies: arms, climbs, follows paths, and switches parameters in flight."""

from __future__ import annotations

import math
import os
import struct
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("MAVLINK20", "1")  # before mavutil chooses its dialect

from pymavlink import mavutil

from ekf_companion.errors import CompanionError

Path = Callable[[float], tuple[float, float, float, float]]
"""North and east of the start (m) and their velocities (m/s) at a time since its begin (s)."""

HEIGHT = 12.0
"""m."""
_PERIOD = 0.05
"""Of setpoints, s."""
_PX4, _ARDUPILOT = 12, 3
_FIX_3D = 3
_OFFBOARD, _GUIDED, _LAND = 6 << 16, 4, 9
_POSITION_AND_VELOCITY = 0b100111000000
_ARM, _TAKEOFF, _SET_MODE = 400, 22, 176


def square(side: float = 25.0, speed: float = 5.0) -> tuple[Path, float]:
    """Return a square that begins at a corner, and how long it takes, s."""
    leg = side / speed
    corners = ((0.0, 0.0), (side, 0.0), (side, side), (0.0, side), (0.0, 0.0))

    def at(t: float) -> tuple[float, float, float, float]:
        k = min(int(t / leg), 3)
        share = min(t / leg - k, 1.0)
        (n0, e0), (n1, e1) = corners[k], corners[k + 1]
        going = 1.0 if share < 1.0 else 0.0
        n, e = n0 + share * (n1 - n0), e0 + share * (e1 - e0)
        return n, e, going * (n1 - n0) / leg, going * (e1 - e0) / leg

    return at, 4.0 * leg


def figure_eight(radius: float = 12.0, period: float = 25.0) -> tuple[Path, float]:
    """Return a figure of eight through the start, and how long two rounds take, s."""
    rate = 2.0 * math.pi / period

    def at(t: float) -> tuple[float, float, float, float]:
        a = rate * t
        n, e = radius * math.sin(a), 0.5 * radius * math.sin(2.0 * a)
        return n, e, radius * rate * math.cos(a), radius * rate * math.cos(2.0 * a)

    return at, 2.0 * period


class Pilot:
    """The ground station of one vehicle."""

    def __init__(self, link: str, patience: float = 60.0) -> None:
        """Wait for the autopilot's heartbeat."""
        begin = time.monotonic()
        while True:
            try:
                self._link: Any = mavutil.mavlink_connection(link, source_system=255)
                break
            except OSError:
                if time.monotonic() - begin > patience:
                    raise
                time.sleep(0.5)
        beat = self._link.wait_heartbeat(timeout=patience)
        if beat is None:
            raise CompanionError(f"{link}: no heartbeat in {patience:.0f} s")
        self.is_px4 = beat.autopilot == _PX4
        self.t = 0.0
        """The vehicle's clock, s since its boot."""
        self.texts: list[tuple[float, str]] = []
        """STATUSTEXT, each with the time at which it came."""
        self.modes: list[tuple[float, int]] = []
        """Changes of custom_mode."""
        self.is_armed = False
        self.has_fix = False
        """Whether its receiver reported a fix in the last GPS_RAW_INT."""
        self.local: Any = None
        self.global_t: float | None = None
        """When GLOBAL_POSITION_INT last came."""
        self.parameters: dict[str, float] = {}
        self._setpoint: tuple[float, float, float, float, float] | None = None
        self._next_setpoint = self._next_beat = 0.0
        self._start: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self._first: tuple[float, float] | None = None
        """Our clock and the vehicle's, s, when it first said its time."""
        if not self.is_px4:
            for message_id, rate in ((32, 10), (33, 2), (1, 1), (193, 2), (24, 5)):
                self.command(511, message_id, 1e6 / rate)

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    @property
    def pace(self) -> float:
        """How fast the vehicle's clock has run beside ours: 1 is real time."""
        if self._first is None:
            return 0.0
        begin, t = self._first
        return (self.t - t) / (time.monotonic() - begin)

    # Time passes

    def wait(self, seconds: float) -> None:
        """Keep the link and the setpoint alive for so long."""
        self.wait_for(lambda: False, seconds)

    def wait_for(self, is_there: Callable[[], bool], patience: float) -> bool:
        """Keep all alive until something holds; return whether it came to that."""
        end = time.monotonic() + patience
        while time.monotonic() < end:
            self._turn()
            if is_there():
                return True
        return False

    def _turn(self) -> None:
        now = time.monotonic()
        if now >= self._next_beat:
            self._next_beat = now + 1.0
            self._link.mav.heartbeat_send(6, 8, 0, 0, 4)
        if self._setpoint is not None and now >= self._next_setpoint:
            self._next_setpoint = now + _PERIOD
            n, e, d, vn, ve = self._setpoint
            self._link.mav.set_position_target_local_ned_send(
                0, self._link.target_system, 1, 1, _POSITION_AND_VELOCITY,
                n, e, d, vn, ve, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            )  # fmt: skip
        while (message := self._link.recv_match(blocking=False)) is not None:
            self._take(message)
        time.sleep(0.005)

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        if message.get_srcComponent() != 1:
            return
        if hasattr(message, "time_boot_ms"):
            self.t = message.time_boot_ms * 1e-3
            self._first = self._first or (time.monotonic(), self.t)
        if kind == "HEARTBEAT":
            self.is_armed = bool(message.base_mode & 128)
            if not self.modes or self.modes[-1][1] != message.custom_mode:
                self.modes.append((self.t, message.custom_mode))
        elif kind == "STATUSTEXT":
            self.texts.append((self.t, message.text))
        elif kind == "GPS_RAW_INT":
            self.has_fix = message.fix_type >= _FIX_3D
        elif kind == "LOCAL_POSITION_NED":
            self.local = message
        elif kind == "GLOBAL_POSITION_INT" and (message.lat or message.lon):
            self.global_t = self.t
        elif kind == "PARAM_VALUE":
            value = message.param_value
            if self.is_px4 and message.param_type != 9:
                (value,) = struct.unpack("<i", struct.pack("<f", value))
            self.parameters[message.param_id] = float(value)

    # Orders

    def command(self, command: int, *values: float) -> None:
        """Send a COMMAND_LONG, once."""
        values = (*values, *([0.0] * (7 - len(values))))
        self._link.mav.command_long_send(self._link.target_system, 1, command, 0, *values)

    def set(self, name: str, value: float) -> None:
        """Set a parameter, until it is confirmed."""
        for _ in range(10):
            kind, sent = 9, value
            if self.is_px4 and self._is_integer(name):
                kind, sent = 6, struct.unpack("<f", struct.pack("<i", int(value)))[0]
            self.parameters.pop(name, None)
            self._link.mav.param_set_send(self._link.target_system, 1, name.encode(), sent, kind)
            if self.wait_for(lambda: self.parameters.get(name) is not None, 1.0) and (
                abs(self.parameters[name] - value) < 1e-4 * max(1.0, abs(value))
            ):
                return
        raise CompanionError(f"{name}: the autopilot did not take {value:g}")

    @staticmethod
    def _is_integer(name: str) -> bool:
        return name.endswith(("_CTRL", "_USED", "_REF", "_TYPE", "_QMIN", "_EN"))

    def arm_and_climb(self, patience: float = 60.0) -> bool:
        """Arm and climb to ``HEIGHT``; return whether it came there."""
        if not self.wait_for(lambda: self.local is not None, patience):
            return False
        here = self.local
        self._start = (here.x, here.y, here.z)
        self._aim(0.0, 0.0, 0.0, 0.0)
        end = time.monotonic() + patience
        while not self.is_armed and time.monotonic() < end:
            here = self.local
            self._start = (here.x, here.y, here.z)
            self._aim(0.0, 0.0, 0.0, 0.0)
            if not self.is_px4:
                self._setpoint = None
            self.command(_SET_MODE, 1.0, 6.0 if self.is_px4 else float(_GUIDED))
            self.command(_ARM, 1.0)
            self.wait_for(lambda: self.is_armed, 2.0)
        if not self.is_armed:
            return False
        if not self.is_px4:
            self.command(_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, HEIGHT)
        up = self._start[2] - HEIGHT
        came = self.wait_for(lambda: abs(self.local.z - up) < 0.7, 25.0)
        self._aim(0.0, 0.0, 0.0, 0.0)
        return came

    def _aim(self, n: float, e: float, vn: float, ve: float) -> None:
        n0, e0, d0 = self._start
        self._setpoint = (n0 + n, e0 + e, d0 - HEIGHT, vn, ve)

    def follow(self, path: Path, seconds: float) -> None:
        """Fly a path, and hold at its end for two seconds."""
        begin = time.monotonic()
        while (t := time.monotonic() - begin) < seconds:
            self._aim(*path(t))
            self._turn()
        n, e, _, _ = path(seconds)
        self._aim(n, e, 0.0, 0.0)
        self.wait(2.0)

    def return_to_start(self) -> None:
        """Aim at the start's place in the air."""
        self._aim(0.0, 0.0, 0.0, 0.0)

    def land(self, patience: float = 60.0) -> bool:
        """Land; return whether it disarmed."""
        self._setpoint = None
        if self.is_px4:
            self.command(21)  # NAV_LAND
        else:
            self.command(_SET_MODE, 1.0, float(_LAND))
        return self.wait_for(lambda: not self.is_armed, patience)
