"""The fields of the autopilot's messages for a cycle: SI to units of the wire."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.earth import STANDARD_GRAVITY
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Cycle, Fix, Flow

Fields = dict[str, Any]
Builder = Callable[[SimConfig, Cycle], Fields]

MAGNETOMETER = 64 | 128 | 256
BAROMETER = 512 | 2048
INERTIAL_AND_TEMPERATURE = 0x3F | 4096
"""Bits of HIGHRES_IMU.fields_updated."""
POSE_DIAGONAL = (0, 6, 11, 15, 18, 20)
"""Of a 6 x 6 covariance sent as its upper right triangle."""
_SENSORS = 1 | 2 | 4 | 8 | 16 | 32
"""MAV_SYS_STATUS_SENSOR: gyro, accelerometer, compass, absolute and differential pressure, GPS."""
GEOID = 47.0
"""Height of the sea level above the ellipsoid that the receiver reports, m."""
_NO_FIELD, _NO_AIR = (0.0, 0.0, 0.0), (0.0, 0.0)
"""Of magnetometer and barometer before the first sample."""


def highres_imu(config: SimConfig, cycle: Cycle, fields_updated: int) -> Fields:
    """Return HIGHRES_IMU of a reading, by which of its samples are new."""
    return {
        "time_usec": cycle.t_ns // 1000,
        **dict(zip(("xacc", "yacc", "zacc"), cycle.accel_b, strict=True)),
        **dict(zip(("xgyro", "ygyro", "zgyro"), cycle.gyro_b, strict=True)),
        **dict(zip(("xmag", "ymag", "zmag"), cycle.mag_b or _NO_FIELD, strict=True)),
        **dict(zip(("abs_pressure", "pressure_alt"), cycle.baro or _NO_AIR, strict=True)),
        "temperature": config.baro.temperature,
        "fields_updated": fields_updated,
    }


def gps_raw_int(config: SimConfig, fix: Fix) -> Fields:
    """Return GPS_RAW_INT with the true accuracies."""
    gnss = config.gnss
    north, east, _ = fix.vel_n
    return {
        "time_usec": fix.t_ns // 1000,
        "fix_type": fix.fix_type,
        "lat": _degE7(fix.lat),
        "lon": _degE7(fix.lon),
        "alt": round(fix.alt * 1e3),
        "eph": 70,
        "epv": 110,
        "vel": round(math.hypot(north, east) * 1e2),
        "cog": centidegrees(math.atan2(east, north)),
        "satellites_visible": 17 if fix.fix_type else 0,
        "alt_ellipsoid": round((fix.alt + GEOID) * 1e3),
        "h_acc": round(math.hypot(gnss.noise_h, gnss.slow_h) * 1e3),
        "v_acc": round(math.hypot(gnss.noise_v, gnss.slow_v) * 1e3),
        "vel_acc": round(gnss.noise_vel * 1e3),
        "hdg_acc": round(math.degrees(gnss.noise_yaw) * 1e5) if gnss.yaw else 0,
        # 0 means that there is none, so north is 36000
        "yaw": (centidegrees(fix.yaw) or 36000) if gnss.yaw else 0,
    }


def gps2_raw(config: SimConfig, fix: Fix) -> Fields:
    """Return GPS2_RAW of the second receiver's fix."""
    return gps_raw_int(config, fix)


def no_gps() -> Fields:
    """Return GPS_RAW_INT without a receiver (PX4): each number is marked as unknown."""
    unknown = dict.fromkeys(("eph", "epv", "vel", "cog"), 65535)
    return {"time_usec": 0, "fix_type": 0, "satellites_visible": 255, **unknown}


def _raw_imu(config: SimConfig, cycle: Cycle) -> Fields:
    return {"time_usec": cycle.t_ns // 1000, **_whole_units(cycle)}


def _scaled_imu(config: SimConfig, cycle: Cycle) -> Fields:
    return {"time_boot_ms": _boot_ms(cycle), **_whole_units(cycle)}


def _whole_units(cycle: Cycle) -> Fields:
    """Return a reading as ArduPilot scales it: mG, mrad/s and mgauss, cut to whole numbers."""
    groups = (
        ("acc", cycle.accel_b, 1e3 / STANDARD_GRAVITY),
        ("gyro", cycle.gyro_b, 1e3),
        ("mag", cycle.mag_b or _NO_FIELD, 1e3),
    )
    return {
        f"{axis}{what}": _int16(value * scale)
        for what, vector, scale in groups
        for axis, value in zip("xyz", vector, strict=True)
    }


def _int16(value: float) -> int:
    return int(max(-32768.0, min(32767.0, value))) if math.isfinite(value) else 0


def _scaled_pressure(config: SimConfig, cycle: Cycle) -> Fields:
    return {
        "time_boot_ms": _boot_ms(cycle),
        "press_abs": (cycle.baro or _NO_AIR)[0],
        "temperature": round(config.baro.temperature * 1e2),
    }


def _distance_sensor(config: SimConfig, cycle: Cycle) -> Fields:
    sensor = config.range_finder
    return {
        "time_boot_ms": _boot_ms(cycle),
        "min_distance": round(sensor.lowest * 1e2),
        "max_distance": round(sensor.highest * 1e2),
        "current_distance": round((cycle.range_m or 0.0) * 1e2),
        "orientation": 25,
        "covariance": min(round((sensor.noise * 1e2) ** 2), 254),
    }


def _airspeed(config: SimConfig, cycle: Cycle) -> Fields:
    """Return AIRSPEED of the first sensor, which the autopilot uses."""
    return {
        "airspeed": cycle.airspeed or 0.0,
        "raw_press": 0.5 * 1.225 * (cycle.airspeed or 0.0) ** 2,
        "temperature": round(config.baro.temperature * 1e2),
        "flags": 2,
    }


def _vfr_hud(config: SimConfig, cycle: Cycle) -> Fields:
    estimate = cycle.estimate
    north, east, down = estimate.vel_n
    return {
        "airspeed": cycle.airspeed or 0.0,
        "groundspeed": math.hypot(north, east),
        "heading": round(math.degrees(estimate.euler[2])) % 360,
        "alt": estimate.alt,
        "climb": -down,
    }


def _sys_status(config: SimConfig, cycle: Cycle) -> Fields:
    """Return SYS_STATUS of sensors that are there, used and healthy: the pitot tube among them."""
    names = ("present", "enabled", "health")
    return {f"onboard_control_sensors_{name}": _SENSORS for name in names}


def _wheel_distance(config: SimConfig, cycle: Cycle) -> Fields:
    way = cycle.wheel_m or 0.0
    return {"time_usec": cycle.t_ns // 1000, "count": 2, "distance": [way] * 2 + [0.0] * 14}


def optical_flow_rad(config: SimConfig, flow: Flow) -> Fields:
    """Return OPTICAL_FLOW_RAD: integrals over the interval (PX4)."""
    interval = 1.0 / config.flow.rate
    x, y = (rate * interval for rate in flow.rate)
    gyro_x, gyro_y = (rate * interval for rate in flow.gyro)
    return {
        "time_usec": flow.t_ns // 1000,
        "integration_time_us": round(interval * 1e6),
        "integrated_x": x,
        "integrated_y": y,
        "integrated_xgyro": gyro_x,
        "integrated_ygyro": gyro_y,
        "integrated_zgyro": math.nan,
        "distance": -1.0,
        "quality": round(flow.quality * 255.0),
    }


def optical_flow(config: SimConfig, flow: Flow) -> Fields:
    """Return OPTICAL_FLOW as ArduPilot fills it: whole rates, ms, the flow less the gyro."""
    (x, y), (gyro_x, gyro_y) = flow.rate, flow.gyro
    return {
        "time_usec": flow.t_ns // 1_000_000,
        "flow_x": int(x),
        "flow_y": int(y),
        "flow_comp_m_x": x - gyro_x,
        "flow_comp_m_y": y - gyro_y,
        "quality": round(flow.quality * 255.0),
        "flow_rate_x": x,
        "flow_rate_y": y,
    }


def _odometry(config: SimConfig, cycle: Cycle) -> Fields:
    """Return the autopilot's own estimate like PX4: only the diagonals are numbers."""
    estimate, e = cycle.estimate, config.estimate
    q_nb = so3.from_euler(*estimate.euler)
    vel_b = so3.rotate(so3.conjugate(q_nb), np.array(estimate.vel_n))
    return {
        "time_usec": cycle.t_ns // 1000,
        "frame_id": 1,
        "child_frame_id": 12,
        **dict(zip("xyz", estimate.pos_n, strict=True)),
        "q": tuple(q_nb.tolist()),
        **dict(zip(("vx", "vy", "vz"), vel_b.tolist(), strict=True)),
        **dict(zip(("rollspeed", "pitchspeed", "yawspeed"), estimate.rate_b, strict=True)),
        "pose_covariance": _diagonal(*[e.position] * 3, *[e.tilt] * 2, e.yaw),
        "velocity_covariance": _diagonal(*[e.velocity] * 3, *[math.nan] * 3),
        "estimator_type": 8,
    }


def _diagonal(*sigmas: float) -> tuple[float, ...]:
    """Return the upper right triangle of a 6 x 6 covariance, NaN beside the diagonal."""
    triangle = [math.nan] * 21
    for place, sigma in zip(POSE_DIAGONAL, sigmas, strict=True):
        triangle[place] = sigma * sigma
    return tuple(triangle)


def _attitude(config: SimConfig, cycle: Cycle) -> Fields:
    estimate = cycle.estimate
    return {
        "time_boot_ms": _boot_ms(cycle),
        **dict(zip(("roll", "pitch", "yaw"), estimate.euler, strict=True)),
        **dict(zip(("rollspeed", "pitchspeed", "yawspeed"), estimate.rate_b, strict=True)),
    }


def _global_position_int(config: SimConfig, cycle: Cycle) -> Fields:
    estimate = cycle.estimate
    return {
        "time_boot_ms": _boot_ms(cycle),
        "lat": _degE7(estimate.lat),
        "lon": _degE7(estimate.lon),
        "alt": round(estimate.alt * 1e3),
        "relative_alt": round(-estimate.pos_n[2] * 1e3),
        "vx": round(estimate.vel_n[0] * 1e2),
        "vy": round(estimate.vel_n[1] * 1e2),
        "vz": round(estimate.vel_n[2] * 1e2),
        "hdg": centidegrees(estimate.euler[2]),
    }


def _local_position_ned(config: SimConfig, cycle: Cycle) -> Fields:
    estimate = cycle.estimate
    return {
        "time_boot_ms": _boot_ms(cycle),
        **dict(zip("xyz", estimate.pos_n, strict=True)),
        **dict(zip(("vx", "vy", "vz"), estimate.vel_n, strict=True)),
    }


def _sim_state(config: SimConfig, cycle: Cycle) -> Fields:
    truth = cycle.truth
    return {
        **dict(zip(("q1", "q2", "q3", "q4"), truth.q_nb, strict=True)),
        **dict(zip(("roll", "pitch", "yaw"), truth.euler, strict=True)),
        **dict(zip(("xacc", "yacc", "zacc"), truth.accel_b, strict=True)),
        **dict(zip(("xgyro", "ygyro", "zgyro"), truth.rate_b, strict=True)),
        "lat": math.degrees(truth.lat),
        "lon": math.degrees(truth.lon),
        "alt": truth.alt,
        "std_dev_horz": 0.0,
        "std_dev_vert": 0.0,
        **dict(zip(("vn", "ve", "vd"), truth.vel_n, strict=True)),
        "lat_int": _degE7(truth.lat),
        "lon_int": _degE7(truth.lon),
    }


def _system_time(config: SimConfig, cycle: Cycle) -> Fields:
    return {
        "time_unix_usec": round(config.home.unix * 1e6) + cycle.flight_ns // 1000,
        "time_boot_ms": _boot_ms(cycle),
    }


def _extended_sys_state(config: SimConfig, cycle: Cycle) -> Fields:
    return {"landed_state": 1 if cycle.is_landed else 2}


def _gps_global_origin(config: SimConfig, cycle: Cycle) -> Fields:
    home = config.home
    return {
        "latitude": round(home.lat * 1e7),
        "longitude": round(home.lon * 1e7),
        "altitude": round(home.alt * 1e3),
        "time_usec": cycle.t_ns // 1000,
    }


def _degE7(angle: float) -> int:  # noqa: N802  # the unit's own spelling
    return round(math.degrees(angle) * 1e7)


def centidegrees(angle: float) -> int:
    """Return an angle (rad) as 0 to 35999 hundredths of a degree."""
    return round(math.degrees(angle) * 1e2) % 36000


def _boot_ms(cycle: Cycle) -> int:
    return cycle.t_ns // 1_000_000 & 0xFFFFFFFF


BUILDERS: dict[str, Builder] = {
    "ATTITUDE": _attitude,
    "GLOBAL_POSITION_INT": _global_position_int,
    "LOCAL_POSITION_NED": _local_position_ned,
    "SIM_STATE": _sim_state,
    "SYSTEM_TIME": _system_time,
    "EXTENDED_SYS_STATE": _extended_sys_state,
    "GPS_GLOBAL_ORIGIN": _gps_global_origin,
    "ODOMETRY": _odometry,
    "RAW_IMU": _raw_imu,
    "SCALED_IMU2": _scaled_imu,
    "SCALED_IMU3": _scaled_imu,
    "SCALED_PRESSURE": _scaled_pressure,
    "DISTANCE_SENSOR": _distance_sensor,
    "AIRSPEED": _airspeed,
    "WHEEL_DISTANCE": _wheel_distance,
    "VFR_HUD": _vfr_hud,
    "SYS_STATUS": _sys_status,
}
"""Messages that depend on a reading alone."""
