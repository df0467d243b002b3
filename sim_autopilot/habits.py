"""The sensors as a firmware reports them, with its peculiarities.

Which ones, and their sources: :class:`sim_autopilot.personality.Personality`.
"""

from __future__ import annotations

import math

import numpy as np

from ekf_companion.nav import so3
from sim_autopilot import telemetry
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Cycle, Fix, Flow, Motion, Vector
from sim_autopilot.personality import Personality
from sim_autopilot.sensors import earth_field
from sim_autopilot.telemetry import (
    BAROMETER,
    BUILDERS,
    INERTIAL_AND_TEMPERATURE,
    MAGNETOMETER,
    Fields,
)

_SECOND_NS = 1_000_000_000
_LATEST = 2e-3
"""Largest lateness of an iteration of the main loop, s."""
_BIAS_GAIN = 0.1
"""Part of the difference by which the autopilot's bias estimate steps towards the bias."""
_BIAS_NOISE = (3e-5, 5e-3)
"""One sigma of such a step, rad/s and m/s^2: assumed."""
_METRES_PER_RADIAN = 6371e3
_SPARE_COMPASSES = ("SCALED_IMU2", "SCALED_IMU3")
_FLOW = {
    "OPTICAL_FLOW_RAD": telemetry.optical_flow_rad,
    "OPTICAL_FLOW": telemetry.optical_flow,
}
_INERTIAL = ("HIGHRES_IMU", "RAW_IMU", *_SPARE_COMPASSES)


class FirmwareSensors:
    """The sensors as the firmware sees them, from one start of it to the next."""

    def __init__(self, config: SimConfig, personality: Personality, seed: int) -> None:
        """Begin without a sample; ``seed`` decides lateness, gaps and steps."""
        self._config = config
        self._habits = personality
        late, gaps, steps = np.random.SeedSequence(seed, spawn_key=(100,)).spawn(3)
        self._late, self._gaps, self._steps = map(np.random.default_rng, (late, gaps, steps))
        self._loop_every = _whole(config.imu.rate, personality.loop_rate)
        self._mean_every = _whole(config.imu.rate, personality.vehicle_imu_rate)
        self._sum: list[Vector] = []
        self._bias_gyro, self._bias_accel = np.zeros(3), np.zeros(3)
        self._next_step_ns = 0
        self._mag_b: Vector | None = None
        self._spare_mag_b: tuple[Vector, ...] = ()
        self._spare_fix: Fix | None = None
        self._flow: Flow | None = None
        self._baro: tuple[float, float] | None = None
        self._ground_pressure: float | None = None
        self._updated = INERTIAL_AND_TEMPERATURE
        self._fix: Fix | None = None
        self._fix_ns: int | None = None
        self._good_ns: int | None = None
        """When a fix last had a position, on the world's clock."""
        self._held: Motion | None = None
        """The estimate that it reports for good while GNSS is lost."""
        self._moved = (0.0, 0.0)
        """By how much what it was given from outside has moved it since, rad."""
        self._begin_ns: int | None = None
        """Time of the first fix, on the world's clock, like the two beside it."""
        self._next_marker_ns = 0
        self._declination = 0.0
        if personality.origin_after:
            home = config.home
            north, east, _ = earth_field(
                math.radians(home.lat), math.radians(home.lon), home.alt, config.compass.year
            )
            self._declination = math.atan2(east, north)

    def read(self, cycle: Cycle) -> Cycle | None:
        """Take new samples; return them as the main loop has them, None: it does not run now."""
        self._note(cycle)
        cycle = self._averaged(self._corrected(cycle))
        every = max(self._mean_every, self._loop_every)
        if every > 1:
            if (cycle.number + 1) % every:
                return None
            cycle = cycle._replace(number=cycle.number // every)
        if late_ns := self._lateness_ns():
            cycle = cycle._replace(t_ns=cycle.t_ns + late_ns, flight_ns=cycle.flight_ns + late_ns)
        cycle = self._without_gnss(cycle)
        return cycle if self._has_origin(cycle.flight_ns) else self._by_compass(cycle)

    def fields(self, name: str, cycle: Cycle) -> Fields | None:
        """Return the fields of a message of sensors or estimate; None: it is not sent now."""
        spare = _SPARE_COMPASSES.index(name) if name in _SPARE_COMPASSES else len(cycle.spare_imu)
        is_other = spare < len(cycle.spare_imu)
        if name in _INERTIAL and not ((cycle.has_imu or is_other) and not self._is_missing()):
            return None
        if name == "GPS_GLOBAL_ORIGIN" and not self._has_origin(cycle.flight_ns):
            return None
        if name == "GPS_RAW_INT":
            return self._gps_raw_int(cycle)
        if name == "GPS2_RAW":
            fix = self._spare_fix
            return None if fix is None else telemetry.gps2_raw(self._config, fix)
        if name in _FLOW:
            flow = self._flow
            return None if flow is None else _FLOW[name](self._config, flow)
        # The latest magnetometer and barometer samples, new or not
        mag_b, spares = self._mag_b, self._spare_mag_b
        if name in _SPARE_COMPASSES[: len(spares)]:
            mag_b = spares[_SPARE_COMPASSES.index(name)]
        cycle = cycle._replace(mag_b=mag_b, baro=self._baro)
        if is_other:
            gyro_b, accel_b = cycle.spare_imu[spare]
            cycle = cycle._replace(gyro_b=gyro_b, accel_b=accel_b)
        if name == "HIGHRES_IMU":
            return self._highres_imu(cycle)
        return BUILDERS[name](self._config, cycle)

    def _has_origin(self, now_ns: int) -> bool:
        wait = self._habits.origin_after
        return not wait or (self._begin_ns is not None and now_ns - self._begin_ns >= wait * 1e9)

    def _is_missing(self) -> bool:
        """Whether the next inertial message is lost before it is sent."""
        share = self._habits.missing
        return bool(share) and bool(self._gaps.random() < share)

    def _highres_imu(self, cycle: Cycle) -> Fields:
        habits = self._habits
        updated, self._updated = self._updated, INERTIAL_AND_TEMPERATURE
        if habits.is_always_updated:
            updated |= MAGNETOMETER | BAROMETER
        fields = telemetry.highres_imu(self._config, cycle, updated)
        if habits.has_ground_pressure and self._ground_pressure is not None:
            fields["diff_pressure"] = fields["abs_pressure"] - self._ground_pressure
        fields["abs_pressure"] *= habits.pressure_scale
        for axis in ("xmag", "ymag", "zmag"):
            fields[axis] *= habits.mag_scale
        return fields

    def _gps_raw_int(self, cycle: Cycle) -> Fields | None:
        """Return GPS_RAW_INT of the newest fix; None: it is not sent."""
        fix, habits = self._fix, self._habits
        if fix is None:
            return self._before_the_first(cycle) if habits.stray else None
        if habits.is_fix_repeated:
            is_lost = self._is_lost(cycle.flight_ns)
            fix = fix._replace(
                t_ns=fix.t_ns // 1_000_000 * 1_000_000, fix_type=0 if is_lost else fix.fix_type
            )
        fields = telemetry.gps_raw_int(self._config, fix)
        if self._begin_ns is None or cycle.flight_ns - self._begin_ns < habits.utc_after * 1e9:
            fields["time_usec"] = 0
        return fields

    def marker(self, cycle: Cycle) -> Fields | None:
        """Return the GPS_RAW_INT of a silent receiver, once a second; None: not now."""
        if (
            self._habits.is_fix_repeated
            or not self._is_lost(cycle.flight_ns)
            or cycle.flight_ns < self._next_marker_ns
        ):
            return None
        self._next_marker_ns = cycle.flight_ns + _SECOND_NS
        return telemetry.no_gps()

    def _note(self, cycle: Cycle) -> None:
        """Keep new samples of the slow sensors."""
        if cycle.mag_b is not None:
            self._mag_b, self._spare_mag_b = cycle.mag_b, cycle.spare_mag_b
            self._updated |= MAGNETOMETER
        if cycle.baro is not None:
            self._baro = cycle.baro
            self._updated |= BAROMETER
            if self._ground_pressure is None:
                self._ground_pressure = cycle.baro[0]
        self._spare_fix = cycle.spare_fix or self._spare_fix
        self._flow = cycle.flow or self._flow
        if self._fix_ns is None:
            self._fix_ns = cycle.flight_ns
        if cycle.fix is not None:
            self._fix, self._fix_ns = cycle.fix, cycle.flight_ns
            if cycle.fix.fix_type >= 3:
                self._good_ns = cycle.flight_ns
            if self._begin_ns is None and cycle.fix.fix_type >= 3:
                self._begin_ns = cycle.flight_ns

    def _without_gnss(self, cycle: Cycle) -> Cycle:
        """Let the autopilot's own estimate drift, then stand, while GNSS is lost."""
        lost_ns = 0 if self._good_ns is None else cycle.flight_ns - self._good_ns
        if lost_ns < _SECOND_NS:
            self._held, self._moved = None, (0.0, 0.0)
            return cycle
        t, after, now = lost_ns * 1e-9, self._habits.holds_position_after, cycle.estimate
        north = 0.5 * self._habits.outage_drift * t * t
        drifted = now._replace(
            lat=now.lat + north / _METRES_PER_RADIAN + self._moved[0],
            lon=now.lon + self._moved[1],
            pos_n=(now.pos_n[0] + north, *now.pos_n[1:]),
            vel_n=(now.vel_n[0] + self._habits.outage_drift * t, *now.vel_n[1:]),
        )
        if not after or t < after:
            return cycle._replace(estimate=drifted)
        held = self._held = self._held or drifted._replace(
            lat=drifted.lat - self._moved[0], lon=drifted.lon - self._moved[1]
        )
        stands = drifted._replace(
            lat=held.lat + self._moved[0],
            lon=held.lon + self._moved[1],
            pos_n=(*held.pos_n[:2], now.pos_n[2]),
            vel_n=(0.0, 0.0, now.vel_n[2]),
        )
        return cycle._replace(estimate=stands)

    def take_position(self, lat: float, lon: float, reading: Cycle) -> bool:
        """Move the autopilot's own position to one from outside, rad; return whether it did.

        ArduPilot refuses it before its first fix, and within a second of the last
        (``NavEKF3_core::setLatLng``, ``deadReckonDeclare_ms``).
        """
        if self._good_ns is None or reading.flight_ns - self._good_ns < _SECOND_NS:
            return False
        now = reading.estimate
        self._moved = self._moved[0] + lat - now.lat, self._moved[1] + lon - now.lon
        return True

    def _is_lost(self, now_ns: int) -> bool:
        after = self._habits.no_gps_after
        return bool(after) and self._fix_ns is not None and now_ns - self._fix_ns > after * 1e9

    def _before_the_first(self, cycle: Cycle) -> Fields:
        home = self._config.home
        off = self._habits.stray / _METRES_PER_RADIAN
        lat, lon = math.radians(home.lat) - off, math.radians(home.lon)
        t_ns = cycle.t_ns // 1_000_000 * 1_000_000
        fix = Fix(t_ns, lat, lon, home.alt, (0.0, 0.0, 0.0), math.nan, 1)
        return telemetry.gps_raw_int(self._config, fix)

    def _corrected(self, cycle: Cycle) -> Cycle:
        """Subtract the biases that the autopilot's own filter estimates."""
        if not self._habits.bias_step:
            return cycle
        if cycle.flight_ns >= self._next_step_ns:
            self._next_step_ns = cycle.flight_ns + round(self._habits.bias_step * 1e9)
            noise = self._steps.standard_normal((2, 3)) * np.array(_BIAS_NOISE)[:, None]
            self._bias_gyro += _BIAS_GAIN * (cycle.gyro_bias_b - self._bias_gyro) + noise[0]
            self._bias_accel += _BIAS_GAIN * (cycle.accel_bias_b - self._bias_accel) + noise[1]
        return cycle._replace(
            gyro_b=tuple((cycle.gyro_b - self._bias_gyro).tolist()),
            accel_b=tuple((cycle.accel_b - self._bias_accel).tolist()),
        )

    def _averaged(self, cycle: Cycle) -> Cycle:
        """Return the mean over the interval that ends here."""
        if self._mean_every == 1:
            return cycle
        self._sum += [cycle.gyro_b, cycle.accel_b]
        if (cycle.number + 1) % self._mean_every:
            return cycle
        gyro_b, accel_b = np.mean(self._sum[::2], axis=0), np.mean(self._sum[1::2], axis=0)
        self._sum.clear()
        return cycle._replace(gyro_b=tuple(gyro_b.tolist()), accel_b=tuple(accel_b.tolist()))

    def _by_compass(self, cycle: Cycle) -> Cycle:
        """Convert its own heading to magnetic north."""
        roll, pitch, yaw = cycle.estimate.euler
        magnetic = float(so3.wrap(yaw - self._declination))
        return cycle._replace(estimate=cycle.estimate._replace(euler=(roll, pitch, magnetic)))

    def _lateness_ns(self) -> int:
        mean = self._habits.loop_jitter
        return round(min(self._late.exponential(mean), _LATEST) * 1e6) * 1000 if mean else 0


def _whole(rate: float, slower: float) -> int:
    return max(1, round(rate / slower)) if slower else 1
