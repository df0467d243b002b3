"""A recorded fixed wing and a recorded truck: without fixes for a minute, and wind and scale."""

import gzip
import struct

import numpy as np
import pytest

from ekf_companion.config.config import Config, load_config
from ekf_companion.core.memory.enums import Aid
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.review.convert import estimate
from tests.paths import DATA

PLANE, TRUCK = DATA / "sitl-ap-plane-airspeed", DATA / "wheel-stereo-truck"
HIGHRES_IMU, FIXES = 105, (24, 124)
WIND = (1.71, 4.70)
"""Of the simulator, 5 m/s from 250 deg, where the air moves to, m/s."""


def without_fixes(path, out, begin, end):
    """Copy a .tlog without the fixes from a time to another, s since boot."""
    raw, kept, i, t = path.read_bytes(), bytearray(), 0, 0.0
    while i < len(raw):
        size, is_signed = raw[i + 9], raw[i + 10] & 1
        behind = i + 20 + size + 13 * is_signed
        number = int.from_bytes(raw[i + 15 : i + 18], "little")
        if number == HIGHRES_IMU and raw[i + 14] == 1:
            (t_us,) = struct.unpack("<Q", raw[i + 18 : i + 26])
            t = t_us * 1e-6
        if not (number in FIXES and begin <= t < end):
            kept += raw[i:behind]
        i = behind
    out.write_bytes(kept)
    return out


@pytest.mark.skipif(not PLANE.exists(), reason="needs ../shared/data")
def test_an_ardupilot_plane_without_fixes_drifts_by_less_than_a_third(tmp_path):
    off = tmp_path / "off.yaml"
    off.write_text("airspeed: {use: false}\n")
    truth = np.genfromtxt(PLANE / "truth.csv", delimiter=",", names=True)
    log = without_fixes(PLANE / "flight.tlog", tmp_path / "cut.tlog", 70.0, 130.0)
    worst = []
    for config in (Config(), load_config(off)):
        table, report = estimate(log, config)
        t = table.stamp_ns * 1e-9
        gone = (t > 70.0) & (t < 130.0)
        lat, lon = (
            np.interp(t[gone], truth["time_us"] * 1e-6, truth[name])
            for name in ("lat_deg", "lon_deg")
        )
        north = table.column("lat_deg")[gone] - lat
        east = (table.column("lon_deg")[gone] - lon) * np.cos(np.radians(lat))
        worst.append(np.radians(np.hypot(north, east)).max() * 6.37e6)
        if config == Config():
            for axis, wind in zip("ne", WIND, strict=True):
                off_by = table.column(f"wind_{axis}")[t > 66.0] - wind
                assert np.abs(off_by).max() < 1.0
            assert report.wind.speed == pytest.approx(5.0, abs=1.0)
            assert report.wind.words.endswith(" deg")
    assert worst[0] < worst[1] / 3.0


def table_of(name):
    with gzip.open(TRUCK / f"{name}.csv.gz", "rt") as file:
        return np.genfromtxt(file, delimiter=",", names=True)


def truck_log(path, begin=np.inf, end=np.inf, wheels=True):
    """Write the truck's samples and wheels, and fixes made of its stereo odometry."""
    imu, wheel, stereo = map(table_of, ("imu", "wheel_odometry", "stereo_odometry"))
    zero, rng = imu["t_s"][0] - 1.0, np.random.default_rng(1)
    axes = [f"{a}_{b}_{u}" for a, u in (("gyro", "rps"), ("accel", "mps2")) for b in "xyz"]
    names = [*axes, "gps_lat_deg", "gps_lon_deg", "gps_alt_m", "gps_vn_mps", "gps_ve_mps"]
    names += ["gps_vd_mps", "gps_std_h_m", "gps_std_v_m", "gps_std_vel_mps", "heading_deg"]
    names += ["wheel_speed_mps"]
    rows = {}

    def add(times, first, columns):
        at = names.index(first)
        for t, values in zip(times, np.column_stack(columns), strict=True):
            row = rows.setdefault(round((t - zero) * 1e6), [""] * len(names))
            row[at : at + len(values)] = [repr(float(one)) for one in values]

    signs = {"x": 1.0, "y": -1.0, "z": -1.0}  # forward, left, up
    add(
        imu["t_s"],
        axes[0],
        [
            signs[b] * imu[f"{a}_{b}_{u}"]
            for a, u in (("gyro", "rps"), ("acc", "mps2"))
            for b in "xyz"
        ],
    )
    t = stereo["t_s"]
    pos = np.column_stack([stereo[f"{axis}_m"] for axis in "xyz"])
    pos = pos - pos[0]
    lat, lon, alt = LocalFrame(0.85, 0.14, 100.0).to_geodetic(pos)
    smooth = np.ones(5) / 5.0
    vel = [np.convolve(np.gradient(pos[:, i], t), smooth, "same") for i in range(2)]
    noise = rng.normal(0.0, 1.0, (len(t), 6))
    yaw = np.degrees(2.0 * np.arctan2(stereo["q_z"], stereo["q_w"])) + noise[:, 5]
    columns = [np.degrees(lat) + 0.3 * noise[:, 0] / 111e3, np.degrees(lon), alt]
    columns += [vel[0] + 0.1 * noise[:, 1], vel[1] + 0.1 * noise[:, 2], 0.1 * noise[:, 3]]
    columns += [np.full(len(t), one) for one in (0.5, 1.0, 0.2)] + [yaw % 360.0]
    kept = np.zeros(len(t), dtype=bool)
    kept[::2] = True
    kept &= ~((t - zero > begin) & (t - zero < end))
    add(t[kept], "gps_lat_deg", [one[kept] for one in columns])
    if wheels:
        span = np.diff(wheel["t_s"])
        way = np.hypot(np.diff(wheel["x_m"]), np.diff(wheel["y_m"]))
        add(wheel["t_s"][1:] - 0.5 * span + 1e-5, "wheel_speed_mps", [way / span])
    lines = [",".join(["time_us", *names])]
    lines += [",".join([str(t_us), *rows[t_us]]) for t_us in sorted(rows)]
    path.write_text("\n".join(lines) + "\n")
    return t - zero, lat, lon


@pytest.mark.skipif(not TRUCK.exists(), reason="needs ../shared/data")
def test_a_truck_without_fixes_drifts_by_a_tenth_of_what_it_does_without_wheels(tmp_path):
    worst = []
    for wheels in (True, False):
        path = tmp_path / f"truck-{wheels}.csv"
        t, lat, lon = truck_log(path, 45.0, 105.0, wheels)
        table, report = estimate(path, Config())
        now = table.stamp_ns * 1e-9
        gone = (now > 45.0) & (now < 105.0)
        north = np.radians(table.column("lat_deg"))[gone] - np.interp(now[gone], t, lat)
        east = np.radians(table.column("lon_deg"))[gone] - np.interp(now[gone], t, lon)
        worst.append(6.37e6 * np.hypot(north, east * np.cos(lat[0])).max())
        if wheels:
            assert report.health.fused(Aid.WHEEL) > 1000
    assert worst[0] < 10.0  # 205 m of way
    assert worst[0] < worst[1] / 10.0
