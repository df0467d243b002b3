"""Memory of the odometry: ten minutes at rest, and a kilometre of a street.

Each in a process of its own, which reads the scans of a simulated recording one by one.
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.document import table
from ekf_companion.lidar.odometry import Odometry
from ekf_companion.lidar.recording import InertialSamples, Mounting, Scan
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.track import Track
from sim_autopilot.lidar.motion import Motion
from sim_autopilot.lidar.record import TICK, UNIT, Simulated, simulate
from sim_autopilot.lidar.worlds import Array, World

HEAD = "recording | scans | beginning, MB | growth, MB | with the estimates kept, MB"
REST, SPEED, WAY = 600.0, 10.0, 1000.0
"""s, m/s, m."""
BEGINNING = 30.0
"""After which memory is to grow no more at rest, s."""


def at_rest(t: Array) -> tuple[Array, Array]:
    """Return poses at rest in the middle of a room."""
    return np.tile([0.5, 0.3, 1.4], (len(t), 1)), np.zeros((len(t), 3))


def along(t: Array) -> tuple[Array, Array]:
    """Return poses of a drive along x."""
    way = SPEED * t
    yaw = 0.05 * np.sin(way / 20.0)
    position = np.stack((way, 1.0 - np.cos(way / 20.0), np.full(len(t), 0.8)), -1)
    return position, np.stack((np.zeros(len(t)), np.zeros(len(t)), yaw), -1)


def avenue(rng: np.random.Generator) -> World:
    """Return houses on both sides of a kilometre."""
    x = np.arange(-30.0, WAY + 60.0, 13.0)
    boxes = []
    for side in (-1.0, 1.0):
        depth, half = rng.uniform(9.0, 12.0, len(x)), rng.uniform(4.5, 6.3, len(x))
        far = side * (depth + 8.0)
        low, high = np.minimum(side * depth, far), np.maximum(side * depth, far)
        height = rng.uniform(6.0, 18.0, len(x))
        boxes.append(np.stack((x - half, low, np.zeros(len(x)), x + half, high, height), -1))
    return World(np.concatenate(boxes))


def recordings() -> Iterator[Simulated]:
    """Yield what is measured."""
    yield simulate("room", 81, duration=REST, name="10 min at rest", motion=Motion(at_rest))
    drive, scene = Motion(along), avenue(np.random.default_rng(82))
    yield simulate(
        "street", 82, duration=WAY / SPEED, name="1 km of a street", scene=scene, motion=drive
    )


def resident() -> float:
    """Return the memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 1e6


def parts(simulated: Simulated) -> Iterator[Any]:
    """Yield samples and mounting, then the scans, and None at the end."""
    lidar = simulated.lidar
    accel, gyro = simulated.accel.astype(float), simulated.gyro.astype(float)
    inertial = InertialSamples(simulated.imu_stamp, gyro, accel)
    yield inertial, Mounting(lidar.rotation, lidar.position)
    for stamp, a, b in zip(simulated.stamp, simulated.first, simulated.first[1:], strict=False):
        yield Scan(float(stamp), simulated.xyz[a:b] * UNIT, simulated.dt[a:b] * TICK)
    yield None


def measure(path: Path, *, is_kept: bool) -> tuple[int, float, float]:
    """Return number of scans, memory after the beginning and its growth to the end, MB."""
    track, count, before = Track(), 0, 0.0
    with path.open("rb") as file:
        inertial, mounting = pickle.load(file)
        odometry = Odometry(inertial, mounting, Settings())
        while (scan := pickle.load(file)) is not None:
            made = odometry.process(scan)
            count += 1
            for one in made if is_kept else ():
                track.add(one)
            if scan.stamp < BEGINNING:
                before = resident()
    return count, before, resident() - before


def row(simulated: Simulated) -> str:
    """Return the row of a recording."""
    context = get_context("spawn")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scans"
        with path.open("wb") as file:
            for one in parts(simulated):
                pickle.dump(one, file)
        found = []
        for is_kept in (False, True):
            with context.Pool(1) as pool:
                found.append(pool.apply(measure, (path,), {"is_kept": is_kept}))
    (count, before, grown), (_, _, kept) = found
    return f"{simulated.name} | {count} | {before:.0f} | {grown:.1f} | {kept:.1f}"


def main() -> None:
    """Print the table."""
    for line in table(HEAD, map(row, recordings())):
        print(line, flush=True)


if __name__ == "__main__":
    main()
