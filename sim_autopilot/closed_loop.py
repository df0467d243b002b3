"""A vehicle that flies on a companion's ODOMETRY, without a socket and without a clock.

The autopilot's filter (:mod:`sim_autopilot.ekf3`, :mod:`sim_autopilot.ekf2`) takes ODOMETRY over a
link as slow as is wanted, a controller flies by its estimate, and the vehicle really moves: the
score is by its true position. The same seed gives the same flight.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame as Earth
from sim_autopilot import navigation
from sim_autopilot.acceptance import DEFAULTS
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.ekf2 import Ekf2
from sim_autopilot.ekf3 import Ekf3
from sim_autopilot.firmware import IDEAL
from sim_autopilot.flight import Cycle
from sim_autopilot.judgement import Stack
from sim_autopilot.line import Line, Way
from sim_autopilot.loop import Peer
from sim_autopilot.personality import Kind
from sim_autopilot.pilot import Demand, Pilot
from sim_autopilot.vehicle import Cold, Senses, Vehicle

_TICK_NS = 50_000_000
_CONTROL = 0.032
"""Period of the controller, s."""
_COMPASS_STD = 0.05
"""One sigma of the heading that its filter derives from the field, rad."""
_FORWARDED_NS = 1_000_000
_PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
SETS: dict[Kind, dict[str, float]] = {
    Kind.ARDUPILOT: {
        **{name: float(value) for name, value in DEFAULTS[Stack.ARDUPILOT].items()},
        "VISO_TYPE": 1.0,
        "VISO_DELAY_MS": 10.0,
        "EK3_SRC_OPTIONS": 0.0,
        "GPS1_DELAY_MS": 0.0,
        **{f"EK3_SRC2_{part}": 6.0 for part in _PARTS},
    },
    Kind.PX4: {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 0.0, "EKF2_GPS_DELAY": 110.0},
}
"""Parameters of an ArduPilot whose source set 2 is ODOMETRY, and of a PX4 that flies on it
alone."""


class Row(NamedTuple):
    """Record of one period of the controller."""

    t: float
    """Since the start, s."""
    true_n: tuple[float, float, float]
    """True position from the start, m."""
    said_n: tuple[float, float, float]
    """Position that the autopilot reports, by latitude, longitude, altitude, likewise; NaN: not
    known."""
    speed: float
    """True speed, m/s."""


class Heard(NamedTuple):
    """A text on the pilot's screen."""

    t: float
    """s."""
    component_id: int
    severity: int
    text: str


@dataclasses.dataclass(slots=True, eq=False)
class Connection:
    """One computer on a link of its own."""

    peer: Peer
    up: Line
    """Towards the autopilot."""
    down: Line
    offset_ns: int
    """Its clock less the world's."""
    splitter: Splitter
    next_tick_ns: int = 0

    def clock_ns(self, t_ns: int) -> int:
        """Return its clock at a time of the world's."""
        return t_ns + self.offset_ns


class ClosedLoop:
    """One flight."""

    def __init__(
        self,
        kind: Kind = Kind.ARDUPILOT,
        config: SimConfig | None = None,
        *,
        parameters: dict[str, float] | None = None,
        seed: int = 1,
        cold: Cold | None = None,
        wind_n: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Power the autopilot on the ground; ``parameters`` differ from those of :data:`SETS`."""
        config = config or SimConfig()
        own = {**SETS[kind], **config.parameters, **(parameters or {})}
        streams = dataclasses.replace(config.streams, GPS_GLOBAL_ORIGIN=0.0)
        config = dataclasses.replace(config, parameters=own, streams=streams)
        home = config.home
        earth = Earth(float(np.radians(home.lat)), float(np.radians(home.lon)), home.alt)
        self.vehicle = Vehicle(earth, wind_n)
        self.senses = Senses(self.vehicle, config, seed, cold)
        personality = IDEAL[kind]
        personality = dataclasses.replace(personality, rules=kind.value)
        parameters = {**personality.parameters, **own}
        self.navigator = Ekf3(parameters) if kind is Kind.ARDUPILOT else Ekf2(parameters)
        self.autopilot = Autopilot(config, personality, seed=seed, navigator=self.navigator)
        self.navigator.parameters = self.autopilot.parameters
        self.pilot = Pilot(self.navigator)
        self.rows: list[Row] = []
        self.texts: list[Heard] = []
        """Of the autopilot and of all companions, as they were sent."""
        self.sent: list[tuple[float, Any]] = []
        """Each ODOMETRY with the time at which it was sent, s."""
        self.connections: list[Connection] = []
        self._config, self._seed, self._earth = config, seed, earth
        self._period_ns = round(1e6 / config.imu.rate) * 1000
        self._zero_ns = round(home.boot * 1e9)
        self._number = 0
        self._motion = self.navigator.motion()
        self._demand = Demand(accel_n=np.array([0.0, 0.0, 20.0]), yaw=0.0)
        self._control_t = 0.0
        self._due = dict.fromkeys(("gnss", "mag", "baro"), 0.0)
        self._at: list[tuple[float, Callable[[], None]]] = []

    @property
    def t(self) -> float:
        """Return the time since the start, s."""
        return self._number * self._period_ns * 1e-9

    @property
    def now_ns(self) -> int:
        """Return the time of the world's clock, which is the autopilot's."""
        return self._zero_ns + self._number * self._period_ns

    def connect(
        self, peer: Peer, up: Way | None = None, down: Way | None = None, offset_ns: int = 0
    ) -> Connection:
        """Connect a computer."""
        seed = self._seed * 1000 + 2 * len(self.connections)
        up_line = Line(up or Way(), seed, self.now_ns)
        down_line = Line(down or Way(), seed + 1, self.now_ns)
        made = Connection(peer, up_line, down_line, offset_ns, Splitter(), self.now_ns)
        self.connections.append(made)
        return made

    def disconnect(self, connection: Connection) -> None:
        """Disconnect a computer, with all that was on its line."""
        self.connections.remove(connection)

    def switch(self, number: int) -> None:
        """Switch to a source set, as a pilot does by a switch."""
        self.navigator.select(number)

    def run(self, seconds: float) -> None:
        """Fly on for a time."""
        until = self.t + seconds - 1e-9
        while self.t < until:
            self._step()

    def run_until(self, is_done: Callable[[], bool], limit: float) -> bool:
        """Fly on until a condition holds; return whether it did before the limit, s."""
        until = self.t + limit
        while self.t < until:
            if is_done():
                return True
            self._step()
        return is_done()

    def _step(self) -> None:
        dt = self._period_ns * 1e-9
        self.vehicle.step(dt, self._demand.accel_n, self._demand.yaw, self._motion.q_nb)
        self._number += 1
        t, now_ns = self.t, self.now_ns
        own, senses, stamp = self.navigator, self.senses, self.now_ns * 1e-9
        gyro_b, accel_b = senses.imu(dt)
        senses.remember(t)
        own.sample(stamp, gyro_b, accel_b)
        mag_b = self._mag(stamp, t)
        baro = self._baro(stamp, t)
        fix = self._fix(stamp, t)
        if t - self._control_t >= _CONTROL - 1e-9:
            self._control(t)
        truth = self.vehicle.motion()
        self.autopilot.cycle(
            Cycle(
                number=self._number,
                t_ns=now_ns,
                gyro_b=tuple(gyro_b.tolist()),
                accel_b=tuple(accel_b.tolist()),
                mag_b=mag_b,
                baro=baro,
                fix=fix,
                truth=truth,
                estimate=navigation.state(own, self._motion, gyro_b - own.gyro_bias, truth),
                is_armed=self.pilot.mode != "DISARMED",
                is_landed=self.vehicle.is_landed,
                flight_ns=now_ns,
            )
        )
        self._send(now_ns, 1)
        self._exchange(now_ns)

    def _is_due(self, name: str, rate: float, t: float) -> bool:
        if t < self._due[name] - 1e-9:
            return False
        self._due[name] += 1.0 / rate
        return True

    def _mag(self, stamp: float, t: float) -> Any:
        config = self._config.compass
        if not self._is_due("mag", config.rate, t):
            return None
        mag_b = self.senses.mag()
        # The heading that its own attitude and the declination make of the field
        roll, pitch, _ = so3.to_euler(self._motion.q_nb)
        level = so3.from_euler(roll, pitch, 0.0)
        north, east, _ = so3.rotate(level, mag_b)
        declination = np.arctan2(self.senses.field_n[1], self.senses.field_n[0])
        yaw = float(so3.wrap(declination - np.arctan2(east, north)))
        self.navigator.heading(stamp, yaw, _COMPASS_STD)
        return tuple(mag_b.tolist())

    def _baro(self, stamp: float, t: float) -> tuple[float, float] | None:
        if not self._is_due("baro", self._config.baro.rate, t):
            return None
        reading = self.senses.baro()
        self.navigator.baro(stamp, reading[1])
        return reading

    def _fix(self, stamp: float, t: float) -> Any:
        config = self._config.gnss
        if not self._is_due("gnss", config.rate, t):
            return None
        fix = self.senses.fix(t, self.now_ns)
        stds = (config.noise_h, config.noise_v, config.noise_vel)
        self.navigator.receiver(stamp - config.delay, fix, stds)
        return fix

    def _control(self, t: float) -> None:
        self._motion = motion = self.navigator.motion()
        dt, self._control_t = t - self._control_t, t
        self._demand = self.pilot.demand(dt, motion, is_landed=self.vehicle.is_landed)
        place = self.navigator.place(motion)
        said = np.full(3, np.nan) if place is None else self._earth.to_ned(*place)
        true_n, vel_n = self.vehicle.pos_n, self.vehicle.vel_n
        speed = float(np.linalg.norm(vel_n))
        self.rows.append(Row(t, tuple(true_n.tolist()), tuple(said.tolist()), speed))

    # The links

    def _send(self, now_ns: int, component_id: int) -> None:
        """Send the autopilot's frames to all computers."""
        for data in self.autopilot.data_to_send():
            for connection in self.connections:
                connection.down.push(now_ns, data)
            self._listen(data, component_id, now_ns)

    def _exchange(self, now_ns: int) -> None:
        for connection in list(self.connections):
            while (item := connection.down.pop(now_ns)) is not None:
                connection.peer.receive(item[1], connection.clock_ns(max(item[0], 0)))
                self._answer(connection, now_ns)
            if now_ns >= connection.next_tick_ns:
                connection.next_tick_ns = now_ns + _TICK_NS
                connection.peer.tick(connection.clock_ns(now_ns))
                self._answer(connection, now_ns)
            while (item := connection.up.pop(now_ns)) is not None:
                self.autopilot.receive(item[1], now_ns)
                self._forward(connection, item[1], now_ns)
                self.autopilot.received()
                self._send(now_ns, 1)

    def _answer(self, connection: Connection, now_ns: int) -> None:
        for data in connection.peer.data_to_send():
            self._listen(data, 0, now_ns)
            connection.up.push(now_ns, data)

    def _forward(self, sender: Connection, data: bytes, now_ns: int) -> None:
        """Forward broadcasts from one port to the others, as an autopilot does."""
        if len(self.connections) < 2:
            return
        for frame in sender.splitter.feed(data):
            if frame.message_id >= 0 and not getattr(unpack(frame), "target_system", 0):
                for other in self.connections:
                    if other is not sender:
                        other.down.push(now_ns + _FORWARDED_NS, frame.raw)

    def _listen(self, data: bytes, component_id: int, now_ns: int) -> None:
        """Record texts and ODOMETRY."""
        for frame in Splitter().feed(data):
            name = LAYOUTS[frame.message_id].name if frame.message_id in LAYOUTS else ""
            if name == "STATUSTEXT":
                m = unpack(frame)
                text = m.text.rstrip(b"\0").decode("utf-8", "replace")
                self.texts.append(Heard(self.t, frame.component_id, m.severity, text))
            elif name == "ODOMETRY":
                self.sent.append((self.t, unpack(frame)))

    # Scores

    def true_n(self, begin: float = 0.0, end: float = 1e9) -> Array:
        """Return the true positions in a range of seconds, shape (n, 3), m."""
        return np.array([row.true_n for row in self.rows if begin <= row.t <= end])

    def moved(self, begin: float, end: float | None = None) -> Array:
        """Return the largest true distance from the position at a time, by axis, m."""
        way = self.true_n(begin, self.t if end is None else end)
        return np.asarray(np.abs(way - way[0]).max(axis=0))

    def said_error(self, begin: float = 0.0, end: float = 1e9) -> Array:
        """Return reported less true positions, shape (n, 3), m."""
        rows = [row for row in self.rows if begin <= row.t <= end]
        return np.array([np.subtract(row.said_n, row.true_n) for row in rows])
