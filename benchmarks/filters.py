"""Print the tables of docs/FILTERS.md: every filter over the same recorded and simulated flights.

``make filters``. With ``--write FILE`` they go between the marks in that file, as those of
:mod:`benchmarks.accuracy` do.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.accuracy import DATA, insert
from benchmarks.campaign import RECEIVERS, SCENARIOS, each, fly
from benchmarks.cases import TRUTH
from benchmarks.matched import matched
from ekf_companion.analysis import comparison
from ekf_companion.analysis.comparison import Entry
from ekf_companion.config.config import Config
from ekf_companion.logs.estimate import read_truth
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.state import Trajectory
from ekf_companion.replay import convert
from sim_autopilot.flight import Flight

NAVIGATORS = ("eskf", "euler", "iterated", "iterated:robocentric", "ukf")
SEED = "seed-basicekf-sim"
ATTITUDES = ("ahrs", "vqf", "mahony", "ahrs:corrected", "ahrs:article")
WALKERS = ("zupt:shoe", "zupt:mv", "zupt:mag", "zupt:are")
TRIALS = {
    "01, slow rotation": "broad-attitude/01_undisturbed_slow_rotation_A.mat",
    "15, fast translation": "broad-attitude/15_undisturbed_fast_translation_A.mat",
}
WALKS = {
    "OpenShoe, 82 m": "zupt-openshoe/Measurement_100521_44.txt",
    "x-IO, 25 m": "zupt-xio-short-walk/short_walk.csv",
}
ABLATED = ("sitl-px4-square/flight.tlog", "sitl-px4-ulg/flight.ulg")
FLIGHTS = 3
"""Of each scenario and receiver in the campaign."""
DURATION = 120.0
"""s."""
SKIP = 30.0
"""s."""
DELAY_STD, HARD_IRON_STD = 0.02, 0.005
"""What the flights of the campaign are drawn with: s, gauss."""
ROWS = {
    "horizontal, m": ("north", "east"),
    "vertical, m": ("down",),
    "velocity, m/s": ("velocity north", "velocity east", "velocity down"),
    "roll, deg": ("roll",),
    "pitch, deg": ("pitch",),
    "yaw, deg": ("yaw",),
}


def recorded(data: Path) -> Iterator[str]:
    """Give RMS errors of all navigators on the flights with a truth."""
    for case in TRUTH:
        log = data / case.log
        if not log.is_file():
            print(f"{case.log}: absent, left out")
            continue
        recording = convert.read(log, Config())
        assert recording.truth is not None
        yield from (f"**{case.title}**", "")
        yield from _table(_judged(recording, NAVIGATORS, recording.truth))
        yield ""


def without(data: Path) -> Iterator[str]:
    """Give what our own estimator loses without each of the things that the others lack."""
    config = Config()
    cases = {
        "as it is": config,
        "without the barometer": replace(config, baro=replace(config.baro, use=False)),
        "without learnt noise": replace(config, imu=replace(config.imu, learn_noise=False)),
        "fixes taken for white": replace(
            config, gnss=replace(config.gnss, white_share=1.0, velocity_slow_std=0.0)
        ),
        "delay taken for known": replace(config, gnss=replace(config.gnss, delay_std=0.0)),
    }
    for case in TRUTH:
        if case.log not in ABLATED or not (data / case.log).is_file():
            continue
        recording = convert.read(data / case.log, config)
        assert recording.truth is not None
        yield from (f"**{case.title}**", "")
        rows = []
        for title, settings in cases.items():
            entries = comparison.run_filters(recording, ["eskf"], settings)
            rows += comparison.score_filters(entries, recording.truth, SKIP, None)
            rows[-1] = replace(rows[-1], name=title)
        yield from _table(rows)
        yield ""


def seed(data: Path) -> Iterator[str]:
    """Give RMS errors on the seed article's flight, and what the author's two slips cost."""
    folder = data / SEED
    if not folder.is_dir():
        print(f"{SEED}: absent, left out")
        return
    recording = convert.read(folder / "uavSensors.csv", Config())
    truth = read_truth(folder / "uavTruth.csv")
    names = ("eskf", "euler:article", "euler", "iterated", "iterated:robocentric", "ukf")
    yield from _table(_judged(recording, names, truth, 20.0))


def attitude(data: Path) -> Iterator[str]:
    """Give RMS errors of attitude alone against an optical truth."""
    yield "| total / heading / inclination, deg | " + " | ".join(ATTITUDES) + " |"
    yield "|---" * (len(ATTITUDES) + 1) + "|"
    for title, log in TRIALS.items():
        if not (data / log).is_file():
            print(f"{log}: absent, left out")
            continue
        recording = convert.read(data / log, Config())
        assert recording.truth is not None
        entries = comparison.run_filters(recording, ATTITUDES, Config())
        judged = comparison.score_filters(entries, recording.truth, 0.0, None, recording.counted)
        cells = [" / ".join(f"{value:.2f}" for value in one.rms.values()) for one in judged]
        yield f"| {title} | {' | '.join(cells)} |"


def walks(data: Path) -> Iterator[str]:
    """Give how far each detector's walks are from closing."""
    yield "| on the ground / in space, m | " + " | ".join(WALKERS) + " |"
    yield "|---" * (len(WALKERS) + 1) + "|"
    for title, log in WALKS.items():
        if not (data / log).is_file():
            print(f"{log}: absent, left out")
            continue
        entries = comparison.run_filters(convert.read(data / log, Config()), WALKERS, Config())
        cells = [
            f"{one.rms['closure on the ground']:.3f} / {one.rms['closure in space']:.3f}"
            for one in entries
        ]
        yield f"| {title} | {' | '.join(cells)} |"


def campaign(data: Path) -> Iterator[str]:
    """Give RMS errors and NEES over seeded flights, settings as the simulator's sensors are."""
    del data
    jobs = [
        (name, 1000 * i + luck, receiver)
        for receiver in RECEIVERS
        for i, name in enumerate(SCENARIOS)
        for luck in range(1, FLIGHTS + 1)
    ]
    results = each(fly_all, jobs, "filters, flights")
    for receiver in RECEIVERS:
        chosen = [found for job, found in zip(jobs, results, strict=True) if job[2] == receiver]
        yield from (f"**Receiver {receiver}: {len(chosen)} flights of {DURATION:.0f} s**", "")
        yield from _table([_mean(column) for column in zip(*chosen, strict=True)])
        yield ""


def fly_all(job: tuple[str, int, str]) -> list[Entry]:
    """Take every navigator through one simulated flight, and keep only the numbers."""
    flown = fly(*job, DURATION)
    settings = matched(flown.nominal, DELAY_STD, HARD_IRON_STD)
    recording = Recording(family="unknown", events=flown.events)
    entries = comparison.run_filters(recording, NAVIGATORS, settings)
    judged = comparison.score_filters(entries, _truth(flown.flight), SKIP, None)
    return [
        Entry(name=e.name, solution=None, trajectory=None, us=e.us, rms=e.rms, nees=e.nees)
        for e in judged
    ]


def _truth(flight: Flight) -> Trajectory:
    t_ns = np.arange(flight.first_ns, flight.first_ns + round(DURATION * 1e9), 20_000_000)
    now = flight.truth_at(t_ns)
    return Trajectory(
        name="truth",
        pos_t_ns=t_ns,
        lat=now.lat,
        lon=now.lon,
        alt=now.alt,
        vel_t_ns=t_ns,
        vel_n=now.vel_n,
        att_t_ns=t_ns,
        q_nb=now.q_nb,
    )


def _judged(
    recording: Recording, names: Sequence[str], truth: Trajectory, skip: float = SKIP
) -> list[Entry]:
    return comparison.score_filters(
        comparison.run_filters(recording, names, Config()), truth, skip, None
    )


def _mean(entries: Sequence[Entry]) -> Entry:
    """Give one filter's RMS over several flights, and its mean NEES."""
    first = entries[0]
    rms = {
        name: float(np.sqrt(np.mean([np.square(one.rms[name]) for one in entries])))
        for name in first.rms
    }
    nees = {name: float(np.mean([one.nees[name] for one in entries])) for name in first.nees}
    us = float(np.median([one.us for one in entries]))
    return Entry(name=first.name, solution=None, trajectory=None, us=us, rms=rms, nees=nees)


def _table(entries: Sequence[Entry]) -> Iterator[str]:
    """Give entries as the rows of a table."""
    yield "| filter | " + " | ".join(ROWS) + " | NEES position, velocity, attitude | us |"
    yield "|---" * (len(ROWS) + 3) + "|"
    for one in entries:
        cells = [
            f"{np.sqrt(sum(np.square(one.rms[part]) for part in parts)):.3f}"
            for parts in ROWS.values()
        ]
        sure = ", ".join(f"{one.nees[name]:.2f}" for name in ("position", "velocity", "attitude"))
        yield f"| {one.name} | {' | '.join(cells)} | {sure} | {one.us:.0f} |"


PARTS: dict[str, Callable[[Path], Iterator[str]]] = {
    "recorded": recorded,
    "without": without,
    "seed": seed,
    "campaign": campaign,
    "attitude": attitude,
    "walks": walks,
}


def main() -> None:
    """Print all parts, or write them into a document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="the recorded flights")
    parser.add_argument("--write", type=Path, metavar="FILE", help="a document with marks")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    asked = parser.parse_args()
    for name in asked.only:
        lines = "\n".join(PARTS[name](asked.data)).strip()
        if asked.write is None:
            print(f"\n## {name}\n\n{lines}")
        elif lines:
            document = asked.write.read_text(encoding="utf-8")
            asked.write.write_text(insert(document, name, lines), encoding="utf-8")


if __name__ == "__main__":
    main()
