"""Time and memory from a log to a file of estimates, beside what others take to open the log.

Each conversion is a process of its own, ours and the peers' in turn, several times; medians count.
The clock says how long one waits, on two idle cores; the processor's time, how much work it was,
which a busy machine changes less.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.speed import jobs, recordings
from benchmarks.speed.jobs import Cost
from benchmarks.speed.result import Result

MEMORY = 300.0
"""MB, whatever the length."""
AIMS = {".tlog": 5.0, ".bin": 4.0, ".csv": 4.0, ".mcap": 8.0, ".parquet": 8.0}
"""Largest time per row wanted, us; for a .ulg, 1.2 of what pyulog takes to open it, and 3 us."""
RATIOS = {".tlog": 5.0 / 26.7, ".csv": 4.0 / 1.0}
"""The same as shares of what the peer took on the machine for which they were set, us by us."""
PEERS = {
    ".tlog": (
        "mavutil, reading",
        "import sys; from pymavlink import mavutil\n"
        "log = mavutil.mavlink_connection(sys.argv[1])\n"
        "while log.recv_match() is not None: pass",
    ),
    ".bin": (
        "DFReader, reading",
        "import sys; from pymavlink import DFReader\n"
        "log = DFReader.DFReader_binary(sys.argv[1])\n"
        "while log.recv_msg() is not None: pass",
    ),
    ".ulg": ("pyulog, opening", "import sys; from pyulog import ULog; ULog(sys.argv[1])"),
    ".csv": ("pandas, reading", "import sys; import pandas; pandas.read_csv(sys.argv[1])"),
}
START = {
    "start: --help": (["--help"], 0.15),
    "start: a log of 2 s to CSV": (["convert", "{log}", "-o", "{out}"], 0.35),
}


def measure(
    durations: tuple[float, ...] = (600.0, 3600.0, 10_800.0), rounds: int = 3
) -> Iterator[Result]:
    """Convert a flight of each duration from each format; the longest of 1 h and less to others."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        peaks: list[dict[str, float]] = []
        for duration in durations:
            peaks.append({})
            for result in _of_duration(folder, duration, rounds if duration <= 3600.0 else 1):
                if " to ." in result.name and result.unit == "MB":
                    peaks[-1][result.name.split(" ", 2)[2]] = result.value
                yield result
        yield from _growth(durations, peaks)
        yield from _start(folder, rounds)


def _growth(durations: tuple[float, ...], peaks: list[dict[str, float]]) -> Iterator[Result]:
    """Return how much memory each further hour of a log takes, by the two longest."""
    for what in peaks[-1] if len(peaks) > 1 else ():
        hours = (durations[-1] - durations[-2]) / 3600.0
        value = (peaks[-1][what] - peaks[-2][what]) / hours
        yield Result(name=f"{what}, by each hour more", value=value, unit="MB")


def _of_duration(folder: Path, duration: float, rounds: int) -> Iterator[Result]:
    # Made elsewhere: a process begins with the peak memory of the one that starts it
    jobs.run([sys.executable, "-m", "benchmarks.speed.recordings", str(folder), str(duration)])
    rows = round(duration * recordings.RATE)
    logs = {suffix: folder / f"flight{suffix}" for suffix in PEERS}
    what = f"{duration / 60.0:g} min"
    work = {
        f"{what} {suffix} to .csv": _convert(log, folder / f"out{suffix}.csv")
        for suffix, log in logs.items()
    }
    work |= {
        f"{what} .ulg to {suffix}": _convert(logs[".ulg"], folder / f"out{suffix}")
        for suffix in (".mcap", ".parquet")
    }
    work[f"{what} .ulg to .csv, smoothed"] = [
        *_convert(logs[".ulg"], folder / "smooth.csv"),
        "--smooth",
    ]
    if duration <= 3600.0:
        work |= {
            f"{what} {suffix}: {peer}": jobs.python(code, str(logs[suffix]))
            for suffix, (peer, code) in PEERS.items()
        }
    outs = [Path(words[words.index("-o") + 1]) for words in work.values() if "-o" in words]
    costs = jobs.interleaved(work, rounds, outs)
    peer = costs.get(f"{what} .ulg: {PEERS['.ulg'][0]}")
    for name, cost in costs.items():
        yield from _results(name, cost, rows, peer)
    for suffix, aim in RATIOS.items():
        name, _ = PEERS[suffix]
        if (its := costs.get(f"{what} {suffix}: {name}")) is not None:
            ratio = costs[f"{what} {suffix} to .csv"].seconds / its.seconds
            words = f"{what} {suffix} to .csv over {name}, by the clock"
            yield Result(name=words, value=ratio, unit="", aim=aim)
    for path in folder.iterdir():
        path.unlink()


def _convert(log: Path, out: Path) -> list[str]:
    return [sys.executable, "-m", "ekf_companion", "convert", str(log), "-o", str(out)]


def _results(name: str, cost: Cost, rows: int, pyulog: Cost | None) -> Iterator[Result]:
    """Return time and memory; only our own have an aim."""
    is_ours = " to ." in name
    has_aim = is_ours and not name.endswith("smoothed")
    yield Result(name=f"{name}, by the clock", value=cost.seconds, unit="s")
    for how, field in (("by the clock", "seconds"), ("processor time", "cpu")):
        one, its = getattr(cost, field), getattr(pyulog, field, None)
        aim = _aim(name, None if its is None else its / rows * 1e6) if has_aim else None
        yield Result(name=f"{name}, {how}, per row", value=one / rows * 1e6, unit="us", aim=aim)
    memory = MEMORY if is_ours else None
    yield Result(name=f"{name}, peak memory", value=cost.peak, unit="MB", aim=memory)


def _aim(name: str, pyulog: float | None) -> float | None:
    """Return the largest time per row that is wanted, us, where pyulog takes so much to open it."""
    source, target = name.split()[2], name.split()[-1]
    aim = AIMS.get(target if target != ".csv" else source)
    return 1.2 * pyulog + 3.0 if aim is None and pyulog is not None else aim


def _start(folder: Path, rounds: int) -> Iterator[Result]:
    log, out = folder / "short.tlog", folder / "short.csv"
    recordings.write_tlog(log, recordings.plan(2.0))
    program = [sys.executable, "-m", "ekf_companion"]
    work = {
        name: [*program, *(one.format(log=log, out=out) for one in arguments)]
        for name, (arguments, _) in START.items()
    }
    work["start: mavutil's import"] = jobs.python("from pymavlink import mavutil")
    for name, cost in jobs.interleaved(work, 2 * rounds).items():
        aim = START[name][1] if name in START else None
        yield Result(name=f"{name}, processor time", value=cost.cpu, unit="s", aim=aim)
