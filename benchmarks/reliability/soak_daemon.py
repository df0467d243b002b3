"""Faults against the real daemon in a process of its own, over UDP, in real time."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.reliability.soak_flight import RATE, Errors, fly, plan, sizes
from benchmarks.reliability.soak_score import Episode, episodes, normal
from ekf_companion.nav.arrays import Array
from sim_autopilot.faults.fault import Fault, schedule
from sim_autopilot.firmware import PERSONALITIES
from sim_autopilot.fly import fly as fly_live
from sim_autopilot.fly import over

KINDS = ("imu-stuck", "clock-jump:by=-0.5", "cut:duration=3", "imu-gap", "corrupt")
GAP = 12.0
FIRST = 60.0
"""Seconds into the flight: the normal errors are those from the second minute on. Before, while the
accelerometer's bias is estimated, recovery from a cut takes 10.8 s, also without the daemon."""
QUIET = 300.0
"""Length of the flight without faults that the normal errors are taken from, s."""
CONFIG = (
    f"link: {{imu_rate: {RATE}}}\nhttp: {{port: 0}}\n"
    "output: {odometry: {jumps: tell, dead_reckoning_time: 3600, dead_reckoning_std: 1.0e4}}\n"
)
PATIENCE = 60.0
"""s; a daemon that has sent nothing by then never will."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Minute:
    """The score of the daemon's flight."""

    found: list[Episode]
    limits: Array
    memory: float
    """Largest resident memory of the daemon, MB."""
    has_exited: bool


def minute(personality: str = "px4", seed: int = 1, duration: float = 135.0) -> Minute:
    """Fly against a daemon, which must be alive at the end."""
    limits = normal(fly(personality, seed, QUIET).errors)
    faults = schedule(KINDS, seed, duration, GAP, first=FIRST)
    with TemporaryDirectory() as folder, _daemon(Path(folder)) as (process, port):
        errors = asyncio.run(_fly(personality, seed, duration, faults, port))
        status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
        has_exited = process.poll() is not None
    return Minute(
        found=episodes(errors, faults, limits, seed),
        limits=limits,
        memory=float(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6,
        has_exited=has_exited,
    )


async def _fly(
    personality: str, seed: int, duration: float, faults: list[Fault], port: int
) -> Errors:
    flight = plan(personality, seed, duration)
    flown = await over(
        f"udpout:127.0.0.1:{port}",
        lambda link: fly_live(
            flight, link, personality=PERSONALITIES[personality], faults=faults, wait=PATIENCE
        ),
    )
    found = flown.witness.estimate()
    size = sizes(flight, found.t, found.pos_n, found.vel_n, found.q_nb)
    return Errors(t=found.t, size=size, resets=np.zeros(len(found.t), dtype=np.int64))


@contextmanager
def _daemon(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    config = folder / "soak.yaml"
    config.write_text(CONFIG, encoding="ascii")
    command = [sys.executable, "-m", "ekf_companion", "run", "--config", str(config)]
    options = ["--link", f"udpin:127.0.0.1:{port}", "--checkpoint", str(folder / "checkpoint")]
    log = (folder / "log").open("wb")
    process = subprocess.Popen([*command, *options], stdout=log, stderr=log)
    try:
        yield process, port
    finally:
        process.terminate()
        process.wait(PATIENCE)
        log.close()
