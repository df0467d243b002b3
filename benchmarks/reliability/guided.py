"""Fuzz the decoder and the log readers, directed by coverage, with Atheris (libFuzzer).

To run it::

    python -m benchmarks.reliability.guided stream --seconds 300
    python -m benchmarks.reliability.guided tlog bin ulg csv txt mat --seconds 60

What is found is left as ``crash-*`` in the folder of the corpus. Seeds are a simulated flight and,
where the recorded flights are there, their beginnings. Atheris is installed by ``make fuzz``.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import atheris

SEED_BYTES = 60_000
LARGEST = 100_000
"""Bytes of one input."""

with atheris.instrument_imports(include=["ekf_companion.mavlink", "ekf_companion.logs"]):
    from benchmarks.document import DATA
    from benchmarks.reliability.fuzz import FuzzedCompanion, undisturbed
    from ekf_companion.config.config import Config
    from ekf_companion.errors import LogError
    from ekf_companion.replay.read import read
    from sim_autopilot.autopilot import Autopilot
    from sim_autopilot.config import SimConfig
    from sim_autopilot.flight import Flight
    from sim_autopilot.recording import TlogWriter

SUFFIXES = ("tlog", "bin", "ulg", "csv", "txt", "mat")


def stream(data: bytes) -> None:
    """Feed bytes like those of a link, in pieces whose length the first byte sets."""
    fuzzed = FuzzedCompanion()
    cut = data[0] + 1 if data else 1
    for start in range(0, len(data), cut):
        fuzzed.feed(data[start : start + cut])
    fuzzed.check()


def log(suffix: str, folder: Path) -> Callable[[bytes], None]:
    """Return a target that reads a file of a format: a refusal is right, any other error is not."""
    path = folder / f"input.{suffix}"

    def read_it(data: bytes) -> None:
        path.write_bytes(data)
        with contextlib.suppress(LogError):
            read(path, Config())

    return read_it


def seed(target: str, corpus: Path) -> None:
    """Write the first inputs of a target."""
    corpus.mkdir(parents=True, exist_ok=True)
    if target == "stream":
        (corpus / "flight").write_bytes(b"".join(undisturbed(1, duration=1.0))[:SEED_BYTES])
    if target == "tlog":
        flight = Flight.plan("hover", SimConfig(), duration=2.0)
        autopilot = Autopilot(flight.config)
        with TlogWriter(corpus / "flight", 1.7e9) as writer:
            for cycle in flight.cycles():
                autopilot.cycle(cycle)
                for frame in autopilot.data_to_send():
                    writer.write(cycle.t_ns, frame)
    for number, path in enumerate(sorted(DATA.rglob(f"*.{target}"))):
        with path.open("rb") as file:
            (corpus / f"recorded-{number}").write_bytes(file.read(SEED_BYTES))


def main() -> None:
    """Run one target in this process, several in children."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="+", choices=("stream", *SUFFIXES))
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--corpus", type=Path, default=Path(tempfile.gettempdir()) / "ekf-fuzz")
    options = parser.parse_args()
    for target in options.targets[:-1]:
        if child := os.fork():
            _, status = os.waitpid(child, 0)
            if status:
                raise SystemExit(f"{target}: failed; see {options.corpus / target}")
            continue
        _fuzz(target, options)
    _fuzz(options.targets[-1], options)


def _fuzz(target: str, options: argparse.Namespace) -> None:
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error")
    corpus = options.corpus / target
    seed(target, corpus)
    body = stream if target == "stream" else log(target, options.corpus)
    arguments = [
        *(sys.argv[0], str(corpus), f"-max_total_time={options.seconds}", f"-max_len={LARGEST}"),
        *(f"-artifact_prefix={options.corpus}/crash-{target}-", "-rss_limit_mb=4096"),
        *("-timeout=60", "-print_final_stats=1"),
    ]
    atheris.Setup(arguments, body)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
