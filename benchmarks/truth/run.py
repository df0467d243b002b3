"""One flight of a case: generated, converted with the default settings, judged."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.engine import in_order
from benchmarks.truth import log
from benchmarks.truth.cases import generate
from benchmarks.truth.judge import Verdict, judge, read_estimate
from ekf_companion.config.config import Config
from ekf_companion.errors import CompanionError
from ekf_companion.review import convert


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
        path, truth_path = (
            (job.logs or Path(folder)) / f"{job.name}{suffix}" for suffix in (".csv", ".npz")
        )
        if not (path.exists() and truth_path.exists()):
            _write(job, path, truth_path)
        estimate = (job.keep or Path(folder)) / f"{job.name}.est.csv"
        try:
            _convert(path, estimate, job.ekf)
        except (CompanionError, subprocess.SubprocessError) as error:
            return Outcome(job, None, " ".join(str(error).split())[-200:])
        truth = log.read_truth(truth_path)
        return Outcome(job, judge(read_estimate(estimate, truth.stamp_us), truth))


def run_all(jobs: Iterable[Job], processes: int) -> Iterator[Outcome]:
    """Run jobs, in their order."""
    yield from in_order(run, jobs, processes)


def _write(job: Job, path: Path, truth_path: Path) -> None:
    """Write a log and its truth, each complete at once: another process may look for them."""
    readings = generate(job.case, job.seed)
    part, truth_part = (x.with_name(f"{os.getpid()}-{x.name}") for x in (path, truth_path))
    log.write_log(part, readings)
    log.write_truth(truth_part, log.truth_of(readings))
    part.replace(path)
    truth_part.replace(truth_path)


def _convert(path: Path, out: Path, ekf: Path | None) -> None:
    if ekf is None:
        convert.convert(path, out, Config())
        return
    command = [str(ekf), "convert", str(path), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode or not out.exists():
        raise CompanionError(
            " ".join((done.stderr or done.stdout).split()) or f"exit {done.returncode}"
        )
