"""Damage files of every kind that a command reads, and see what the command does with each.

A file may be anything. Demanded are: no traceback and no signal; an exit code that docs/COMMANDS.md
names, with one sentence where it is not 0; less than 1 GiB of memory, which is the process's limit;
and a time that grows with the bytes of the file and no faster::

    python -m benchmarks.reliability.damaged                      # 300 mutants of each kind
    python -m benchmarks.reliability.damaged .ulg.gz journal --mutants 50 --seed 7

The whole files are beginnings of recorded flights, where these are there, and a simulated one. What
fails is left in ``--keep``.
"""

from __future__ import annotations

import argparse
import gzip
import logging
import os
import resource
import sys
import tempfile
import traceback
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import typer
import zstandard

from benchmarks.reliability.damage import LARGEST, damaged, flip
from benchmarks.reliability.fuzz import FuzzedCompanion, undisturbed
from benchmarks.reliability.whole_files import FLIGHT_S, InPlace, whole_files
from ekf_companion.cli import COMMANDS, app, terminal
from ekf_companion.config.config import Config
from ekf_companion.engine.checkpoint_parts import Clocks
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.tuning import Tuning
from ekf_companion.engine.warm_start import WarmStart
from ekf_companion.fleet import run, table
from ekf_companion.fleet.source import of_path
from ekf_companion.replay.log_source import READERS

GIB = 1 << 30
START_S = 4.0
"""Processor seconds that a file may take however small it is, on two busy cores."""
PER_MB_S = 8.0
"""Processor seconds that a megabyte may take, unpacked; a whole log takes less than one."""
PACKING: Mapping[str, Callable[[bytes], bytes]] = {
    ".gz": partial(gzip.compress, compresslevel=1),
    ".zst": lambda data: zstandard.ZstdCompressor().compress(data),
}
LOGS = (".tlog", ".bin", ".ulg", ".csv", ".log", ".txt")
KINDS = (
    *(log + packing for log in LOGS for packing in ("", *PACKING)),
    *(".mat", "columns.yaml", "config.yaml", "checkpoint", "parameters", "journal"),
)
CODES = {"columns.yaml": (0, 3), "config.yaml": (0, 2), "journal": (0, 2)}
"""Exit codes that are right; of a log they are 0 and 3."""


@dataclass(slots=True)
class Outcome:
    """What became of one mutant."""

    size: int
    """Bytes, unpacked."""
    code: int
    """Exit code; below 0: a signal."""
    words: str
    """Of the standard error."""
    seconds: float
    """Of a processor."""
    memory: int
    """Largest resident memory, bytes."""

    def complaint(self, kind: str) -> str:
        """Return what is wrong with it; empty: nothing."""
        lines = self.words.strip().splitlines()
        if "Traceback" in self.words:
            return f"a traceback: {lines[-1]}"
        if self.code not in CODES.get(kind, (0, 3)):
            return f"exit code {self.code}: {self.words:.300}"
        if self.code and len([line for line in lines if line.startswith("ekf-companion: ")]) != 1:
            return f"not one sentence: {self.words:.300}"
        if self.memory > GIB:
            return f"{self.memory >> 20} MiB of memory"
        if self.seconds > START_S + PER_MB_S * self.size * 1e-6:
            return f"{self.seconds:.1f} s for {self.size} bytes"
        return ""


@dataclass(slots=True)
class Tally:
    """What became of all mutants of a kind."""

    kind: str
    count: int = 0
    read: int = 0
    """With exit code 0."""
    seconds: float = 0.0
    """The longest."""
    per_mb: float = 0.0
    """The longest of those above a megabyte, by their size."""
    memory: int = 0
    """The largest."""
    complaints: list[str] = field(default_factory=list)

    def add(self, outcome: Outcome) -> str:
        """Count a mutant, and return what is wrong with it."""
        self.count += 1
        self.read += outcome.code == 0
        self.seconds = max(self.seconds, outcome.seconds)
        self.memory = max(self.memory, outcome.memory)
        if outcome.size > 1_000_000:
            self.per_mb = max(self.per_mb, outcome.seconds / outcome.size * 1e6)
        if wrong := outcome.complaint(self.kind):
            self.complaints.append(wrong)
        return wrong

    def row(self) -> str:
        """Return a row of the table."""
        return (
            f"| {self.kind} | {self.count} | {self.read} | {self.seconds:.1f} | {self.per_mb:.1f} "
            f"| {self.memory >> 20} | {len(self.complaints)} |"
        )


class Campaign:
    """Whole files of every kind, and the commands that read them, each in a process of its own."""

    def __init__(self, whole: Mapping[str, bytes], folder: Path) -> None:
        """Take a whole file by kind (``.tlog``, ``checkpoint``), and a folder to write into."""
        self._whole, self._folder = whole, folder
        # Once, and not in each process
        for entry in COMMANDS.values():
            import_module(f"ekf_companion.cli.{entry.module}")
        for name in ("tlog", *READERS.values()):
            import_module(f"ekf_companion.logs.{name}")
        self._flight = [*undisturbed(1, duration=FLIGHT_S + 4.0)]

    def run(self, kind: str, mutants: int, seed: int, keep: Path | None = None) -> Tally:
        """Damage and read so many files of a kind."""
        tally, rng = Tally(kind), np.random.default_rng([seed, KINDS.index(kind)])
        for number in range(mutants):
            data, size = self._mutant(kind, rng)
            outcome = self.read(kind, data, size)
            if (wrong := tally.add(outcome)) and keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{number}{kind if kind[0] == '.' else '.' + kind}").write_bytes(data)
                print(f"{kind} {number}: {wrong}", flush=True)
        return tally

    def _mutant(self, kind: str, rng: np.random.Generator) -> tuple[bytes, int]:
        """Return a damaged file, and its size unpacked."""
        name, packing = _parts(kind)
        others = [data for other, data in self._whole.items() if other != name]
        other = others[int(rng.integers(len(others)))]
        if packing is None:
            data = damaged(self._whole[name], other, rng)
            if kind == "checkpoint" and rng.random() < 0.7:  # else its checksum refuses all
                data = data[:-4] + zlib.crc32(data[:-4]).to_bytes(4, "little")
            return data, len(data)
        if rng.random() < 0.1:  # packed so well that it is made to fill a memory
            return PACKING[packing](bytes(1 << 28)), 1 << 26
        if rng.random() < 0.4:
            whole = self._whole[name]
            return damaged(PACKING[packing](whole), other, rng), LARGEST
        data = damaged(self._whole[name], other, rng)
        packed = PACKING[packing](data)
        return (packed if rng.random() < 0.5 else flip(packed, other, rng)), len(data)

    def read(self, kind: str, data: bytes, size: int) -> Outcome:
        """Write a file, and read it in a process of its own with bounded memory."""
        for old in self._folder.iterdir():
            old.unlink()
        task = self._task(kind, data)
        with tempfile.TemporaryFile() as err:
            if (child := os.fork()) == 0:
                os._exit(_run_bounded(task, err.fileno()))
            _, status, used = os.wait4(child, 0)
            err.seek(0)
            words = err.read().decode(errors="replace")
        code = os.waitstatus_to_exitcode(status)
        return Outcome(size, code, words, used.ru_utime + used.ru_stime, used.ru_maxrss << 10)

    def _task(self, kind: str, data: bytes) -> Callable[[], None]:
        """Write a file, and return what reads it."""
        folder = self._folder
        table = folder / "table.csv"
        convert = ["convert", "-o", str(folder / "out.csv")]
        if kind == "checkpoint":
            return partial(_resume, data, self._flight)
        if kind == "parameters":
            return partial(Tuning, Config(), data, kind)
        if kind == "columns.yaml":
            table.write_bytes(self._whole[".csv"][:20_000])
            (folder / "table.csv.columns.yaml").write_bytes(data)
            return partial(app, [*convert, str(table)])
        if kind == "config.yaml":
            table.write_bytes(self._whole[".csv"][:20_000])
            config = folder / "config.yaml"
            config.write_bytes(data)
            return partial(app, [*convert, str(table), "--config", str(config)])
        if kind == "journal":
            return partial(_go_on, folder, data)
        path = folder / f"flight{kind}"
        path.write_bytes(data)
        return partial(app, [*convert, str(path)])


def _parts(kind: str) -> tuple[str, str | None]:
    """Return a kind without its packing, and the packing: ``.csv`` and ``.gz`` of ``.csv.gz``."""
    name, point, packing = kind.rpartition(".")
    return (name, point + packing) if point + packing in PACKING else (kind, None)


def _resume(data: bytes, flight: Sequence[bytes]) -> None:
    """Begin as the daemon does with a checkpoint, and go on with the flight of it."""
    now_ns = FuzzedCompanion().now_ns + round(FLIGHT_S * 1e9)
    fuzzed = FuzzedCompanion()
    fuzzed.now_ns = now_ns
    warm_start = WarmStart(data, Clocks(now_ns), now_ns)
    fuzzed.companion = Companion(Config(), is_recording=True, warm_start=warm_start)
    for part in flight[len(flight) * 6 // 10 :]:
        fuzzed.feed(part)
    fuzzed.check()


def _go_on(folder: Path, data: bytes) -> None:
    """Go on as ``batch`` does where a journal stands, in this process alone."""
    logs = [folder / name for name in ("one.csv", "two.csv", "three.csv")]
    for log in logs[1:]:
        log.touch()
    journal = folder / "table.csv.journal"
    journal.write_bytes(data.replace(b"LOG", str(folder).encode()))
    with exit_as_a_command(), terminal.exit_on_error():
        rows = run.run([of_path(log) for log in logs], Config(), journal, InPlace())
        for name in ("table.csv", "table.parquet"):
            table.write(folder / name, rows)
    for line in table.lines(rows, 80):
        print(line)


@contextmanager
def exit_as_a_command() -> Iterator[None]:
    """Exit as a command does, outside of one."""
    try:
        yield
    except typer.Exit as end:
        raise SystemExit(end.exit_code) from end


def _run_bounded(task: Callable[[], object], err: int) -> int:
    """Run a task in this process, which may have 1 GiB more than it has; return an exit code."""
    os.dup2(err, 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
    size = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * 4096
    resource.setrlimit(resource.RLIMIT_AS, (size + GIB, size + GIB))
    resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
    code = 0
    try:
        task()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except Exception:  # noqa: BLE001  # whatever it is, it is what is looked for
        traceback.print_exc()
        code = 1
    with suppress(OSError):
        sys.stderr.flush()
    return code


def main() -> None:
    """Damage and read files of each kind, and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--mutants", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "ekf-damaged")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    whole, is_right = whole_files(), True
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(whole, Path(folder))
        print("| file | mutants | read | longest, s | s per MB above 1 MB | memory, MiB | wrong |")
        for kind in options.kinds or KINDS:
            if _parts(kind)[0] not in whole:
                print(f"| {kind} | no recorded flight of this kind |")
                continue
            tally = campaign.run(kind, options.mutants, options.seed, options.keep)
            is_right = is_right and not tally.complaints
            print(tally.row(), flush=True)
    raise SystemExit(0 if is_right else 1)


if __name__ == "__main__":
    main()
