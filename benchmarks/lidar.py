"""Lidar-inertial odometry on the sequences of shared/data/lidar: accuracy, honesty, cost.

Scores are those of shared/tools/lidar_score.py; truth is used by it alone.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks import lidar_aid, lidar_live, lidar_memory, lidar_peers, lidar_radar
from benchmarks.document import table
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.recording import Mounting, Recording
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.solution import Solution, start
from ekf_companion.lidar.state import exp
from ekf_companion.lidar.track import Track
from ekf_companion.nav.direction import levelled

SHARED = Path(__file__).parents[2] / "shared"
HEAD = (
    "sequence | ATE start, 4 dof, 6 dof, m | RPE 10 m, % | NEES relative: position, rotation | "
    "NEES global | own sigma, m | ms a scan, p95"
)
SEQUENCES = ("room_walk", "street_drive", "forest_flight", "tunnel_run", "plain_flight")
TURN = np.radians(2.8) * np.array([0.6, -0.64, 0.48])
SHIFT = np.array([0.03, -0.02, 0.02])
"""A mounting that is wrong by 2.8 deg and 4 cm."""
LATE = 0.012
CLIP = np.radians(120.0)
"""Below the largest rates of these sequences, rad/s."""
MOTION = 8.0
"""Where a recording is cut to begin in motion, s."""


@dataclass(frozen=True)
class Case:
    """A sequence, changed."""

    name: str
    sequence: str
    change: Callable[[Recording], Recording]
    settings: Callable[[Settings], Settings]


def cropped(recording: Recording) -> Recording:
    """Return a recording that begins in motion."""
    kept = recording.inertial.stamp >= MOTION
    inertial = replace(
        recording.inertial,
        stamp=recording.inertial.stamp[kept],
        gyro=recording.inertial.gyro[kept],
        accel=recording.inertial.accel[kept],
    )
    scans = [scan for scan in recording.scans if scan.stamp >= MOTION]
    return replace(recording, scans=scans, inertial=inertial)


def turned(recording: Recording) -> Recording:
    """Return it with a wrong mounting."""
    before = recording.mounting
    return replace(
        recording,
        mounting=Mounting(
            before.rotation @ exp(TURN), before.position + SHIFT, np.radians(3.0), 0.05
        ),
    )


def late(recording: Recording) -> Recording:
    """Return it with late inertial stamps."""
    stamp = recording.inertial.stamp + LATE
    return replace(recording, inertial=replace(recording.inertial, stamp=stamp))


def clipped(recording: Recording) -> Recording:
    """Return it with a gyro of a smaller range."""
    gyro = np.clip(recording.inertial.gyro, -CLIP, CLIP)
    return replace(recording, inertial=replace(recording.inertial, gyro=gyro))


def same(value: Any) -> Any:
    """Return what it is given."""
    return value


def cases() -> Iterator[Case]:
    """Yield what is run."""
    for name in SEQUENCES:
        yield Case(name, name, same, same)
        yield Case(f"{name}, map known", name, same, lambda s: replace(s, anchors=0))
        yield Case(f"{name}, short map", name, same, lambda s: replace(s, anchors=2))
        yield Case(f"{name}, scan to scan", name, same, lambda s: replace(s, is_scan_to_scan=True))
    for name in ("room_walk", "forest_flight"):
        yield Case(f"{name}, in motion", name, cropped, same)
        yield Case(
            f"{name}, turned",
            name,
            lambda r: turned(cropped(r)),
            lambda s: replace(s, is_mounting_estimated=True),
        )
        yield Case(
            f"{name}, late",
            name,
            lambda r: late(cropped(r)),
            lambda s: replace(s, delay_sigma=0.02),
        )
        yield Case(f"{name}, clipped", name, lambda r: clipped(cropped(r)), same)


def ranges(path: Path) -> Settings:
    """Return the settings that the lidar of a sequence says."""
    calib = json.loads((path / "calib.json").read_text(encoding="utf-8"))
    return Settings(least_range=calib["range_min_m"], most_range=calib["range_max_m"])


def run(case: Case) -> tuple[Solution, list[float]]:
    """Return the solution of a case, and the time of each scan, ms."""
    path = SHARED / "data" / "lidar" / case.sequence
    settings = case.settings(ranges(path))
    recording = case.change(read(path))
    odometry = start(recording, settings)
    track, spent = Track(), []
    for scan in recording.scans:
        begin = time.process_time()
        made = odometry.process(scan)
        spent.append(1e3 * (time.process_time() - begin) / max(len(made), 1))
        for one in made:
            track.add(one)
    solution = Solution(
        name=case.name,
        decisions=(),
        track=track,
        C_level=levelled(odometry.x.down_w),
        points=np.zeros((0, 3)),
    )
    return solution, spent


def scorer() -> ModuleType:
    """Return shared/tools/lidar_score.py."""
    path = SHARED / "tools" / "lidar_score.py"
    spec = importlib.util.spec_from_file_location("lidar_score", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path}: cannot be read")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def row(case: Case, score: ModuleType) -> str:
    """Return the row of a case."""
    solution, spent = run(case)
    path = str(SHARED / "data" / "lidar" / case.sequence)
    found = score.score(path, solution.poses, solution.covariances())
    apart = score.score_relative(path, solution.relatives())
    return line(case.name, found, apart, f"{solution.sigma:.2g}", spent)


def line(name: str, found: Any, apart: Any, sigma: str, spent: Sequence[float]) -> str:
    """Return a row of the table; a dash stands for what is not given."""
    ate = ", ".join(f"{found[f'ate_{kind}_m']:.3f}" for kind in ("start", "4dof", "6dof"))
    rpe = found["rpe"].get("10", {}).get("percent", float("nan"))
    nees = [
        f"{one['nees_position']['mean']:.2g}, {one['nees_rotation']['mean']:.2g}"
        if "nees_position" in one
        else "-"
        for one in (apart, found)
    ]
    cost = f"{np.mean(spent):.0f}, {np.percentile(spent, 95):.0f}"
    return " | ".join([name, ate, f"{rpe:.2f}", *nees, sigma, cost])


def peers(score: ModuleType, wanted: str) -> Iterator[str]:
    """Yield the rows of other programs."""
    for sequence in SEQUENCES:
        for peer in lidar_peers.PEERS:
            if wanted in (name := f"{sequence}, {peer}"):
                path = SHARED / "data" / "lidar" / sequence
                poses, covariances, spent = lidar_peers.run_apart(peer, path, ranges(path))
                yield line(name, score.score(str(path), poses, covariances), {}, "-", spent)


def main() -> None:
    """Print the table; an argument selects the cases whose names contain it."""
    if not (SHARED / "data" / "lidar").is_dir():
        raise SystemExit(f"{SHARED}/data/lidar is not here")
    score, wanted = scorer(), sys.argv[1] if len(sys.argv) > 1 else ""
    for sentence in lidar_peers.missing():
        print(sentence, flush=True)
    ours = (row(case, score) for case in cases() if wanted in case.name)
    for one in table(HEAD, chain(ours, peers(score, wanted))):
        print(one, flush=True)
    if wanted in ("", "aid"):
        lidar_aid.main()
    if wanted in ("", "radar"):
        lidar_radar.main(score)
    if wanted in ("", "live"):
        lidar_live.main()
    if wanted in ("", "memory"):
        lidar_memory.main()


if __name__ == "__main__":
    main()
