"""Short whole files of every kind that a command or the daemon reads, to be damaged."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import yaml

from benchmarks.document import DATA
from benchmarks.reliability.fuzz import FuzzedCompanion, undisturbed
from ekf_companion.config.config import Config, describe_config
from ekf_companion.engine.checkpoint_parts import Clocks
from ekf_companion.fleet import run
from ekf_companion.fleet.executor import Item, Lost, Result
from ekf_companion.fleet.source import of_path
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench
from sim_autopilot.recording import TlogWriter

WHOLE = 150_000
"""Bytes of a log."""
FLIGHT_S = 6.0
"""Of the simulated flights, s."""
RECORDED = {
    ".bin": ("ardupilot-bin-copter-netherlands/*.bin", WHOLE),
    ".ulg": ("px4-ulg-x500-hover/*.ulg", 1 << 19),
    ".txt": ("zupt-openshoe/M*.txt", WHOLE),
    ".mat": ("broad-attitude/15*.mat", 1 << 23),
}
"""Recorded flights, where these are, and how much of each: nothing here writes their formats."""
CSV_NAMES = (
    "time_us,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2,"
    "gps_lat_deg,gps_lon_deg,gps_alt_m,gps_vn_mps,gps_ve_mps,baro_alt_m"
)
CSV_MAP = """\
time: {column: time_us, unit: us}
gyro_x: {column: gyro_x_rps, unit: rad/s}
gyro_y: {column: gyro_y_rps, unit: rad/s}
gyro_z: {column: gyro_z_rps, unit: rad/s, sign: 1}
accel_x: {column: accel_x_mps2, unit: m/s2}
accel_y: {column: accel_y_mps2, unit: m/s2}
accel_z: {column: accel_z_mps2, unit: m/s2}
baro_alt: {column: baro_alt_m, unit: m}
hold: [gps]
"""


def whole_files() -> dict[str, bytes]:
    """Return a whole file of each kind, by suffix or name, as far as there is one."""
    table = rest_csv(1500)
    found = {
        ".tlog": _tlog(),
        ".csv": table,
        ".log": b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n" * 999,
        **state_files(table),
    }
    for suffix, (pattern, size) in RECORDED.items():
        for path in DATA.glob(pattern):
            with path.open("rb") as file:
                found[suffix] = file.read(size)
    return found


def state_files(table: bytes) -> dict[str, bytes]:
    """Return what lies beside logs, and what the daemon and ``batch`` keep; the table is a log."""
    return {
        "columns.yaml": CSV_MAP.encode(),
        "config.yaml": yaml.safe_dump(describe_config(Config())).encode(),
        "checkpoint": _checkpoint(),
        "parameters": b'{"imu.gyro_noise": 0.001, "output.odometry.rate": 50.0}\n',
        "journal": _journal(table),
    }


def rest_csv(count: int) -> bytes:
    """Return a table of a vehicle at rest, at 100 Hz, with a fix and a height in each row."""
    noise = np.random.default_rng(1).normal(size=(count, 12)) * (
        *(1e-3,) * 3,
        *(0.02,) * 3,
        *(2e-6,) * 2,
        *(0.3, 0.05, 0.05, 0.2),
    )
    rows = noise + np.array([0, 0, 0, 0, 0, -9.81, 47.4, 8.5, 488, 0, 0, 488])
    lines = [
        f"{10_000 * (n + 1)}," + ",".join(f"{value:.9g}" for value in row)
        for n, row in enumerate(rows.tolist())
    ]
    return "\n".join([CSV_NAMES, *lines, ""]).encode()


def _tlog() -> bytes:
    """Return the beginning of a simulated flight as a telemetry log."""
    flight = Flight.plan("figure-eight", SimConfig(), seed=1, duration=FLIGHT_S)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        with TlogWriter(path, flight.config.home.unix) as writer:
            for t_ns, frame in Bench(flight).frames():
                writer.write(t_ns, frame)
        return path.read_bytes()[:WHOLE]


def _checkpoint() -> bytes:
    fuzzed = FuzzedCompanion()
    for data in undisturbed(1, duration=FLIGHT_S):
        fuzzed.feed(data)
    found = fuzzed.companion.checkpoint(Clocks(fuzzed.now_ns))
    assert found is not None
    return found


class InPlace:
    """An executor of ``batch`` that starts no process."""

    def run(
        self, task: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[tuple[Item, Result | Lost]]:
        """Yield each item and its result."""
        for item in items:
            yield item, task(item)


def _journal(table: bytes) -> bytes:
    """Return the journal of a batch of three logs; LOG stands for their folder."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        logs = [place / name for name in ("one.csv", "two.csv", "three.csv")]
        logs[0].write_bytes(table)
        for log in logs:
            log.touch()
        run.run([of_path(log) for log in logs], Config(), place / "journal", InPlace())
        return (place / "journal").read_bytes().replace(folder.encode(), b"LOG")
