"""The autopilot as a MAVLink peer: cycles, bytes and times in, bytes out.

No socket and no clock: ``now_ns`` is the autopilot's own time, and whoever calls says it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import Enum
from typing import Any, NamedTuple

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import JUNK, Frame, Splitter
from ekf_companion.mavlink.layout import IDS, LAYOUTS
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Cycle, Fix
from sim_autopilot.telemetry import (
    BAROMETER,
    BUILDERS,
    INERTIAL_AND_TEMPERATURE,
    MAGNETOMETER,
    gps_raw_int,
    highres_imu,
)

COMPONENT_ID = 1
SET_MESSAGE_INTERVAL = 511
REQUEST_MESSAGE = 512
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
_ARMED, _CUSTOM_MODE = 128, 1
_STANDBY, _ACTIVE = 3, 4
_INT32, _REAL32 = 6, 9


class Kind(str, Enum):
    """Which autopilot it passes itself off as."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class _Habits(NamedTuple):
    autopilot: int
    custom_mode: int
    version: int
    timesync_ns: int
    """Between its own requests."""
    no_such_stream: int
    """Its answer to SET_MESSAGE_INTERVAL for a message that it does not have."""
    parameters: dict[str, float]
    """Of the firmware's defaults, those that decide what it fuses."""


_HABITS = {
    Kind.PX4: _Habits(
        12,
        4 << 16 | 3 << 24,
        0x011000FF,
        100_000_000,
        FAILED,
        {"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7},
    ),
    Kind.ARDUPILOT: _Habits(
        3,
        4,
        0x040600FF,
        10_000_000_000,
        DENIED,
        {
            "VISO_TYPE": 0,
            "EK3_SRC1_POSXY": 3,
            "EK3_SRC1_VELXY": 3,
            "EK3_SRC1_POSZ": 1,
            "EK3_SRC1_VELZ": 3,
            "EK3_SRC1_YAW": 1,
        },
    ),
}


class Received(NamedTuple):
    """A message that somebody else sent."""

    now_ns: int
    component_id: int
    name: str
    fields: Any
    frame: bytes
    """As it was on the wire."""


class Autopilot:
    """One autopilot on one link."""

    def __init__(self, config: SimConfig, kind: Kind = Kind.PX4, *, is_wing: bool = False) -> None:
        self.parameters = {**_HABITS[kind].parameters, **config.parameters}
        self.round_trips_ns: list[int] = []
        """Of TIMESYNC."""
        self._config = config
        self._kind = kind
        self._habits = _HABITS[kind]
        self._type = 1 if is_wing else 2
        self._sender = Sender(config.system_id, COMPONENT_ID)
        self._splitter = Splitter()
        self._out: list[bytes] = []
        self._received: list[Received] = []
        self._last: Cycle | None = None
        self._fix: Fix | None = None
        self._fix_count = 0
        self._mag_b = (0.0, 0.0, 0.0)
        self._baro = (0.0, 0.0)
        self._fields_updated = INERTIAL_AND_TEMPERATURE
        self._next_timesync_ns = 0
        streams = config.streams
        # Cycles from one message to the next (of GPS_RAW_INT: fixes); 0: none
        self._every = {
            name: self._divide(name, getattr(streams, name)) for name in streams.__slots__
        }
        self._handlers: dict[str, Callable[[Frame, Any, int], None]] = {
            "COMMAND_LONG": self._command,
            "TIMESYNC": self._timesync,
            "PARAM_REQUEST_READ": self._param_request_read,
            "PARAM_SET": self._param_set,
        }

    def cycle(self, cycle: Cycle) -> None:
        """Take one turn of the loop: read the sensors, send what is due."""
        self._last = cycle
        if cycle.mag_b is not None:
            self._mag_b = cycle.mag_b
            self._fields_updated |= MAGNETOMETER
        if cycle.baro is not None:
            self._baro = cycle.baro
            self._fields_updated |= BAROMETER
        for name, every in self._every.items():
            if name != "GPS_RAW_INT" and every and cycle.number % every == 0:
                self._stream(name, cycle)
        if cycle.fix is not None:
            self._fix = cycle.fix
            self._fix_count += 1
            every = self._every["GPS_RAW_INT"]
            if every and self._fix_count % every == 0:
                self._stream("GPS_RAW_INT", cycle)
        if cycle.t_ns >= self._next_timesync_ns:
            self._next_timesync_ns = cycle.t_ns + self._habits.timesync_ns
            self._send("TIMESYNC", tc1=0, ts1=cycle.t_ns)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the link, and answer them."""
        for frame in self._splitter.feed(data):
            if frame.message_id == JUNK:
                continue
            fields = unpack(frame)
            name = LAYOUTS[frame.message_id].name
            self._received.append(Received(now_ns, frame.component_id, name, fields, frame.raw))
            handler = self._handlers.get(name)
            if handler is not None and self._is_for_us(fields):
                handler(frame, fields, now_ns)

    def heartbeat(self, *, is_armed: bool = False) -> None:
        """Send a heartbeat out of turn: somebody may be waiting for the first one."""
        self._send(
            "HEARTBEAT",
            type=self._type,
            autopilot=self._habits.autopilot,
            base_mode=_CUSTOM_MODE | (_ARMED if is_armed else 0),
            custom_mode=self._habits.custom_mode,
            system_status=_ACTIVE if is_armed else _STANDBY,
            mavlink_version=3,
        )

    def data_to_send(self) -> list[bytes]:
        """Give the frames that wait to be sent, in order, once."""
        frames, self._out = self._out, []
        return frames

    def received(self) -> list[Received]:
        """Give the messages that came since the last call."""
        messages, self._received = self._received, []
        return messages

    def _is_for_us(self, fields: Any) -> bool:
        system = getattr(fields, "target_system", 0)
        component = getattr(fields, "target_component", 0)
        return system in (0, self._config.system_id) and component in (0, COMPONENT_ID)

    def _divide(self, name: str, rate: float) -> int:
        """Give the whole number of turns that comes nearest to a rate (Hz; 0: none)."""
        source = self._config.gnss.rate if name == "GPS_RAW_INT" else self._config.imu.rate
        return max(1, round(source / rate)) if rate > 0.0 else 0

    def _send(self, name: str, **fields: Any) -> None:
        self._out.append(self._sender.message(name, **fields))

    def _stream(self, name: str, cycle: Cycle) -> None:
        if name == "HEARTBEAT":
            self.heartbeat(is_armed=cycle.is_armed)
        elif name == "HIGHRES_IMU":
            updated, self._fields_updated = self._fields_updated, INERTIAL_AND_TEMPERATURE
            fields = highres_imu(cycle, self._config, self._mag_b, self._baro, updated)
            self._send(name, **fields)
        elif name == "GPS_RAW_INT":
            if self._fix is not None:
                self._send(name, **gps_raw_int(self._config, self._fix))
        elif name == "AUTOPILOT_VERSION":
            version = self._habits.version
            self._send(
                name, capabilities=8192 | 8, flight_sw_version=version, uid=self._config.system_id
            )
        else:
            self._send(name, **BUILDERS[name](self._config, cycle))

    def _command(self, frame: Frame, command: Any, now_ns: int) -> None:
        message = LAYOUTS[int(command.param1)].name if int(command.param1) in LAYOUTS else ""
        if command.command == SET_MESSAGE_INTERVAL:
            result = self._set_interval(message, command.param2)
        elif command.command == REQUEST_MESSAGE:
            result = self._request(message)
        else:
            result = UNSUPPORTED
        self._send(
            "COMMAND_ACK",
            command=command.command,
            result=result,
            target_system=frame.system_id,
            target_component=frame.component_id,
        )

    def _set_interval(self, message: str, interval_us: float) -> int:
        if message not in self._every:
            return self._habits.no_such_stream
        if interval_us > 0.0:
            self._every[message] = self._divide(message, 1e6 / interval_us)
        elif interval_us == 0.0:
            self._every[message] = self._divide(message, getattr(self._config.streams, message))
        else:
            self._every[message] = 0
        return ACCEPTED

    def _request(self, message: str) -> int:
        if message not in self._every and message != "AUTOPILOT_VERSION":
            return UNSUPPORTED
        if self._last is None:
            return FAILED
        self._stream(message, self._last)
        return ACCEPTED

    def _timesync(self, frame: Frame, sync: Any, now_ns: int) -> None:
        if sync.tc1 == 0:
            self._send(
                "TIMESYNC",
                tc1=now_ns,
                ts1=sync.ts1,
                target_system=frame.system_id,
                target_component=frame.component_id,
            )
        else:
            self.round_trips_ns.append(now_ns - sync.ts1)

    def _param_request_read(self, frame: Frame, request: Any, now_ns: int) -> None:
        names = list(self.parameters)
        index = request.param_index
        name = names[index] if 0 <= index < len(names) else request.param_id.decode()
        if name in self.parameters:
            self._param_value(name)

    def _param_set(self, frame: Frame, request: Any, now_ns: int) -> None:
        name = request.param_id.decode()
        if name in self.parameters:
            self.parameters[name] = self._param_decoded(request.param_value, request.param_type)
            self._param_value(name)

    def _param_value(self, name: str) -> None:
        value = self.parameters[name]
        is_integer = float(value).is_integer()
        if is_integer and self._kind is Kind.PX4:
            # PX4 lays the integer's bytes where the float's would be
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        self._send(
            "PARAM_VALUE",
            param_id=name.encode(),
            param_value=value,
            param_type=_INT32 if is_integer else _REAL32,
            param_count=len(self.parameters),
            param_index=list(self.parameters).index(name),
        )

    def _param_decoded(self, value: float, param_type: int) -> float:
        if param_type == _INT32 and self._kind is Kind.PX4:
            return float(struct.unpack("<i", struct.pack("<f", value))[0])
        return value


assert set(SimConfig().streams.__slots__) <= IDS.keys()
