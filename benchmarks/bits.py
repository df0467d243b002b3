"""Hold a refactoring to the bit: ``make bits``, or ``python -m benchmarks.bits check [PATTERN]``.

Hashes what the estimator makes of every recording in ``../shared/data`` that can be read and of
seeded flights with a companion on a virtual link: the filter's state block, the table of estimates,
the bytes that the daemon would send and record, and the status as JSON. ``record`` writes them to
``benchmarks/bits.json``; ``check`` compares, names every case and quantity that differs, and exits
with 1 if one does. Record before a change that must not alter results; check after each step of it.

The hashes are those of one processor, C library and NumPy: sines and products of matrices differ in
the last bit elsewhere.
"""

from __future__ import annotations

import argparse
import fnmatch
import gzip
import hashlib
import json
import logging
import multiprocessing
import platform
import struct
import sys
import tempfile
import warnings
import zlib
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.daemon.reception import deliver

# What follows is all that a refactoring may have to change here
from ekf_companion.engine.checkpoint import LAYOUT, Clocks
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import CompanionError
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link, Received
from ekf_companion.logs import tlog
from ekf_companion.replay.convert import convert, estimate, estimate_and_smooth
from ekf_companion.replay.convert import read as read_recording
from ekf_companion.replay.filters_by_name import FILTERS, run_filter
from ekf_companion.status.host import Host
from ekf_companion.status.observer import Observer
from sim_autopilot.config import SimConfig
from sim_autopilot.faults.fault import KINDS, VARIETY, parse
from sim_autopilot.firmware import PERSONALITIES
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench
from sim_autopilot.scenarios import SCENARIOS

RENAMED: dict[str, str] = {
    "before_alignment": "unaligned",
    "superseded": "unused",
    "deweighted": "soft",
}
"""Names printed now, and what was printed when the hashes were recorded: keys and words of the
status. A deliberate change of a name stands here, and nothing else."""

RECORDED_LAYOUT = bytes.fromhex("5df1410b78c92450")
"""What a checkpoint said of the names of its fields when the hashes were recorded."""

RECORDED_COLUMNS = 33
"""Numbers of an estimate when the hashes were recorded; the reasons came behind them."""

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FILE = Path(__file__).with_name("bits.json")
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
    """Return a status as plain data under the names of old, without what depends on the clock."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    if isinstance(value, Enum):
        value = value.name.lower()
    if isinstance(value, str):
        return RENAMED.get(value, value)
    if hasattr(value, "items"):
        named = {plain(key): one for key, one in value.items() if key not in CLOCK_DEPENDENT}
        return {str(key): plain(named[key]) for key in sorted(named, key=str)}
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if isinstance(value, float):
        return value.hex()
    return value


class Watched:
    """A companion and all that it sends, records and estimates."""

    def __init__(self, config: Config) -> None:
        self._companion = Companion(config, is_recording=True)
        self._now_ns = 0
        self._link = Link(parse_url("udpin:127.0.0.1:1"), clock=lambda: self._now_ns)
        self._observer = Observer(self._link, self._companion, lambda: self._now_ns)
        self._digests = {name: Digest() for name in ("sent", "recorded", "table", "state")}
        self._status = Digest()
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
        """Do what time brings."""
        self._now_ns = now_ns
        self._companion.tick(now_ns)
        self._look()

    def data_to_send(self) -> list[bytes]:
        """Return what is sent, once."""
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
            self._digests["table"].add(self._stamp_ns, pipeline.values()[:RECORDED_COLUMNS])
        self._observer.tick(self._now_ns)
        if self._next_ns is None or self._now_ns >= self._next_ns:
            self._next_ns = self._now_ns + STATUS_EVERY_NS
            self._keep()

    def _keep(self) -> None:
        self._status.add(json.dumps(plain(self._observer.snapshot(Host()))).encode())
        if self._companion.pipeline is not None:
            self._digests["state"].add(self._companion.pipeline.state().block)

    def hashes(self) -> Hashes:
        """Return the hashes of all that was seen."""
        self._keep()
        checkpoint = self._companion.checkpoint(Clocks(unix_ns=0))
        return {
            **{name: str(digest) for name, digest in self._digests.items()},
            "status": str(self._status),
            "checkpoint": "" if checkpoint is None else checkpoint_hash(checkpoint),
        }


def checkpoint_hash(checkpoint: bytes) -> str:
    """Return the hash of a checkpoint, whatever its fields are called."""
    body = checkpoint[:-4].replace(LAYOUT, RECORDED_LAYOUT)
    return hashlib.sha256(body + zlib.crc32(body).to_bytes(4, "little")).hexdigest()[:16]


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
    digest = Digest()
    digest.add(table.stamp_ns, table.values[:, :RECORDED_COLUMNS])
    hashes["table"] = str(digest)
    status = Digest()
    status.add(json.dumps(plain(report.health)).encode())
    hashes["health"] = str(status)
    recording = read_recording(path)
    pipeline = Pipeline(Config(), recording.family, recording.gnss_delay)
    pipeline.run(recording.events)
    hashes["state"] = hashlib.sha256(pipeline.state().block.tobytes()).hexdigest()[:16]
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
    digest = Digest()
    tables = (live.values[:, :RECORDED_COLUMNS], smoothed.values[:, :RECORDED_COLUMNS])
    digest.add(live.stamp_ns, tables[0], smoothed.stamp_ns, tables[1])
    return {"smoothed": str(digest)}


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
            digest = Digest()
            values = solution.table.values[:, :RECORDED_COLUMNS]
            digest.add(solution.table.stamp_ns, values, solution.covariance)
            hashes[label] = str(digest)
    return hashes


def unpacked(path: Path, work: Callable[[Path], Hashes]) -> Hashes:
    """Do the work on a file, unpacked to a temporary one where it is gzipped."""
    if path.suffix != ".gz":
        return work(path)
    with tempfile.TemporaryDirectory() as folder:
        plain_file = Path(folder) / path.stem
        plain_file.write_bytes(gzip.decompress(path.read_bytes()))
        return work(plain_file)


def recordings() -> Iterable[tuple[str, Path]]:
    """Yield each file that may be a recording, by its name below the data folder."""
    for path in sorted(DATA.rglob("*")):
        if path.name.endswith(SUFFIXES) and not path.name.startswith("truth"):
            yield path.relative_to(DATA).as_posix(), path


def cases() -> dict[str, tuple[Callable[..., Hashes], tuple[Any, ...]]]:
    """Return what there is to do, by name."""
    found: dict[str, tuple[Callable[..., Hashes], tuple[Any, ...]]] = {}
    for personality in ("px4", "ardupilot"):
        for scenario in SCENARIOS:
            found[f"flight/{scenario}/{personality}"] = (fly, (scenario, personality, ""))
        for fault in dict.fromkeys((*KINDS, *VARIETY)):
            name = f"flight/figure-eight/{personality}/{fault}"
            found[name] = (fly, ("figure-eight", personality, fault))
    for name, path in recordings():
        found[f"log/{name}"] = (unpacked, (path, replay))
        if path.suffix == ".tlog":
            found[f"live/{name}"] = (listen, (path,))
        if any(fnmatch.fnmatch(name, pattern) for pattern in SMOOTHED):
            found[f"smooth/{name}"] = (smooth, (path,))
        if any(fnmatch.fnmatch(name, pattern) for pattern in FILTERED):
            found[f"filters/{name}"] = (by_filters, (path,))
    return found


def run_one(name: str) -> tuple[str, Hashes]:
    """Do one case; a bug is a result too, which no check lets pass."""
    work, arguments = cases()[name]
    try:
        return name, work(*arguments)
    except Exception as error:  # noqa: BLE001  # the other cases go on
        return name, {"bug": f"{type(error).__name__}: {error}"}


def run(names: list[str], jobs: int) -> dict[str, Hashes]:
    """Do the cases in several processes, longest first, and say how far it is."""
    found: dict[str, Hashes] = {}
    with multiprocessing.get_context("spawn").Pool(jobs, _quiet, maxtasksperchild=8) as pool:
        for name, hashes in pool.imap_unordered(run_one, names):
            found[name] = hashes
            if sys.stderr.isatty():
                print(f"\r{len(found)} of {len(names)} ", end="", file=sys.stderr, flush=True)
    return found


def _quiet() -> None:
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")


def environment() -> dict[str, str]:
    """Return what the hashes depend on beside the code."""
    libc = " ".join(platform.libc_ver())
    return {"libc": libc, "numpy": np.__version__, "machine": platform.machine()}


def main() -> None:
    """Record the hashes, or compare with those that were recorded."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", choices=("record", "check", "list"))
    parser.add_argument("pattern", nargs="*", default=["*"], help="cases, as a shell would match")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_intermixed_args()
    known = cases()
    names = [
        name for name in known if any(fnmatch.fnmatch(name, pattern) for pattern in asked.pattern)
    ]
    if asked.what == "list":
        print("\n".join(names))
        return
    if not DATA.is_dir():
        print(f"{DATA}: absent; only the simulated flights are hashed")
    found = run(names, asked.jobs)
    recorded = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    if asked.what == "record":
        hashes = {**recorded.get("hashes", {}), **found}
        kept = {name: hashes[name] for name in sorted(hashes) if name in known}
        FILE.write_text(
            json.dumps({"environment": environment(), "hashes": kept}, indent=1) + "\n",
            encoding="utf-8",
        )
        print(f"{FILE.name}: {len(found)} of {len(kept)} cases recorded")
        return
    if recorded.get("environment") != environment():
        print(f"recorded with {recorded.get('environment')}, here is {environment()}")
    sys.exit(compare(recorded.get("hashes", {}), found))


def compare(recorded: dict[str, Hashes], found: dict[str, Hashes]) -> int:
    """Print what differs; return 1 if anything does."""
    wrong = 0
    for name in sorted(found):
        if name not in recorded:
            print(f"{name}: not recorded")
            wrong += 1
            continue
        for quantity in sorted({*recorded[name], *found[name]}):
            before, now = recorded[name].get(quantity), found[name].get(quantity)
            if before != now:
                print(f"{name}: {quantity}: {now}, was {before}")
                wrong += 1
    quantities = sum(map(len, found.values()))
    print(f"{quantities} hashes of {len(found)} cases: {wrong or 'none'} differ")
    return int(wrong > 0)


if __name__ == "__main__":
    main()
