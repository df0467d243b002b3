"""The way of a radar: a recorded walk that returns, simulated ones with truth, half a minute alone.

The recording is shared/data/radar-inertial-walk; it has no truth but that it ends where it began.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

from benchmarks import lidar_aid
from benchmarks.document import table
from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import BaroSettings
from ekf_companion.lidar.doppler import velocities
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.recording import InertialSamples, Mounting
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.solution import Solution, lines_of, solve
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.replay.pose_aid import PoseFile
from ekf_companion.review.convert import estimate
from sim_autopilot.lidar.radar import RadarErrors, simulate_radar
from sim_autopilot.lidar.record import Simulated
from sim_autopilot.lidar.write import write_sequence

RECORDED = Path(__file__).parents[2] / "shared" / "data" / "radar-inertial-walk" / "demo.bag"
PUBLISHED = Mounting(
    so3.to_matrix(so3.from_euler(*np.radians([-179.61, 9.09, -45.65]).tolist())),
    np.array([0.03, 0.03, -0.06]),
)
"""Of the recording's authors: christopherdoer/rio, calib_ti_mmwave_rospkg_dataset.yaml, turned from
right, forward, up to forward, left, up."""
RECORDED_HEAD = "recorded walk, 40 s | way, m | end from begin, m: level, height | % | own sigma, m"
HEAD = (
    "simulated | way, m | error at the end, %: RMS of seeds, worst | own sigma there, m | NEES, an "
    "axis: velocities of scans; position, rotation over 1 s; position since the start | ms a scan"
)
WORLDS = ("room", "forest", "street")
SEEDS = range(1, 5)
LENGTH = 40.0
MOVING = 0.3
"""Speed from which the NEES of velocities counts, m/s: at rest the step of the speeds hides all."""
FRAME = 0.5 * RadarErrors().frame
CUTS = (("forest", (9.0, 39.0)), ("street", (9.0, 39.0)))


def recorded_rows(folder: Path) -> Iterator[str]:
    """Yield rows of the recorded walk."""
    for name, mounting in (("mounting found", None), ("mounting as published", PUBLISHED)):
        solution = solve(recording := read(RECORDED, mounting=mounting), Settings())
        place, sigma = solution.poses[:, 1:4], f"{solution.sigma:.2f}"
        yield _returned(name, place, sigma)
    pose, log = folder / "pose.csv", folder / "log.csv"
    pose.write_text("\n".join(lines_of(solution, ".csv")) + "\n", encoding="utf-8")
    write_log(log, recording.inertial)
    found = estimate(log, Config(baro=BaroSettings(use=False)), None, PoseFile(pose))[0]
    place = found.columns(["pos_n", "pos_e", "pos_d"])
    sigmas = found.columns(["sd_pos_n", "sd_pos_e", "sd_pos_d"])
    known = np.isfinite(place).all(axis=1)
    sigma = f"{np.linalg.norm(sigmas[known][-1]):.2f}"
    yield _returned("through the main filter, without fixes", place[known], sigma)


def write_log(path: Path, inertial: InertialSamples) -> None:
    """Write inertial samples as the log of an autopilot: from its boot on, forward, right, down."""
    rows = np.column_stack(
        [
            inertial.stamp - inertial.stamp[0] + lidar_aid.BOOT,
            inertial.gyro * lidar_aid.DOWN,
            inertial.accel * lidar_aid.DOWN,
        ]
    )
    head = ",".join(lidar_aid.COLUMNS.split(",")[:7])
    np.savetxt(path, rows, "%.9g", delimiter=",", header=head, comments="")


def _returned(name: str, place: Array, sigma: str) -> str:
    # By steps of a tenth of a second: the inertial samples' own noise is no way
    steps = np.diff(place[:: max(1, len(place) // 400)], axis=0)
    way = float(np.linalg.norm(steps, axis=1).sum())
    away = place[-1] - place[0]
    level, height = float(np.hypot(*away[:2])), abs(float(away[2]))
    share = 100.0 * float(np.linalg.norm(away)) / way
    return f"{name} | {way:.1f} | {level:.2f}, {height:.2f} | {share:.1f} | {sigma}"


def rows(folder: Path, score: ModuleType) -> Iterator[str]:
    """Yield rows of simulated ways."""
    for world in WORLDS:
        ends, of_scans, of_position, ways, spent = [], [], [], [], []
        apart, sigmas = [], []
        for seed in SEEDS:
            flown = simulate_radar(world, seed, duration=LENGTH)
            write_sequence(folder / f"{world}{seed}", flown)
            recording = read(folder / f"{world}{seed}")
            begin = time.process_time()
            solution = solve(recording, Settings())
            spent.append(1e3 * (time.process_time() - begin) / len(flown.stamp))
            error, nees = judged(flown, solution)
            ways.append(solution.way)
            sigmas.append(solution.sigma)
            found = score.score_relative(str(folder / f"{world}{seed}"), solution.relatives())
            apart.append([found[f"nees_{kind}"]["mean"] for kind in ("position", "rotation")])
            ends.append(100.0 * float(np.linalg.norm(error[-1])) / solution.way)
            of_position.append(float(nees[60:].mean()))
            for one in velocities(recording.scans, Settings()):
                vel = true_velocity(flown, one.stamp)
                if not one.used or np.linalg.norm(vel) < MOVING:
                    continue
                miss = one.vel - vel
                of_scans.append(float(miss @ one.information @ miss) / 3.0)
        rms = float(np.sqrt(np.mean(np.square(ends))))
        span = ", ".join(f"{one:.2f}" for one in np.mean(apart, axis=0))
        yield (
            f"{world} | {np.mean(ways):.0f} | {rms:.2f}, {max(ends):.2f} | {np.mean(sigmas):.1f} | "
            f"{np.mean(of_scans):.2f}; {span}; "
            f"{np.mean(of_position):.2f} | {np.mean(spent):.1f}"
        )


def true_velocity(flown: Simulated, stamp: float) -> Array:
    """Return the true velocity of the radar in its own axes, in the middle of a scan, m/s."""
    t = np.array([stamp + FRAME])
    C, motion = flown.motion.rotation(t)[0], flown.motion
    turned = so3.cross(motion.gyro(t)[0], flown.lidar.position)
    return np.asarray(flown.lidar.rotation.T @ (C.T @ motion.velocity(t)[0] + turned))


def judged(flown: Simulated, solution: Solution) -> tuple[Array, Array]:
    """Return the errors of the positions since the first pose, and their NEES an axis."""
    t = solution.track.stamp
    place = flown.motion.position(t)
    truth = (place - place[0]) @ flown.motion.rotation(t[:1])[0]
    error, P = solution.track.pos_w - truth, solution.track.covariance[:, 3:6, 3:6]
    P = P + 1e-9 * np.eye(3)
    return error, np.einsum("ni,ni->n", error, np.linalg.solve(P, error[:, :, None])[:, :, 0]) / 3


def cut_rows(folder: Path) -> Iterator[str]:
    """Yield rows of flights with a radar whose fixes end for half a minute."""
    for world, cut in CUTS:
        sequence = folder / f"{world}-cut"
        write_sequence(sequence, simulate_radar(world, 9, duration=LENGTH + 2.0))
        solution = solve(read(sequence), Settings())
        pose = folder / f"{world}.csv"
        pose.write_text("\n".join(lines_of(solution, ".csv")) + "\n", encoding="utf-8")
        flight = lidar_aid.Flight.of(sequence)
        for name, file in (("none", None), ("radar", PoseFile(pose))):
            yield lidar_aid.row(world, name, flight, cut, folder / "log.csv", file)


def main(score: ModuleType) -> None:
    """Print the tables, by the scores of shared/tools/lidar_score.py."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        parts = [(HEAD, rows(folder, score)), (lidar_aid.HEAD, cut_rows(folder))]
        if RECORDED.is_file():
            parts.insert(0, (RECORDED_HEAD, recorded_rows(folder)))
        else:
            print(f"{RECORDED} is not here: left out")
        for head, lines in parts:
            for one in table(head, lines):
                print(one, flush=True)
