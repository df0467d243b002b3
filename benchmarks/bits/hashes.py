"""Hash what this tree makes of all recordings and seeded flights: the half of ``make bits``.

The estimator takes every recording in ``../shared/data`` that can be read and seeded flights with a
companion on a virtual link: the filter's state field by field, the table of estimates column by
column, the bytes that the daemon would send and record, and the status part by part. The hashes go
to a file as JSON; :mod:`benchmarks.bits.__main__` compares those of two trees, on one machine, as
sines and products of matrices differ in the last bit elsewhere.

This file imports nothing else of the benchmarks, so that it runs on a tree that has none.
"""

from __future__ import annotations

import argparse
import ctypes
import fnmatch
import gzip
import hashlib
import json
import logging
import multiprocessing
import struct
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.config.config import Config

# What follows is all that a refactoring may have to change here
from ekf_companion.core.memory.state import State
from ekf_companion.daemon.reception import deliver
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import CompanionError
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link, Received
from ekf_companion.logs import tlog
from ekf_companion.nav.state import COLUMNS
from ekf_companion.replay.filters_by_name import FILTERS, run_filter
from ekf_companion.replay.read import read as read_recording
from ekf_companion.review.convert import convert, estimate, estimate_and_smooth
from ekf_companion.status.host import Host
from ekf_companion.status.observer import Observer
from sim_autopilot.config import SimConfig
from sim_autopilot.faults.fault import KINDS, VARIETY, parse
from sim_autopilot.firmware import PERSONALITIES
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench
from sim_autopilot.scenarios import SCENARIOS

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
SUFFIXES = (".tlog", ".bin", ".ulg", ".csv", ".csv.gz", ".txt", ".mat")
RATE = 250.0
STATUS_EVERY_NS = 10_000_000_000
CLOCK_DEPENDENT = frozenset({"unix_ns", "process"})
"""Keys of the status that differ from run to run."""
FILTERED = (
    "seed-basicekf-sim/uavSensors.csv",
    "sitl-px4-square/flight.tlog",
    "sitl-arducopter-bin/flight.bin",
    "zupt-openshoe/*",
    "zupt-xio-short-walk/*.csv",
    "broad-attitude/01*",
)
"""Recordings that the filters of the articles are taken through as well."""
SMOOTHED = ("sitl-px4-square/flight.tlog", "px4-ulg-x500-mission/*", "tlog-copter-vancouver/*")

Hashes = dict[str, str]


class Digest:
    """A hash of what is added, piece by piece."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, *pieces: bytes | np.ndarray | int) -> None:
        """Add bytes, arrays (by their bits) and whole numbers."""
        for piece in pieces:
            if isinstance(piece, int):
                piece = struct.pack("<q", piece)
            elif isinstance(piece, np.ndarray):
                # the bits of a NaN say nothing
                floats = np.ascontiguousarray(piece)
                if floats.dtype.kind == "f":
                    floats = np.where(np.isnan(floats), np.nan, floats)
                piece = floats.tobytes()
            self._hash.update(struct.pack("<q", len(piece)) + piece)

    def __str__(self) -> str:
        return self._hash.hexdigest()[:16]


def plain(value: Any) -> Any:
    """Return a status as plain data, without what depends on the clock."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    if isinstance(value, Enum):
        value = value.name.lower()
    if hasattr(value, "items"):
        named = {plain(key): one for key, one in value.items() if key not in CLOCK_DEPENDENT}
        return {str(key): plain(named[key]) for key in sorted(named, key=str)}
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if isinstance(value, float):
        return value.hex()
    return value


def by_column(prefix: str, stamp_ns: np.ndarray, values: np.ndarray) -> Hashes:
    """Return the hashes of estimates, by column: a new one changes no other."""
    found = {f"{prefix}.time": hash_of(stamp_ns)}
    for index, name in enumerate(COLUMNS[1 : values.shape[1] + 1]):
        found[f"{prefix}.{name}"] = hash_of(values[:, index])
    return found


def by_field(
    blocks: np.ndarray, kind: Any = State, prefix: str = "state", begin: int = 0
) -> Hashes:
    """Return the hashes of the filter's states, shape (n, BLOCK), by field."""
    found: Hashes = {}
    for name, declared in kind._fields_:
        first = begin + getattr(kind, name).offset
        if issubclass(declared, ctypes.Structure):
            found |= by_field(blocks, declared, f"{prefix}.{name}", first)
        else:
            last = first + ctypes.sizeof(declared)
            found[f"{prefix}.{name}"] = hash_of(blocks[:, first // 8 : last // 8])
    return found


def by_part(prefix: str, values: Sequence[Any]) -> Hashes:
    """Return the hashes of what a status or health was at several times, by part."""
    parts: dict[str, Digest] = {}
    for value in values:
        for name, part in plain(value).items():
            parts.setdefault(name, Digest()).add(json.dumps(part).encode())
    return {f"{prefix}.{name}": str(digest) for name, digest in parts.items()}


def hash_of(piece: bytes | np.ndarray) -> str:
    """Return the hash of bytes or of an array."""
    digest = Digest()
    digest.add(piece)
    return str(digest)


class Watched:
    """A companion and all that it sends, records and estimates."""

    def __init__(self, config: Config) -> None:
        self._companion = Companion(config, is_recording=True)
        self._now_ns = 0
        self._link = Link(parse_url("udpin:127.0.0.1:1"), clock=lambda: self._now_ns)
        self._observer = Observer(self._link, self._companion, lambda: self._now_ns)
        self._digests = {name: Digest() for name in ("sent", "recorded")}
        self._rows: list[np.ndarray] = []
        self._stamps: list[int] = []
        self._blocks: list[np.ndarray] = []
        self._status: list[Any] = []
        self._next_ns: int | None = None
        self._stamp_ns = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes, as the daemon does."""
        self._now_ns = now_ns
        deliver(
            Received(data, now_ns, ("127.0.0.1", 14550)),
            self._companion.receive,
            self._companion.session,
            self._link,
        )
        self._look()

    def tick(self, now_ns: int) -> None:
        """Do the periodic work."""
        self._now_ns = now_ns
        self._companion.tick(now_ns)
        self._look()

    def data_to_send(self) -> list[bytes]:
        """Return the bytes to send, once."""
        sent = self._companion.data_to_send()
        for data in sent:
            self._digests["sent"].add(self._now_ns, data)
        return sent

    def _look(self) -> None:
        for part in self._companion.session.outbox.take_record():
            self._digests["recorded"].add(repr(part).encode())
        pipeline = self._companion.pipeline
        if pipeline is not None and pipeline.stamp_ns != self._stamp_ns:
            self._stamp_ns = pipeline.stamp_ns
            self._stamps.append(self._stamp_ns)
            self._rows.append(pipeline.values())
        self._observer.tick(self._now_ns)
        if self._next_ns is None or self._now_ns >= self._next_ns:
            self._next_ns = self._now_ns + STATUS_EVERY_NS
            self._keep()

    def _keep(self) -> None:
        self._status.append(plain(self._observer.snapshot(Host())))
        if self._companion.pipeline is not None:
            self._blocks.append(self._companion.pipeline.state().block)

    def hashes(self) -> Hashes:
        """Return the hashes of all that was seen."""
        self._keep()
        found = {name: str(digest) for name, digest in self._digests.items()}
        found |= by_part("status", self._status)
        if self._rows:
            found |= by_column("table", np.array(self._stamps), np.array(self._rows))
            found |= by_field(np.array(self._blocks))
        return found


def fly(scenario: str, personality: str, fault: str) -> Hashes:
    """Fly with a companion at the other end of a virtual link."""
    nature = PERSONALITIES[personality]
    config = SimConfig()
    config = replace(config, imu=replace(config.imu, rate=RATE))
    faults = [parse(f"{fault}{',' if ':' in fault else ':'}start=25")] if fault else []
    flight = Flight.plan(scenario, nature.suited(config), seed=11, duration=55.0)
    asking = Config()
    peer = Watched(replace(asking, link=replace(asking.link, imu_rate=RATE)))
    bench = Bench(flight, peer, personality=nature, faults=faults, latency=0.001)
    for _ in bench.frames():
        pass
    return peer.hashes()


def listen(path: Path) -> Hashes:
    """Feed a companion the frames of a .tlog, at their recorded times."""
    peer = Watched(Config())
    next_ns = 0
    for stamp_us, frame in tlog.read(path).frames():
        now_ns = stamp_us * 1000
        peer.receive(frame, now_ns)
        if now_ns >= next_ns or next_ns - now_ns > 100_000_000:
            next_ns = now_ns + 50_000_000
            peer.tick(now_ns)
        peer.data_to_send()
    return peer.hashes()


def _refused(error: CompanionError) -> Hashes:
    return {"refused": type(error).__name__}


def replay(path: Path) -> Hashes:
    """Convert a recording, to estimates and to the messages that the daemon would send."""
    hashes: Hashes = {}
    try:
        table, report = estimate(path, Config())
    except CompanionError as error:
        return _refused(error)
    hashes |= by_column("table", table.stamp_ns, table.values)
    hashes |= by_part("health", [report.health])
    recording = read_recording(path)
    pipeline = Pipeline(Config(), recording.family, recording.gnss_delay)
    pipeline.run(recording.events)
    hashes |= by_field(pipeline.state().block[None])
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.tlog"
        try:
            convert(path, out, Config())
            hashes["messages"] = hashlib.sha256(out.read_bytes()).hexdigest()[:16]
        except CompanionError as error:
            hashes["messages"] = type(error).__name__
    return hashes


def smooth(path: Path) -> Hashes:
    """Smooth a recording."""
    live, smoothed, _ = estimate_and_smooth(path, Config())
    return by_column("live", live.stamp_ns, live.values) | by_column(
        "smoothed", smoothed.stamp_ns, smoothed.values
    )


def by_filters(path: Path) -> Hashes:
    """Take each filter of the articles through a recording."""
    hashes: Hashes = {}
    recording = read_recording(path)
    for name, one in FILTERS.items():
        for option in one.options or ("",):
            label = f"{name}:{option}" if option else name
            try:
                solution = run_filter(recording, label)
            except CompanionError as error:
                hashes[label] = type(error).__name__
                continue
            hashes |= by_column(label, solution.table.stamp_ns, solution.table.values)
            hashes[f"{label}.covariance"] = hash_of(solution.covariance)
    return hashes


def unpacked(path: Path, work: Callable[[Path], Hashes]) -> Hashes:
    """Do the work on a file, unpacked to a temporary one where it is gzipped."""
    if path.suffix != ".gz":
        return work(path)
    with tempfile.TemporaryDirectory() as folder:
        plain_file = Path(folder) / path.stem
        plain_file.write_bytes(gzip.decompress(path.read_bytes()))
        return work(plain_file)


def recordings(data: Path) -> Iterable[tuple[str, Path]]:
    """Yield each file that may be a recording, by its name below the data folder."""
    for path in sorted(data.rglob("*")):
        if path.name.endswith(SUFFIXES) and not path.name.startswith("truth"):
            yield path.relative_to(data).as_posix(), path


def cases(data: Path) -> dict[str, tuple[Callable[..., Hashes], tuple[Any, ...]]]:
    """Return what there is to do, by name."""
    found: dict[str, tuple[Callable[..., Hashes], tuple[Any, ...]]] = {}
    for personality in ("px4", "ardupilot"):
        for scenario in SCENARIOS:
            found[f"flight/{scenario}/{personality}"] = (fly, (scenario, personality, ""))
        for fault in dict.fromkeys((*KINDS, *VARIETY)):
            name = f"flight/figure-eight/{personality}/{fault}"
            found[name] = (fly, ("figure-eight", personality, fault))
    for name, path in recordings(data):
        found[f"log/{name}"] = (unpacked, (path, replay))
        if path.suffix == ".tlog":
            found[f"live/{name}"] = (listen, (path,))
        if any(fnmatch.fnmatch(name, pattern) for pattern in SMOOTHED):
            found[f"smooth/{name}"] = (smooth, (path,))
        if any(fnmatch.fnmatch(name, pattern) for pattern in FILTERED):
            found[f"filters/{name}"] = (by_filters, (path,))
    return found


def run_one(job: tuple[Path, str]) -> tuple[str, Hashes]:
    """Run one case; an exception is a result too, which no comparison accepts."""
    data, name = job
    work, arguments = cases(data)[name]
    try:
        return name, work(*arguments)
    except Exception as error:  # noqa: BLE001  # the other cases go on
        return name, {"bug": f"{type(error).__name__}: {error}"}


def _quiet() -> None:
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")


def main() -> None:
    """Write the hashes into a file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", type=Path, help="JSON: hashes by case and quantity")
    parser.add_argument("pattern", nargs="*", default=["*"], help="cases, as a shell would match")
    parser.add_argument("--data", type=Path, default=DATA, help="the recordings")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_intermixed_args()
    names = [
        name
        for name in cases(asked.data)
        if any(fnmatch.fnmatch(name, pattern) for pattern in asked.pattern)
    ]
    found: dict[str, Hashes] = {}
    jobs = [(asked.data, name) for name in names]
    with multiprocessing.get_context("spawn").Pool(asked.jobs, _quiet, maxtasksperchild=8) as pool:
        for name, hashes in pool.imap_unordered(run_one, jobs):
            found[name] = hashes
            if sys.stderr.isatty():
                print(f"\r{len(found)} of {len(names)} ", end="", file=sys.stderr, flush=True)
    asked.out.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
