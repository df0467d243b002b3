"""One flight of a case: generated, converted with the default settings, judged."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.engine import in_order
from benchmarks.truth import log
from benchmarks.truth.cases import generate
from benchmarks.truth.judge import Verdict, judge, read_estimate
from ekf_companion.config.config import load_config
from ekf_companion.errors import CompanionError
from ekf_companion.review import convert

SUFFIXES = (".csv", ".npz", ".yaml")
"""Of a flight's log, its truth, and the settings of its sources (JSON, which is YAML too)."""


@dataclass(frozen=True, slots=True)
class Job:
    """One flight, and where its files are."""

    case: str
    seed: int
    logs: Path | None = None
    """Folder that keeps the logs; one that is there is not generated again."""
    keep: Path | None = None
    """Folder that keeps the estimates."""
    ekf: Path | None = None
    """Another build's `ekf-companion`; None: this one, in this process."""

    @property
    def name(self) -> str:
        """Return the name of the flight's files."""
        return f"{self.case}-{self.seed:02d}"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a flight."""

    job: Job
    verdict: Verdict | None
    failure: str = ""
    """Why there is no verdict."""

    @property
    def is_honest(self) -> bool:
        """Return whether there is an estimate, and none of its "ok" was a lie."""
        return self.verdict is not None and self.verdict.lie == 0.0


def run(job: Job) -> Outcome:
    """Generate, convert and judge one flight."""
    with tempfile.TemporaryDirectory() as folder:
        paths = path, truth_path, settings = [
            (job.logs or Path(folder)) / f"{job.name}{suffix}" for suffix in SUFFIXES
        ]
        if not all(one.exists() for one in paths):
            _write(job, paths)
        estimate = (job.keep or Path(folder)) / f"{job.name}.est.csv"
        try:
            _convert(path, settings, estimate, job.ekf)
        except (CompanionError, subprocess.SubprocessError) as error:
            return Outcome(job, None, " ".join(str(error).split())[-200:])
        truth = log.read_truth(truth_path)
        return Outcome(job, judge(read_estimate(estimate, truth.stamp_us), truth))


def run_all(jobs: Iterable[Job], processes: int) -> Iterator[Outcome]:
    """Run jobs, in their order."""
    yield from in_order(run, jobs, processes)


def _write(job: Job, paths: Sequence[Path]) -> None:
    """Write log, truth and settings, each complete at once: another process may look for them."""
    readings = generate(job.case, job.seed)
    parts = [path.with_name(f"{os.getpid()}-{path.name}") for path in paths]
    log.write_log(parts[0], readings)
    log.write_truth(parts[1], log.truth_of(readings))
    parts[2].write_text(json.dumps(readings.settings) + "\n", encoding="utf-8")
    for part, path in zip(parts, paths, strict=True):
        part.replace(path)


def _convert(path: Path, settings: Path, out: Path, ekf: Path | None) -> None:
    if ekf is None:
        convert.convert(path, out, load_config(settings))
        return
    command = [str(ekf), "convert", str(path), "-o", str(out), "--config", str(settings)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode or not out.exists():
        raise CompanionError(
            " ".join((done.stderr or done.stdout).split()) or f"exit {done.returncode}"
        )
