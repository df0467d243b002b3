"""A fleet by each engine: the same bytes, what the engine costs, and what the coordinator holds.

``python -m benchmarks.fleet`` makes 500 logs of the recorded flights, whole and damaged, and fills
a data set by processes, by Dask, by Dask with a worker killed every 20 s, and by a run that is
interrupted and resumed. ``--small 10000 --listed 100000`` runs so many logs of a second and plans
the rest. ``--cost`` prints what a minute of the recorded flights costs, by format.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from distributed import Client, LocalCluster

from benchmarks.document import DATA, table
from ekf_companion.analysis.flight_review import review
from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import CompanionError
from ekf_companion.fleet import campaign
from ekf_companion.fleet.dask_executor import Dask, local_cluster
from ekf_companion.fleet.executor import Executor, Processes
from ekf_companion.fleet.folder import find_logs
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.observations import events, histograms
from ekf_companion.nav.arrays import Array
from ekf_companion.replay.read import read

LARGEST_COPY = 400_000
"""Bytes of a damaged copy."""
KILL_EVERY_S = 20.0
WORKERS = 2
ROUNDS = 3
"""Times that processes and Dask are run in turn: the least of each is what it costs."""


def link_recorded(folder: Path) -> list[Path]:
    """Link the recorded flights into a folder, each under a name of its own; return them."""
    logs = find_logs([str(DATA.resolve())])
    for number, log in enumerate(logs):
        (folder / f"{number:04}-{log.parent.name}-{log.name}").symlink_to(log)
    return logs


def make_logs(folder: Path, count: int) -> None:
    """Link the recorded flights into a folder, and add damaged copies of them up to a number."""
    logs = link_recorded(folder)
    rng = np.random.default_rng(1)
    for number in range(len(logs), count):
        log = logs[number % len(logs)]
        data = bytearray(log.read_bytes()[: int(rng.integers(LARGEST_COPY // 4, LARGEST_COPY))])
        if log.suffix != ".gz":  # of what is packed nothing behind the first can be read
            for place in rng.integers(1000, len(data), 20).tolist():
                data[place] ^= 0xFF
        (folder / f"{number:04}-{log.parent.name}-{log.name}").write_bytes(data)


def make_small(folder: Path, count: int) -> None:
    """Make so many logs of one second of flight, of which no two are the same bytes."""
    head = "time_us,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2"
    rng = np.random.default_rng(1)
    for number in range(count):
        noise = rng.normal(0.0, [[0.002] * 3 + [0.03] * 3], (130, 6))
        noise[:, 5] -= 9.81
        rows = [f"{10_000 * i}," + ",".join(f"{x:.5f}" for x in row) for i, row in enumerate(noise)]
        text = "\n".join([head, *rows, ""])
        (folder / f"{number // 1000:03}").mkdir(exist_ok=True)
        (folder / f"{number // 1000:03}" / f"{number:06}.csv").write_text(text)


def fill(logs: Path | str, place: Path, executor: Executor) -> float:
    """Fill a data set; return the time that it took, s."""
    begin = time.perf_counter()
    account = campaign.run(Listing([str(logs)]), Config(), str(place), executor)
    print(f"  {place.name}: {'; '.join(account.lines())}", flush=True)
    return time.perf_counter() - begin


def bytes_of(place: Path) -> dict[str, bytes]:
    """Return the files of a data set by name."""
    return {str(p.relative_to(place)): p.read_bytes() for p in sorted(place.rglob("*.parquet"))}


@contextmanager
def killing(cluster: LocalCluster) -> Iterator[list[int]]:
    """Kill a worker of a cluster every ``KILL_EVERY_S``."""
    end, killed = threading.Event(), []

    def kill() -> None:
        with Client(cluster) as client:
            while not end.wait(KILL_EVERY_S):
                pids = client.run(os.getpid)
                if pids:
                    pid = sorted(pids.values())[0]
                    killed.append(pid)
                    os.kill(pid, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        end.set()
        thread.join()


def engines(count: int) -> None:
    """Fill a data set of the same logs by each engine; compare bytes and times."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        (root / "logs").mkdir()
        make_logs(root / "logs", count)
        seconds: dict[str, float] = {}
        for number in range(ROUNDS):
            place = root / f"processes{number or ''}"
            spent = fill(root / "logs", place, Processes(WORKERS))
            seconds["processes"] = min(spent, seconds.get("processes", spent))
            with local_cluster(WORKERS) as cluster:
                dask = Dask(cluster.scheduler_address, WORKERS)
                spent = fill(root / "logs", root / f"dask{number or ''}", dask)
                seconds["dask"] = min(spent, seconds.get("dask", spent))
        with local_cluster(WORKERS) as cluster:
            dask = Dask(cluster.scheduler_address, WORKERS)
            with killing(cluster) as killed:
                seconds["killed"] = fill(root / "logs", root / "killed", dask)
        command = [sys.executable, "-m", "ekf_companion", "batch", str(root / "logs")]
        command += ["-o", f"{root}/resumed/", "--jobs", str(WORKERS)]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
            time.sleep(0.4 * seconds["processes"])
            process.send_signal(signal.SIGKILL)
        seconds["rest"] = fill(root / "logs", root / "resumed", Processes(WORKERS))
        whole = bytes_of(root / "processes")
        for other in ("dask", "killed", "resumed"):
            same = bytes_of(root / other) == whole
            print(f"{other}: {'the same bytes' if same else 'DIFFERENT'} as by processes")
        print(f"{len(killed)} workers killed")
        print(", ".join(f"{name} {spent:.1f} s" for name, spent in seconds.items()))
        print(f"dask over processes: {seconds['dask'] / seconds['processes'] - 1.0:+.1%}")


def coordinator(small: int, listed: int) -> None:
    """Run so many logs of a second, and list more; print the largest memory of this process."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        (root / "logs").mkdir()
        make_small(root / "logs", small)
        spent = fill(root / "logs", root / "results", Processes(WORKERS))
        print(
            f"{small} logs of a second: {spent:.0f} s, "
            f"{1e3 * spent * WORKERS / small:.1f} ms of a core each"
        )
        print(f"coordinator: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
        for number in range(small, listed):
            folder = root / "logs" / f"{number // 1000:03}"
            folder.mkdir(exist_ok=True)
            (folder / f"{number:06}.csv").symlink_to(root / "logs" / "000" / "000000.csv")
        begin = time.perf_counter()
        total = Listing([str(root / "logs")]).total()
        print(f"{total.logs} logs listed in {time.perf_counter() - begin:.1f} s")
        print(f"coordinator: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
        shutil.rmtree(root / "results")


def cost() -> None:
    """Print the time of a core that a minute of flight takes, by format."""
    spent: dict[str, Array] = {}
    for log in find_logs([str(DATA.resolve())]):
        begin = time.process_time()
        try:
            recording = read(log, Config())
            pipeline = Pipeline(Config(), recording.family, recording.gnss_delay)
            stamp_ns = pipeline.run(recording.events).stamp_ns
            estimated = time.process_time()
            flight = review(log, Config())
        except CompanionError:
            continue
        list(events(flight)), list(histograms(flight))
        minutes = float(np.ptp(stamp_ns)) / 6e10
        row = np.array([1.0, minutes, estimated - begin, time.process_time() - estimated])
        spent[log.suffix] = spent.get(log.suffix, np.zeros(4)) + row
    rows = [
        f"{suffix} | {logs:.0f} | {minutes:.1f} | {alone / minutes:.2f} | {whole / minutes:.2f}"
        for suffix, (logs, minutes, alone, whole) in sorted(spent.items())
        if minutes
    ]
    head = "format | logs | minutes | estimated, s a minute | with events and histograms"
    print(*table(head, rows), sep="\n")


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=500)
    parser.add_argument("--small", type=int, default=0)
    parser.add_argument("--listed", type=int, default=100_000)
    parser.add_argument("--cost", action="store_true")
    asked = parser.parse_args()
    if asked.cost:
        cost()
    elif asked.small:
        coordinator(asked.small, asked.listed)
    else:
        engines(asked.logs)


if __name__ == "__main__":
    main()
