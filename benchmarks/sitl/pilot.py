"""A ground station that flies: arms, climbs, follows paths, and switches parameters in flight."""

from __future__ import annotations

import math
import os
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any

os.environ.setdefault("MAVLINK20", "1")  # before mavutil chooses its dialect

from pymavlink import mavutil

from benchmarks.sitl.mission import Item
from benchmarks.sitl.place import HOME
from benchmarks.sitl.recording import COMPONENT_ID
from ekf_companion.errors import CompanionError

Path = Callable[[float], tuple[float, float, float, float]]
"""North and east of the start (m) and their velocities (m/s) at a time since its begin (s)."""

HEIGHT = 12.0
"""m."""
_PERIOD = 0.05
"""Of setpoints, s."""
_PX4, _ARDUPILOT = 12, 3
_FIX_3D = 3
_OFFBOARD, _GUIDED, _LAND, _RTL = 6 << 16, 4, 9, 6
_PX4_LAND, _PX4_RTL = 4 << 16 | 6 << 24, 4 << 16 | 5 << 24
_POSITION_AND_VELOCITY = 0b100111000000
_ARM, _TAKEOFF, _SET_MODE, _RETURN = 400, 22, 176, 20
_DEGREE = 111319.5
"""m of latitude, on ArduPilot's sphere."""


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


def line(north: float, speed: float = 5.0) -> tuple[Path, float]:
    """Return a straight way north, and how long it takes, s."""
    seconds = north / speed
    return (lambda t: (min(speed * t, north), 0.0, speed if t < seconds else 0.0, 0.0)), seconds


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
        """The autopilot's STATUSTEXT, each with the time at which it came."""
        self.said: list[tuple[float, str]] = []
        """The daemon's, likewise."""
        self.modes: list[tuple[float, int]] = []
        """Changes of custom_mode."""
        self.ordered: list[int] = []
        """Modes that were asked for."""
        self.mission_wants: int | None = None
        """Number of the mission's item that the autopilot asked for last; -1: it has all."""
        self.reached: list[int] = []
        """Items of the mission that were reached."""
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
            if message.get_srcComponent() == COMPONENT_ID and kind == "STATUSTEXT":
                self._read(self.said, message)
            return
        if hasattr(message, "time_boot_ms"):
            self.t = message.time_boot_ms * 1e-3
            self._first = self._first or (time.monotonic(), self.t)
        if kind == "HEARTBEAT":
            self.is_armed = bool(message.base_mode & 128)
            if not self.modes or self.modes[-1][1] != message.custom_mode:
                self.modes.append((self.t, message.custom_mode))
        elif kind == "STATUSTEXT":
            self._read(self.texts, message)
        elif kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            self.mission_wants = message.seq
        elif kind == "MISSION_ACK":
            self.mission_wants = -1
        elif kind == "MISSION_ITEM_REACHED":
            self.reached.append(message.seq)
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

    def _read(self, texts: list[tuple[float, str]], message: Any) -> None:
        """Take a text, or the next piece of a long one."""
        if message.id and message.chunk_seq and texts:
            t, begun = texts[-1]
            texts[-1] = (t, begun + message.text)
        else:
            texts.append((self.t, message.text))

    # Orders

    def order_mode(self, mode: int) -> None:
        """Ask an ArduPilot for a mode."""
        self.ordered.append(mode)
        self.command(_SET_MODE, 1.0, float(mode))

    def upload(self, items: Sequence[Item]) -> None:
        """Upload a mission.

        Args:
            items: The first is home.
        """
        to = self._link.target_system, 1
        self.mission_wants = None
        self._link.mav.mission_count_send(*to, len(items))
        end = time.monotonic() + 30.0
        while self.mission_wants != -1:
            if time.monotonic() > end:
                raise CompanionError("the autopilot did not take the mission")
            if not self.wait_for(lambda: self.mission_wants is not None, 2.0):
                self._link.mav.mission_count_send(*to, len(items))
                continue
            if (k := self.mission_wants) is None or k < 0:
                continue
            self.mission_wants = None
            number, values, (lat, lon, height) = items[k]
            self._link.mav.mission_item_int_send(
                *to, k, 3 if k else 0, number, 0, 1, *values,
                round(lat * 1e7), round(lon * 1e7), height,
            )  # fmt: skip

    def shift_receiver(self, north: float, east: float, up: float) -> None:
        """Move what the simulated receiver says away from the truth, m."""
        place = math.cos(math.radians(float(HOME.lat)))
        for axis, value in (("X", north / _DEGREE), ("Y", east / _DEGREE / place), ("Z", up)):
            self._link.mav.param_set_send(
                self._link.target_system, 1, f"SIM_GPS1_GLTCH_{axis}".encode(), value, 9
            )

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
            if self.is_px4:
                self.ordered.append(_OFFBOARD)
                self.command(_SET_MODE, 1.0, 6.0)
            else:
                self.order_mode(_GUIDED)
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
            self.ordered.append(_PX4_LAND)
            self.command(21)  # NAV_LAND
        else:
            self.order_mode(_LAND)
        return self.wait_for(lambda: not self.is_armed, patience)

    def return_home(self, patience: float = 120.0) -> bool:
        """Return to home and land; return whether it disarmed."""
        self._setpoint = None
        if self.is_px4:
            self.ordered.append(_PX4_RTL)
            self.command(_RETURN)
        else:
            self.order_mode(_RTL)
        return self.wait_for(lambda: not self.is_armed, patience)
