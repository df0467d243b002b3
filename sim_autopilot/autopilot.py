"""The autopilot as a MAVLink peer: cycles, bytes and times in, bytes out.

No socket and no clock: ``now_ns`` is the autopilot's own time, passed by the caller.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Frame, Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.nav.earth import is_place
from sim_autopilot import navigation
from sim_autopilot.acceptance import Reception
from sim_autopilot.config import SimConfig
from sim_autopilot.ekf2 import Ekf2
from sim_autopilot.firmware import IDEAL
from sim_autopilot.flight import Cycle
from sim_autopilot.habits import FirmwareSensors
from sim_autopilot.navigator import Navigator
from sim_autopilot.parameters import ParameterServer
from sim_autopilot.personality import DENIED, FAILED, UNSUPPORTED, Kind, Personality
from sim_autopilot.rates import ACCEPTED, GNSS, GROUPS, Streams

__all__ = ["COMPONENT_ID", "Autopilot", "Kind", "Received"]

COMPONENT_ID = 1
SET_MESSAGE_INTERVAL = 511
REQUEST_MESSAGE = 512
SET_EKF_SOURCE_SET = 42007
EXTERNAL_POSITION_ESTIMATE = 43003
_TAKES_POSITIONS = 0x04050000
"""ArduPilot from 4.5 on."""
_GLOBAL_FRAMES = (0, 5)
"""MAV_FRAME_GLOBAL, MAV_FRAME_GLOBAL_INT."""
_ARMED, _CUSTOM_MODE = 128, 1
_STANDBY, _ACTIVE = 3, 4
_CRITICAL, _INFO = 2, 6
_ORIGIN = ("latitude", "longitude", "altitude")
_PLACES = ("GLOBAL_POSITION_INT", "GPS_GLOBAL_ORIGIN")
_OWN = ("GPS_GLOBAL_ORIGIN", "HOME_POSITION", "EKF_STATUS_REPORT")
"""Messages of an autopilot that navigates by itself: sent only on request."""
_GCS_NS = 10_000_000_000
"""Time between two requests of a ground station for its rates."""


class Received(NamedTuple):
    """A message of another component."""

    now_ns: int
    component_id: int
    name: str
    fields: Any
    frame: bytes
    """As it was on the wire."""


class Autopilot:
    """One autopilot on one link."""

    def __init__(
        self,
        config: SimConfig,
        personality: Personality | Kind = Kind.PX4,
        *,
        is_wing: bool = False,
        is_rolling: bool = False,
        seed: int = 1,
        navigator: Navigator | None = None,
    ) -> None:
        """Start a fixed wing or a multicopter; the seed is that of its habits' random numbers.

        The personality is the autopilot to imitate; of a kind the ideal one. With a navigator it
        flies by what it receives, and has an origin of its own.
        """
        self.personality = IDEAL[personality] if isinstance(personality, Kind) else personality
        self.parameters = {**self.personality.parameters, **config.parameters}
        if self.personality.kind is Kind.ARDUPILOT:
            self.parameters.setdefault("SCHED_LOOP_RATE", self.personality.loop_rate or 400.0)
        self.round_trips_ns: list[int] = []
        """Of TIMESYNC."""
        self.reception = Reception(
            self.personality.rules,
            self.parameters,
            knows_odometry=self.personality.knows_odometry,
        )
        """Its verdicts on the ODOMETRY that it received."""
        self.navigator = navigator
        self.reboots = 0
        self.loop_ns = 0
        """Time of the last iteration of the loop, when it sends, on the world's clock."""
        self._config = config
        self._seed = seed
        self._type = 1 if is_wing else 10 if is_rolling else 2
        self._out: list[bytes] = []
        self._received: list[Received] = []
        self._random = random.Random(seed)
        self._server = ParameterServer(
            self.parameters, self._send, is_bytewise=self.personality.kind is Kind.PX4
        )
        self._handlers: dict[str, Callable[[Frame, Any, int], None]] = {
            "COMMAND_INT": self._command_int,
            "COMMAND_LONG": self._command,
            "GLOBAL_POSITION_SENSOR": self._position_sensor,
            "HEARTBEAT": self._heartbeat,
            "ODOMETRY": self._odometry,
            "PARAM_REQUEST_LIST": lambda *_: self._server.send_all(),
            "PARAM_REQUEST_READ": lambda frame, request, now_ns: self._server.read(request),
            "PARAM_SET": self._param_set,
            "REQUEST_DATA_STREAM": self._data_stream,
            "SET_GPS_GLOBAL_ORIGIN": self._set_origin,
            "TIMESYNC": self._timesync,
            "VISION_POSITION_ESTIMATE": self._vision,
        }
        self._start()

    def reboot(self) -> None:
        """Start again with its parameters, and without requests, sequence numbers and samples.

        Its clock starts again with the next cycle.
        """
        self.reboots += 1
        self._out.clear()
        self._start()

    def _start(self) -> None:
        self._sender = Sender(self._config.system_id, COMPONENT_ID)
        self._splitter = Splitter()
        also = () if self.navigator is None else _OWN
        self._streams = Streams(self.personality, self._config, self.parameters, also)
        self._sensors = FirmwareSensors(self._config, self.personality, self._seed + self.reboots)
        self._last: Cycle | None = None
        self._given: dict[str, int] = {}
        """The origin that it was given, where it has none of its own filter."""
        self._told: tuple[int, ...] = ()
        """The origin that it has reported."""
        self._has_fix = self._has_origin = False
        self._next_timesync_ns = 0
        self._next_gcs_ns = 0
        self._companion = (0, 0)

    def cycle(self, cycle: Cycle) -> None:
        """Read the sensors; if the main loop runs in this cycle, send what is due."""
        self._has_fix = self._has_fix or cycle.fix is not None
        self._has_origin |= cycle.fix is not None and self._fuses_gnss
        if (reading := self._sensors.read(cycle)) is None:
            return
        has_fix, self._has_fix = self._has_fix, False
        self._last = reading
        self.loop_ns = reading.flight_ns
        for name in self._streams.due(reading.number, reading.flight_ns, has_fix):
            self._stream(name, reading)
        if self._streams.is_wanted(GNSS) and (marker := self._sensors.marker(reading)) is not None:
            self._send(GNSS, **marker)
        self._speak()
        if reading.flight_ns >= self._next_timesync_ns:
            self._next_timesync_ns = reading.flight_ns + round(1e9 / self.personality.timesync_rate)
            self._send_timesync(0, reading.t_ns, self._companion)
        if self.personality.gcs_rate and reading.flight_ns >= self._next_gcs_ns:
            self._next_gcs_ns = reading.flight_ns + _GCS_NS
            self._streams.request_group(0, self.personality.gcs_rate)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the link, and answer them."""
        for frame in self._splitter.feed(data):
            if frame.message_id < 0:
                continue
            fields = unpack(frame)
            name = LAYOUTS[frame.message_id].name
            self._received.append(Received(now_ns, frame.component_id, name, fields, frame.raw))
            handler = self._handlers.get(name)
            if handler is not None and self._is_for_us(fields):
                handler(frame, fields, now_ns)

    def heartbeat(self, *, is_armed: bool = False) -> None:
        """Send a heartbeat now."""
        self._send(
            "HEARTBEAT",
            type=self._type,
            autopilot=12 if self.personality.kind is Kind.PX4 else 3,
            base_mode=_CUSTOM_MODE | (_ARMED if is_armed else 0),
            custom_mode=self.personality.custom_mode,
            system_status=_ACTIVE if is_armed else _STANDBY,
            mavlink_version=3,
        )

    def data_to_send(self) -> list[bytes]:
        """Return the frames to be sent, in order, once."""
        frames, self._out = self._out, []
        return frames

    def received(self) -> list[Received]:
        """Return the messages that came since the last call."""
        messages, self._received = self._received, []
        return messages

    def _is_for_us(self, fields: Any) -> bool:
        system = getattr(fields, "target_system", 0)
        component = getattr(fields, "target_component", 0)
        return system in (0, self._config.system_id) and component in (0, COMPONENT_ID)

    def _send(self, name: str, **fields: Any) -> None:
        self._out.append(self._sender.message(name, **fields))

    @property
    def _fuses_gnss(self) -> bool:
        """Whether its filter fuses the receiver's positions, or is not PX4's."""
        return bool(int(self.parameters.get("EKF2_GPS_CTRL", 1)))

    def _stream(self, name: str, cycle: Cycle) -> None:
        if self.navigator is not None and name in _OWN:
            fields = navigation.fields(name, self.navigator, cycle.t_ns)
            if fields is not None and self._is_told(name, fields):
                self._send(name, **fields)
            return
        if self.navigator is not None and name in ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"):
            if not navigation.is_sent(name, self.navigator):
                return
        elif name in _PLACES and not self._has_origin and not self._fuses_gnss:
            return  # on ODOMETRY alone it does not know where it is
        if name == "HEARTBEAT":
            self.heartbeat(is_armed=cycle.is_armed)
        elif name == "AUTOPILOT_VERSION":
            version = self.personality.version
            self._send(
                name, capabilities=8192 | 8, flight_sw_version=version, uid=self._config.system_id
            )
        elif (fields := self._sensors.fields(name, cycle)) is not None:
            fields = {**fields, **self._given} if name == "GPS_GLOBAL_ORIGIN" else fields
            if self._is_told(name, fields):
                self._send(name, **fields)

    def _is_told(self, name: str, fields: Mapping[str, Any]) -> bool:
        """Return whether a message is sent: PX4's origin when it has changed, or on request."""
        is_ideal = self.navigator is None and self.personality.streams is None
        if name != "GPS_GLOBAL_ORIGIN" or is_ideal or self.personality.kind is not Kind.PX4:
            return True
        told, self._told = self._told, tuple(fields[one] for one in _ORIGIN)
        return told != self._told

    def _command(self, frame: Frame, command: Any, now_ns: int) -> None:
        message = LAYOUTS[int(command.param1)].name if int(command.param1) in LAYOUTS else ""
        if command.command == SET_MESSAGE_INTERVAL:
            result = self._streams.request(message, command.param2)
            if result == DENIED and self._streams.is_too_fast(message, command.param2):
                text = f"Requested rate for message ID {command.param1:.0f} too fast."
                self._send("STATUSTEXT", severity=_INFO, text=text.encode()[:50])
        elif command.command == REQUEST_MESSAGE:
            result = self._request(message)
        elif command.command == SET_EKF_SOURCE_SET and self.navigator is not None:
            result = ACCEPTED if self.navigator.select(int(command.param1)) else DENIED
        else:
            result = UNSUPPORTED
        self._answer(frame, command.command, result)

    def _answer(self, frame: Frame, command: int, result: int) -> None:
        self._send(
            "COMMAND_ACK",
            command=command,
            result=result,
            target_system=frame.system_id,
            target_component=frame.component_id,
        )

    def _command_int(self, frame: Frame, command: Any, now_ns: int) -> None:
        is_known = command.command == EXTERNAL_POSITION_ESTIMATE
        is_known &= self.personality.kind is Kind.ARDUPILOT
        is_known &= self.personality.version >= _TAKES_POSITIONS
        result = self._take_position(command) if is_known else UNSUPPORTED
        self._answer(frame, command.command, result)

    def _take_position(self, command: Any) -> int:
        """Move to a position from outside, as ArduPilot does while it has none of its own."""
        lat, lon = command.x * 1e-7, command.y * 1e-7
        if command.frame not in _GLOBAL_FRAMES or not is_place(lat, lon):
            return DENIED
        if self._last is None:
            return FAILED
        place = math.radians(lat), math.radians(lon)
        if self.navigator is not None:
            return ACCEPTED if self.navigator.take_position(*place, command.param3) else FAILED
        return ACCEPTED if self._sensors.take_position(*place, self._last) else FAILED

    def _position_sensor(self, frame: Frame, position: Any, now_ns: int) -> None:
        if self.personality.kind is Kind.PX4:
            # The first that its filter fuses is its origin, where it has none
            self._has_origin |= self.reception.take_position(position)

    def _request(self, message: str) -> int:
        requestable = self.personality.requestable
        is_known = message in self._streams or message == "AUTOPILOT_VERSION"
        if not is_known or (requestable is not None and message not in requestable):
            return UNSUPPORTED
        if self._last is None:
            return FAILED
        self._told = ()
        self._stream(message, self._last)
        return ACCEPTED

    def _data_stream(self, frame: Frame, request: Any, now_ns: int) -> None:
        if self.personality.kind is Kind.ARDUPILOT and request.req_stream_id in (0, *GROUPS):
            rate = request.req_message_rate if request.start_stop else 0
            self._streams.request_group(request.req_stream_id, rate)

    def _heartbeat(self, frame: Frame, heartbeat: Any, now_ns: int) -> None:
        if self.personality.is_timesync_targeted and self.personality.streams is not None:
            self._companion = (frame.system_id, frame.component_id)

    def _odometry(self, frame: Frame, odometry: Any, now_ns: int) -> None:
        if text := self.reception.take(odometry):
            self._send("STATUSTEXT", severity=_CRITICAL, text=text.encode()[:50])
        if self.navigator is not None and self.reception.is_taken:
            stamp_us = self.navigator.arrival.stamp_us(odometry.time_usec, now_ns // 1000)
            self.navigator.odometry(odometry, stamp_us * 1e-6)

    def _vision(self, frame: Frame, vision: Any, now_ns: int) -> None:
        self.reception.take_vision(vision)
        if self.navigator is not None:
            stamp_us = self.navigator.arrival.stamp_us(vision.usec, now_ns // 1000)
            self.navigator.vision(vision, stamp_us * 1e-6)

    def _speak(self) -> None:
        """Send the navigator's texts to the pilot, and a new origin to everybody."""
        if (own := self.navigator) is None:
            return
        for text in own.texts():
            self._send("STATUSTEXT", severity=text.severity, text=text.text.encode()[:50])
        if own.is_origin_new and self._last is not None:
            own.is_origin_new = False
            self._stream("GPS_GLOBAL_ORIGIN", self._last)

    def _set_origin(self, frame: Frame, origin: Any, now_ns: int) -> None:
        if self.navigator is not None:
            lat, lon = (math.radians(angle * 1e-7) for angle in (origin.latitude, origin.longitude))
            self.navigator.set_origin(lat, lon, origin.altitude * 1e-3)
        if self._last is not None and not self._has_origin:
            self.reception.take_origin(self._last.t_ns // 1000)
            self._has_origin = True
            self._given = {one: getattr(origin, one) for one in _ORIGIN}

    def _timesync(self, frame: Frame, sync: Any, now_ns: int) -> None:
        if sync.tc1 == 0:
            theirs = (frame.system_id, frame.component_id)
            if self.personality.has_random_targets:
                theirs = self._random.randrange(256), self._random.randrange(256)
            elif not self.personality.is_timesync_targeted:
                theirs = 0, 0
            self._send_timesync(now_ns, sync.ts1, theirs)
        else:
            self.round_trips_ns.append(now_ns - sync.ts1)
            if isinstance(self.navigator, Ekf2):
                times_us = (time_ns // 1000 for time_ns in (sync.ts1, sync.tc1, now_ns))
                self.navigator.timesync.answer(*times_us)

    def _send_timesync(self, tc1: int, ts1: int, target: tuple[int, int]) -> None:
        system, component = target
        self._send("TIMESYNC", tc1=tc1, ts1=ts1, target_system=system, target_component=component)

    def _param_set(self, frame: Frame, request: Any, now_ns: int) -> None:
        if self._server.set(request):
            self._streams.update()


assert set(SimConfig().streams.__slots__) <= IDS.keys()
