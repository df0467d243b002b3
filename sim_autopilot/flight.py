"""A flight in order of time: one cycle of the autopilot's loop per inertial sample.

``generate`` and ``fly`` iterate over the same cycles; only the clock differs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from sim_autopilot import sensors
from sim_autopilot.config import SimConfig
from sim_autopilot.scenarios import SCENARIOS, Scenario
from sim_autopilot.truth import Trajectory, Truth

Vector = tuple[float, float, float]

_CHUNK = 256
"""Cycles computed at once: a millisecond of work, so that a live flight does not stutter."""
_ARMS_BEFORE = 1.0
"""The vehicle is armed so long before it moves, s."""


class Motion(NamedTuple):
    """The vehicle's true state, or the autopilot's estimate of it."""

    lat: float
    """rad."""
    lon: float
    """rad."""
    alt: float
    """m."""
    pos_n: Vector
    """North, east, down of home, m."""
    vel_n: Vector
    """m/s."""
    q_nb: tuple[float, float, float, float]
    euler: Vector
    """Roll, pitch, yaw, rad."""
    rate_b: Vector
    """rad/s."""
    accel_b: Vector
    """Specific force, m/s^2."""


class Fix(NamedTuple):
    """A fix of the receiver."""

    t_ns: int
    """Its stamp."""
    lat: float
    """rad."""
    lon: float
    """rad."""
    alt: float
    """m."""
    vel_n: Vector
    """m/s."""
    yaw: float
    """rad; NaN: none."""
    fix_type: int = 3
    """As in GPS_RAW_INT: 0 is no fix, 3 a fix in three dimensions."""


class Flow(NamedTuple):
    """Means over an interval of an optical flow sensor."""

    t_ns: int
    """End of the interval, on the autopilot's clock."""
    rate: tuple[float, float]
    """Of the ground across the image, rad/s, by OPTICAL_FLOW_RAD's convention."""
    gyro: tuple[float, float]
    """Of the sensor, rad/s."""
    quality: float
    """From 0 to 1."""


class Cycle(NamedTuple):
    """The new samples of one cycle of the autopilot's loop."""

    number: int
    t_ns: int
    """Of the end of the inertial sample, on the autopilot's clock."""
    gyro_b: Vector
    accel_b: Vector
    mag_b: Vector | None
    """gauss; None: nothing new."""
    baro: tuple[float, float] | None
    """Pressure, hPa, and altitude, m; None: nothing new."""
    fix: Fix | None
    """None: nothing new."""
    truth: Motion
    estimate: Motion
    """The autopilot's own."""
    is_armed: bool
    is_landed: bool
    flight_ns: int
    """The same time on the world's clock, which no fault changes."""
    gyro_bias_b: Vector = (0.0, 0.0, 0.0)
    """The slow error in it, which the autopilot's filter estimates, rad/s."""
    accel_bias_b: Vector = (0.0, 0.0, 0.0)
    """m/s^2."""
    has_imu: bool = True
    """Whether there is an inertial sample at all."""
    spare_mag_b: tuple[Vector, ...] = ()
    """Of the other magnetometers, with ``mag_b``, gauss."""
    spare_fix: Fix | None = None
    """Of the other receiver; None: nothing new."""
    spare_imu: tuple[tuple[Vector, Vector], ...] = ()
    """Rate and specific force of the other inertial units, rad/s and m/s^2."""
    range_m: float | None = None
    """To the ground along the body's down axis; None: there is no range finder."""
    airspeed: float | None = None
    """Indicated, m/s; None: there is no pitot tube."""
    wheel_m: float | None = None
    """Way of the wheels so far, m; None: there are no encoders."""
    flow: Flow | None = None
    """None: nothing new."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Flight:
    """A scenario with all random numbers drawn."""

    scenario: Scenario
    config: SimConfig
    seed: int
    trajectory: Trajectory
    zero_ns: int
    """Time 0 of the trajectory on the autopilot's clock."""
    period_ns: int
    """Between inertial samples."""
    imu: sensors.ImuData
    gnss: sensors.GnssData
    mag: sensors.MagData
    spare_mag: tuple[sensors.MagData, ...]
    spare_gnss: sensors.GnssData | None
    spare_imu: tuple[sensors.ImuData, ...]
    baro: sensors.BaroData
    range_white: Array
    """Unit white noise of the range finder, shape (n,); (0,) without one."""
    airspeed: Array
    """Indicated, m/s, shape (n,); (0,) without a pitot tube."""
    wheel: Array
    """Way of the wheels so far, m, likewise."""
    estimate_error: Array
    """Of position, velocity, roll, pitch and yaw, shape (n, 9)."""
    flow: sensors.FlowData | None = None
    """None: there is no optical flow sensor."""

    @classmethod
    def plan(
        cls,
        name: str,
        config: SimConfig,
        *,
        seed: int = 1,
        duration: float | None = None,
        skip: float = 0.0,
    ) -> Flight:
        """Draw a flight of a scenario; the same seed gives the same bits.

        The duration is in s, None: the scenario's. The flight begins ``skip`` seconds into the
        scenario: a start in motion.
        """
        scenario = SCENARIOS[name]
        duration = scenario.duration if duration is None else duration
        home = config.home
        frame = LocalFrame(float(np.radians(home.lat)), float(np.radians(home.lon)), home.alt)
        extra = (config.airspeed.wind,) if scenario.is_wing else ()
        trajectory = scenario.build(frame, skip + duration, *extra)
        rng = sensors.generators(seed)

        # Whole microseconds, as the messages' stamps are
        period_ns = round(1e6 / config.imu.rate) * 1000
        period = period_ns * 1e-9
        count = int(duration / period + 1e-9)
        t: Array = np.asarray(skip + period * np.arange(1, count + 1), dtype=np.float64)
        fix_count = int(duration * config.gnss.rate + 1e-9)
        fix_t = skip + np.arange(1, fix_count + 1) / config.gnss.rate
        mag_t = _every(t, period, config.compass.rate)
        baro_t = _every(t, period, config.baro.rate)
        spare_mag = []
        for generator in (rng["compass 2"], rng["compass 3"])[: config.spare.compasses]:
            iron = config.spare.hard_iron * generator.standard_normal(3)
            other = replace(config.compass, hard_iron=tuple(iron.tolist()))
            spare_mag.append(sensors.compass(trajectory, other, generator, mag_t))
        spare_gnss = None
        if config.spare.receivers:
            spare_gnss = sensors.gnss(trajectory, config.gnss, rng["gnss 2"], fix_t)
        spare_imu = [
            sensors.imu(trajectory, config.imu, generator, t, period)
            for generator in (rng["imu 2"], rng["imu 3"])[: config.spare.units]
        ]
        airspeed = wheel = np.zeros(0)
        if config.airspeed.fitted:
            late = trajectory.at(t - config.airspeed.delay)
            noise = rng["airspeed"].standard_normal((count, 2))
            airspeed = sensors.airspeeds(config.airspeed, noise, late, period)
        if config.wheel.fitted:
            noise = rng["wheel"].standard_normal(count)
            wheel = sensors.wheel_distances(config.wheel, noise, trajectory.at(t), period)
        flow = None
        if config.flow.fitted:
            flow_t = _every(t, period, config.flow.rate)
            mounted = config.range_finder.mounted
            flow = sensors.flow(trajectory, config.flow, mounted, rng["flow"], flow_t)
        e = config.estimate
        sigmas = np.repeat([e.position, e.velocity, e.tilt, e.yaw], [3, 3, 2, 1])
        return cls(
            scenario=scenario,
            config=config,
            seed=seed,
            trajectory=trajectory,
            zero_ns=round((home.boot - skip) * 1e9),
            period_ns=period_ns,
            imu=sensors.imu(trajectory, config.imu, rng["imu"], t, period),
            gnss=sensors.gnss(trajectory, config.gnss, rng["gnss"], fix_t),
            mag=sensors.compass(trajectory, config.compass, rng["compass"], mag_t),
            spare_mag=tuple(spare_mag),
            spare_gnss=spare_gnss,
            spare_imu=tuple(spare_imu),
            baro=sensors.baro(trajectory, config.baro, rng["baro"], baro_t),
            range_white=rng["range"].standard_normal(count * config.range_finder.fitted),
            airspeed=airspeed,
            wheel=wheel,
            estimate_error=sensors.slow_errors(rng["estimate"], count, sigmas, period, e.time),
            flow=flow,
        )

    def __len__(self) -> int:
        """Return the number of cycles."""
        return len(self.imu.t)

    @property
    def duration(self) -> float:
        """The length of the flight, s."""
        return len(self) * self.period_ns * 1e-9

    @property
    def first_ns(self) -> int:
        """The time of the first cycle on the autopilot's clock."""
        return self.to_ns(float(self.imu.t[0]))

    def to_ns(self, t: float) -> int:
        """Convert a time of the trajectory to the autopilot's clock, in whole microseconds."""
        return self.zero_ns + round(t * 1e6) * 1000

    def truth_at(self, t_ns: npt.NDArray[np.int64]) -> Truth:
        """Return the motion at times on the autopilot's clock."""
        return self.trajectory.at(np.asarray((t_ns - self.zero_ns) * 1e-9, dtype=np.float64))

    def cycles(self) -> Iterator[Cycle]:
        """Yield the cycles in order of time."""
        t = self.imu.t
        mag = _arrivals(t, self.mag.t, zip(*self.mag.mag_b.T.tolist(), strict=True))
        baro = _arrivals(
            t, self.baro.t, zip(self.baro.pressure.tolist(), self.baro.alt.tolist(), strict=True)
        )
        fixes = _arrivals(t, self.gnss.t, self._fixes(self.gnss))
        columns = [map(tuple, one.mag_b.tolist()) for one in self.spare_mag]
        spare_mag = _arrivals(t, self.mag.t, zip(*columns, strict=True)) if columns else {}
        other = self.spare_gnss
        spare_fixes = {} if other is None else _arrivals(t, other.t, self._fixes(other))
        flows = {} if self.flow is None else _arrivals(t, self.flow.t, self._flows(self.flow))
        for start in range(0, len(t), _CHUNK):
            part = slice(start, start + _CHUNK)
            truth = self.trajectory.at(t[part])
            is_landed, is_armed = self._ground_contact(truth)
            rows = zip(
                t[part].tolist(),
                self.imu.gyro_b[part].tolist(),
                self.imu.accel_b[part].tolist(),
                self.imu.gyro_bias_b[part].tolist(),
                self.imu.accel_bias_b[part].tolist(),
                _motions(truth),
                _motions(self._estimate(truth, self.estimate_error[part])),
                is_armed,
                is_landed,
                self._ranges(truth, part),
                _or_none(self.airspeed, part, len(truth.t)),
                _or_none(self.wheel, part, len(truth.t)),
                self._spare_imu(part, len(truth.t)),
                strict=True,
            )
            for number, row in enumerate(rows, start):
                t_s, gyro, accel, gyro_bias, accel_bias, true, estimate, armed, landed = row[:9]
                far, airspeed, wheel_m, spare_imu = row[9:]
                now_ns = self.to_ns(t_s)
                yield Cycle(
                    number=number,
                    t_ns=now_ns,
                    gyro_b=tuple(gyro),
                    accel_b=tuple(accel),
                    mag_b=mag.get(number),
                    baro=baro.get(number),
                    fix=fixes.get(number),
                    truth=true,
                    estimate=estimate,
                    is_armed=armed,
                    is_landed=landed,
                    flight_ns=now_ns,
                    gyro_bias_b=tuple(gyro_bias),
                    accel_bias_b=tuple(accel_bias),
                    spare_mag_b=spare_mag.get(number, ()),
                    spare_fix=spare_fixes.get(number),
                    spare_imu=spare_imu,
                    range_m=far,
                    airspeed=airspeed,
                    wheel_m=wheel_m,
                    flow=flows.get(number),
                )

    def _fixes(self, data: sensors.GnssData) -> Iterator[Fix]:
        columns = (data.t, data.lat, data.lon, data.alt, data.vel_n, data.yaw)
        for t, lat, lon, alt, vel_n, yaw in zip(*(c.tolist() for c in columns), strict=True):
            yield Fix(self.to_ns(t), lat, lon, alt, tuple(vel_n), yaw)

    def _spare_imu(self, part: slice, count: int) -> list[tuple[tuple[Vector, Vector], ...]]:
        """Return the readings of the other inertial units, by cycle."""
        found: list[list[tuple[Vector, Vector]]] = [[] for _ in range(count)]
        for one in self.spare_imu:
            rows = zip(one.gyro_b[part].tolist(), one.accel_b[part].tolist(), strict=True)
            for units, (gyro, accel) in zip(found, rows, strict=True):
                units.append((tuple(gyro), tuple(accel)))
        return [tuple(units) for units in found]

    def _flows(self, data: sensors.FlowData) -> Iterator[Flow]:
        columns = (data.t, data.flow, data.gyro, data.quality)
        for t, rate, gyro, quality in zip(*(c.tolist() for c in columns), strict=True):
            yield Flow(self.to_ns(t), tuple(rate), tuple(gyro), quality)

    def _ranges(self, truth: Truth, part: slice) -> list[float] | list[None]:
        if not len(self.range_white):
            return [None] * len(truth.t)
        height = truth.alt - self.config.home.alt
        config, white = self.config.range_finder, self.range_white[part]
        found: list[float] = sensors.ranges(config, white, height, truth.q_nb).tolist()
        return found

    def _ground_contact(self, truth: Truth) -> tuple[list[bool], list[bool]]:
        """Return whether it stands on the ground, and whether it is armed."""
        if not self.scenario.is_airborne:
            return [True] * len(truth.t), [False] * len(truth.t)
        soon = self.trajectory.at(truth.t + _ARMS_BEFORE)
        return _is_at_rest(truth).tolist(), (~_is_at_rest(soon)).tolist()

    def _estimate(self, truth: Truth, error: Array) -> Truth:
        pos_n, euler = truth.pos_n + error[:, :3], truth.euler + error[:, 6:]
        lat, lon, alt = self.trajectory.frame.to_geodetic(pos_n)
        return replace(
            truth,
            pos_n=pos_n,
            lat=lat,
            lon=lon,
            alt=alt,
            vel_n=truth.vel_n + error[:, 3:6],
            q_nb=so3.from_euler(euler[:, 0], euler[:, 1], euler[:, 2]),
            euler=euler,
        )


def _or_none(readings: Array, part: slice, count: int) -> list[float] | list[None]:
    """Return the readings of a part of the flight, of a sensor that may not be there."""
    if not len(readings):
        return [None] * count
    found: list[float] = readings[part].tolist()
    return found


def _every(t: Array, period: float, rate: float) -> Array:
    """Return the inertial sampling times at which a slower sensor of the same board is read."""
    step = max(1, round(1.0 / (rate * period)))
    return t[step - 1 :: step]


def _arrivals(cycles: Array, t: Array, samples: Iterator[Any]) -> dict[int, Any]:
    """Return samples by the index of the first cycle that has them."""
    index = np.searchsorted(cycles, t - 1e-9)  # a nanosecond for the rounding of equal times
    return dict(zip(index.tolist(), samples, strict=True))


def _is_at_rest(truth: Truth) -> npt.NDArray[np.bool_]:
    speed = np.linalg.norm(truth.vel_n, axis=1)
    return np.asarray((speed < 0.02) & (np.abs(truth.pos_n[:, 2]) < 0.02))


def _motions(truth: Truth) -> Iterator[Motion]:
    place = (truth.lat, truth.lon, truth.alt, truth.pos_n, truth.vel_n)
    attitude = (truth.q_nb, so3.wrap(truth.euler), truth.rate_nb_b, truth.accel_b)
    for row in zip(*(column.tolist() for column in place + attitude), strict=True):
        yield Motion(*row)
