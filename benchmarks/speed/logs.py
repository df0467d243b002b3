"""How fast a telemetry log becomes a table of estimates."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.speed.result import Result
from ekf_companion.config.config import Config
from ekf_companion.replay.convert import convert
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.recording import TlogWriter


def measure(duration: float = 600.0) -> Iterator[Result]:
    """Time the conversion of a generated .tlog with inertial samples at 250 Hz."""
    with TemporaryDirectory() as folder:
        log, out = Path(folder) / "flight.tlog", Path(folder) / "estimate.csv"
        _write(log, duration)
        began = time.perf_counter()
        report = convert(log, out, Config())
        spent = time.perf_counter() - began
        yield Result(name=f".tlog of {duration:g} s to CSV", value=spent, unit="s")
        yield Result(name="speed over real time", value=duration / spent, unit="times")
        per_row = spent / report.estimates * 1e6
        yield Result(name="the whole conversion, per row", value=per_row, unit="us")
        yield Result(name="size of the .tlog", value=log.stat().st_size / 1e6, unit="MB")
        yield Result(name="size of the CSV", value=out.stat().st_size / 1e6, unit="MB")


def _write(path: Path, duration: float) -> None:
    flight = Flight.plan("figure-eight", SimConfig(), duration=duration)
    autopilot = Autopilot(flight.config)
    with TlogWriter(path, flight.config.home.unix) as writer:
        for cycle in flight.cycles():
            autopilot.cycle(cycle)
            for frame in autopilot.data_to_send():
                writer.write(cycle.t_ns, frame)
