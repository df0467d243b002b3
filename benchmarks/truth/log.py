"""Readings and truth as CSV files, in the form that the converter reads without a map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.truth import earth
from benchmarks.truth.earth import Array
from benchmarks.truth.judge import Truth
from benchmarks.truth.sensors import DEG, Readings, antenna

START_US = 1_000_000
"""The log's clock at its first moment."""
INERTIAL = "gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2"
GNSS = (
    "gps_lat_deg,gps_lon_deg,gps_alt_m,gps_vn_mps,gps_ve_mps,gps_vd_mps,"
    "gps_std_h_m,gps_std_v_m,gps_std_vel_mps"
)
MAG = "mag_x_gauss,mag_y_gauss,mag_z_gauss"
BARO = "baro_alt_m"
COLUMNS = ("time_us", INERTIAL, GNSS, MAG, BARO)
ROWS = (
    "%d,%.6f,%.6f,%.6f,%.5f,%.5f,%.5f" + "," * 13,
    "%d" + "," * 7 + "%.9f,%.9f,%.3f,%.4f,%.4f,%.4f,%.3f,%.3f,%.3f" + "," * 4,
    "%d" + "," * 16 + "%.5f,%.5f,%.5f,",
    "%d" + "," * 19 + "%.3f",
)


def to_us(t: Array) -> Array:
    """Return stamps of the log's clock."""
    return np.asarray(START_US + np.rint(t * 1e6))


def write_log(path: Path, readings: Readings) -> None:
    """Write one row an event, in the order in which they became known."""
    inertial, fixes = readings.inertial, readings.fixes
    pos_e, vel_n = antenna(readings.flight, fixes)
    lat, lon, alt = earth.to_geodetic(pos_e)
    declared = np.stack([fixes.std_h, fixes.std_v, fixes.std_vel], axis=1)
    place = np.stack([lat / DEG, lon / DEG, alt], axis=1)
    kept = ~fixes.is_lost
    tables = [
        (inertial.t, inertial.stamp, np.hstack([inertial.gyro, inertial.accel])),
        (fixes.t[kept], fixes.t[kept], np.hstack([place, vel_n, declared])[fixes.said][kept]),
        (readings.mag_t, readings.mag_t, readings.mag),
        (readings.baro_t, readings.baro_t, readings.baro[:, None]),
    ]
    names, forms = ",".join(COLUMNS).split(","), list(ROWS)
    for source in readings.sources:
        tables.append((source.t, source.stamp, source.values))
        forms.append("%d" + "," * (len(names) - 1) + ",%.6f" * len(source.columns))
        names += source.columns
    lines: list[str] = []
    moment, step = readings.set_back
    for form, (_, stamp, values) in zip(forms, tables, strict=True):
        rows = np.hstack([to_us(stamp - step * (stamp > moment))[:, None], values])
        line = form + "," * (len(names) - 1 - form.count(",")) + "\n"
        lines += [line % tuple(row) for row in rows.tolist()]
    order = np.argsort(np.concatenate([table[0] for table in tables]).round(6), kind="stable")
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        file.writelines(lines[i] for i in order)


def truth_of(readings: Readings) -> Truth:
    """Return the truth at 25 Hz, at whole inertial intervals, but for stamps that come twice."""
    flight = readings.flight
    moment, step = readings.set_back
    t = np.arange(1, int(flight.t[-1] * 25) + 1) / 25.0
    t = t[(t <= moment - step) | (t > moment + step)]
    k = flight.index(t)
    lat, lon, alt = earth.to_geodetic(flight.pos_e[k])
    return Truth(to_us(t - step * (t > moment)), lat, lon, alt, flight.vel_n[k], flight.C_nb[k])


def write_truth(path: Path, truth: Truth) -> None:
    """Keep a truth beside its log."""
    np.savez(path, **{name: getattr(truth, name) for name in Truth.__dataclass_fields__})


def read_truth(path: Path) -> Truth:
    """Read what `write_truth` has kept."""
    with np.load(path) as arrays:
        return Truth(**{name: arrays[name] for name in arrays.files})
