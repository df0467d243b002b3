"""What the page costs the daemon: not served, served and not watched, watched by one browser."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.speed import daemon
from benchmarks.speed.result import Result

VIEWER = (
    "from websockets.sync.client import connect\n"
    "while True:\n"
    "    try:\n"
    "        with connect('ws://127.0.0.1:{port}/live', proxy=None, compression=None) as socket:\n"
    "            count = 0\n"
    "            for message in socket:\n"
    "                count += 1\n"
    "                if count == 20: print('watching', flush=True)\n"
    "    except OSError: pass\n"
)
"""A viewer in a process of its own, which tries until the daemon serves."""
SERVED = "http: {{host: 127.0.0.1, port: {port}}}\nlink: {{imu_rate: {rate:g}}}\n"
VIEWER_START = 2.0
"""s that a viewer needs to connect and watch; waited without one too, so that all begin alike."""


def measure(duration: float = 20.0) -> Iterator[Result]:
    """Measure the daemon's load with ODOMETRY at 30 Hz, and by how much the page raises it."""
    alone = _load(duration, is_served=False, is_watched=False)
    unwatched = _load(duration, is_served=True, is_watched=False)
    watched = _load(duration, is_served=True, is_watched=True)
    yield Result(name="daemon's share without the page", value=100.0 * alone, unit="%")
    yield Result(name="unwatched page over none", value=unwatched / alone, unit="")
    yield Result(name="watched page over none", value=watched / alone, unit="")
    more = 100.0 * (watched - unwatched)
    yield Result(name="more of a processor while it is watched", value=more, unit="%", aim=2.0)


def _load(duration: float, *, is_served: bool, is_watched: bool) -> float:
    """Return the daemon's share of a processor in a flight."""
    with TemporaryDirectory() as folder:
        config = Path(folder) / "bench.yaml"
        port = daemon.configure(config, daemon.RATE)
        if not is_served:
            config.write_text(SERVED.format(port=0, rate=daemon.RATE), encoding="ascii")
        flight = daemon.plan(daemon.RATE, duration)
        with daemon.open_socket() as ours, daemon.running(config, ours) as process:
            ours.connect(daemon.first_datagram(ours, process))
            with _watching(port, is_watched=is_watched):
                return daemon.fly(flight, ours, process.pid)[2]


@contextmanager
def _watching(port: int, *, is_watched: bool) -> Iterator[None]:
    """Watch while the body runs, from before the flight on."""
    if not is_watched:
        time.sleep(VIEWER_START)
        yield
        return
    command = [sys.executable, "-c", VIEWER.format(port=port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None, "it was asked for"
        process.stdout.readline()
        yield
    finally:
        process.kill()
        process.communicate()
