"""What sources beside the usual sensors say along a flight, with errors of a usual size.

Each function adds its readings, and what has to be configured for them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from benchmarks.truth import earth
from benchmarks.truth.draw import DEG, Draw
from benchmarks.truth.earth import Array
from benchmarks.truth.motion import FINE, Flight, rotate, transpose
from benchmarks.truth.sensors import Readings, Source, gauss_markov

Mask = npt.NDArray[np.bool_]
ANCHORS_T = np.array([[n, e, d] for n in (-50, 50) for e in (-50, 50) for d in (-2, -30)], float)
"""Of eight anchors, in the tangent plane at the start, m."""
MOUNTED = 0.15
"""Height of the sensors above the ground while the vehicle stands, m."""


def every(flight: Flight, rate: float) -> Array:
    """Return the times of a rate, Hz."""
    return np.arange(1, int(flight.t[-1] * rate) + 1) / rate


def add(readings: Readings, t: Array, late: float, values: dict[str, Array]) -> Source:
    """Add a source whose readings are known so late, s, with the stamp of when they were true."""
    columns = np.stack(np.broadcast_arrays(*values.values()), axis=1).astype(float)
    source = Source(t + late, t.copy(), tuple(values), columns)
    readings.sources.append(source)
    return source


def anchors(readings: Readings, draw: Draw) -> Source:
    """Range eight anchors 40 times a second in turn; now and then something stands between."""
    flight, rng, t = readings.flight, draw.rng, every(readings.flight, 40.0)
    number = np.arange(len(t)) % len(ANCHORS_T)
    places_e = flight.pos_e[0] + ANCHORS_T @ flight.C_en[0].T
    far = np.linalg.norm(flight.pos_e[flight.index(t)] - places_e[number], axis=1)
    own = 0.15 + 0.03 * rng.standard_normal(len(ANCHORS_T))
    # hidden for some seconds, 15 % of the time, and longer by some 0.3 m then
    hidden = gauss_markov(rng, (len(t) // len(ANCHORS_T) + 1, len(ANCHORS_T)), 1.0, 3.0, 0.2)
    detour = 0.3 * (hidden > 1.04).ravel()[: len(t)]
    place(readings, ANCHORS_T)
    found = far + own[number] + detour + 0.07 * rng.standard_normal(len(t))
    return add(readings, t, 0.01, {"anchor_range_m": found, "anchor": number.astype(float)})


def place(readings: Readings, places_t: Array) -> None:
    """Configure the places of the anchors, given in the tangent plane at the start, m."""
    flight = readings.flight
    lat, lon, alt = earth.to_geodetic(flight.pos_e[0] + places_t @ flight.C_en[0].T)
    table = np.column_stack([np.arange(len(places_t)), lat / DEG, lon / DEG, alt]).tolist()
    readings.settings["anchor_range"] = {"places": "geodetic", "anchors": table}


def range_finder(readings: Readings, draw: Draw) -> Source:
    """Measure the way to nearly level ground along the body's down axis."""
    t = every(readings.flight, 20.0)
    relief = gauss_markov(draw.rng, (len(t), 1), 0.1, 5.0, 0.05)[:, 0]
    found = _distance(readings.flight, t) + relief + 0.05 * draw.rng.standard_normal(len(t))
    return add(readings, t, 0.01, {"range_m": np.clip(found, 0.1, 60.0)})


def _distance(flight: Flight, t: Array) -> Array:
    """Return how far the level ground is along the body's down axis, m."""
    k = flight.index(t)
    height = earth.to_geodetic(flight.pos_e[k])[2] - earth.to_geodetic(flight.pos_e[0])[2]
    return np.asarray((height + MOUNTED) / np.maximum(flight.C_nb[k, 2, 2], 0.1))


def optical_flow(readings: Readings, draw: Draw) -> Source:
    """See the ground pass below, 20 times a second, with a gyro of its own; dark below 0.3 m."""
    flight, rng, t = readings.flight, draw.rng, every(readings.flight, 20.0)
    each = FINE // 20
    gyro = flight.dtheta_b[: len(t) * each].reshape(len(t), each, 3).sum(axis=1) * 20.0
    middle = t - 0.025
    k, far = flight.index(middle), _distance(flight, middle)
    vel_b = rotate(transpose(flight.C_nb[k]), flight.vel_n[k])
    scale = 1.0 + 0.05 * rng.standard_normal()
    seen = gyro[:, :2] + scale * np.stack([-vel_b[:, 1], vel_b[:, 0]], axis=1) / far[:, None]
    seen += 0.05 * rng.standard_normal(seen.shape)
    own = gyro[:, :2] + 0.01 * rng.standard_normal(seen.shape)
    values = {"flow_x_rps": seen[:, 0], "flow_y_rps": seen[:, 1]}
    values |= {"flow_gyro_x_rps": own[:, 0], "flow_gyro_y_rps": own[:, 1]}
    return add(readings, middle, 0.035, {**values, "flow_quality": np.where(far > 0.3, 0.9, 0.0)})


def airspeed(readings: Readings, draw: Draw, wind_n: Array) -> Source:
    """Measure the speed against the air of a wind and its gusts, by a tube of some scale."""
    flight, rng, t = readings.flight, draw.rng, every(readings.flight, 10.0)
    through_n = flight.vel_n[flight.index(t)] - wind_n
    gusts = gauss_markov(rng, (len(t), 1), 0.6, 0.6, 0.1)[:, 0]
    found = (1.0 + 0.05 * rng.standard_normal()) * (np.linalg.norm(through_n, axis=1) + gusts)
    readings.settings["vehicle"] = "fixed_wing"
    return add(readings, t, 0.01, {"airspeed_mps": found + 0.3 * rng.standard_normal(len(t))})


def wheels(readings: Readings, draw: Draw) -> Source:
    """Measure the speed along the body's forward axis by wheels of some scale."""
    flight, rng, t = readings.flight, draw.rng, every(readings.flight, 10.0)
    k = flight.index(t)
    speed = np.sum(flight.C_nb[k, :, 0] * flight.vel_n[k], axis=1)
    found = (1.0 + 0.05 * rng.standard_normal()) * speed + 0.05 * rng.standard_normal(len(t))
    readings.settings["vehicle"] = "ground"
    return add(readings, t, 0.01, {"wheel_speed_mps": found})


def visual_odometry(readings: Readings, draw: Draw) -> Source:
    """State poses in a frame of its own, which drifts by the way, 20 times a second."""
    flight, rng, t = readings.flight, draw.rng, every(readings.flight, 20.0)
    k = flight.index(t)
    pos_n = (flight.pos_e[k] - flight.pos_e[0]) @ flight.C_en[0]
    way = np.linalg.norm(flight.vel_n[k], axis=1, keepdims=True) * 0.05
    pos_n += np.cumsum(0.02 * np.sqrt(way) * rng.standard_normal(pos_n.shape), axis=0)
    yaw = draw.angle() + 1e-3 * np.sqrt(0.05) * np.cumsum(rng.standard_normal(len(t)))
    scale = 1.0 + 0.01 * rng.standard_normal()
    pos_f = scale * turned(yaw, pos_n) + rng.uniform(-5.0, 5.0, 3)
    pos_f += 0.02 * rng.standard_normal(pos_f.shape)
    heading = np.arctan2(flight.C_nb[k, 1, 0], flight.C_nb[k, 0, 0]) + yaw
    heading += 0.003 * rng.standard_normal(len(t))
    readings.settings["visual_odometry"] = {"use": True}
    return add(readings, t, 0.04, _pose(pos_f, heading))


def _pose(pos_f: Array, heading: Array) -> dict[str, Array]:
    names = ("odometry_x_m", "odometry_y_m", "odometry_z_m")
    wrapped = np.arctan2(np.sin(heading), np.cos(heading))
    return {**dict(zip(names, pos_f.T, strict=True)), "odometry_yaw_rad": wrapped}


def turned(angle: Array | float, v: Array) -> Array:
    """Turn vectors, shape (n, 3), about the vertical by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]], axis=1)


def visual_velocity(readings: Readings, draw: Draw) -> Source:
    """State the velocity in the body, 20 times a second, by a camera of some scale."""
    flight, rng, t = readings.flight, draw.rng, every(readings.flight, 20.0)
    k = flight.index(t)
    vel_b = rotate(transpose(flight.C_nb[k]), flight.vel_n[k])
    found = (1.0 + 0.03 * rng.standard_normal()) * vel_b + 0.1 * rng.standard_normal(vel_b.shape)
    names = ("odometry_vx_mps", "odometry_vy_mps", "odometry_vz_mps")
    readings.settings["visual_velocity"] = {"use": True}
    return add(readings, t, 0.04, dict(zip(names, found.T, strict=True)))
