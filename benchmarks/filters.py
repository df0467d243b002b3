"""Print the tables of docs/FILTERS.md: every filter over the same recorded and simulated flights.

``make filters``. With ``--write FILE`` they go between the marks in that file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import document
from benchmarks.campaign import (
    DELAY_STD,
    HARD_IRON_STD,
    RECEIVERS,
    SCENARIOS,
    each,
    fly,
)
from benchmarks.document import Part, is_there, of_flights, of_logs, table
from benchmarks.gaps import gaps
from benchmarks.matched import matched
from benchmarks.recorded import TRUTH, recorded
from ekf_companion.analysis import comparison
from ekf_companion.analysis.comparison import Entry
from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.logs.estimate import read_truth
from ekf_companion.logs.recording import Recording
from sim_autopilot import events as wire

NAVIGATORS = ("eskf", "euler", "iterated", "ukf")
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
ABLATED = "PX4 square (.tlog)"
FLIGHTS = 3
"""Of each scenario and receiver in the campaign."""
DURATION = 120.0
"""s."""
SKIP = 30.0
"""s."""
ROWS = {
    "horizontal, m": ("north", "east"),
    "vertical, m": ("down",),
    "velocity, m/s": ("velocity north", "velocity east", "velocity down"),
    "roll, deg": ("roll",),
    "pitch, deg": ("pitch",),
    "yaw, deg": ("yaw",),
}


def navigators(data: Path) -> Iterator[str]:
    """Yield RMS errors of all navigators on the flights with a truth."""
    return _table(
        "log",
        {
            case.title: _judged(recorded(data / case.log), NAVIGATORS)
            for case in TRUTH
            if is_there(data, case.log)
        },
    )


def without(data: Path) -> Iterator[str]:
    """Yield what our own estimator loses without each of the things that the others lack."""
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
    log = next(case.log for case in TRUTH if case.title == ABLATED)
    if not is_there(data, log):
        return iter(())
    recording = recorded(data / log)
    rows = [
        replace(_judged(recording, ["eskf"], config=settings)[0], name=title)
        for title, settings in cases.items()
    ]
    return _table("log", {ABLATED: rows})


def seed(data: Path) -> Iterator[str]:
    """Yield RMS errors on the seed article's flight."""
    if not is_there(data, SEED):
        return iter(())
    recording = replace(
        recorded(data / SEED / "uavSensors.csv"), truth=read_truth(data / SEED / "uavTruth.csv")
    )
    names = ("eskf", "euler:article", "euler", "iterated", "ukf")
    return _table("draw", {"42": _judged(recording, names, skip=20.0)})


def attitude(data: Path) -> Iterator[str]:
    """Yield RMS errors of attitude alone against an optical truth."""
    rows = []
    for title, log in TRIALS.items():
        if is_there(data, log):
            recording = recorded(data / log)
            assert recording.truth is not None
            entries = comparison.run_filters(recording, ATTITUDES, Config())
            judged = comparison.score_filters(
                entries, recording.truth, 0.0, None, recording.counted
            )
            cells = [" / ".join(f"{value:.2f}" for value in one.rms.values()) for one in judged]
            rows.append(" | ".join([title, *cells]))
    return table(" | ".join(["total / heading / inclination, deg", *ATTITUDES]), rows)


def walks(data: Path) -> Iterator[str]:
    """Yield the closure errors of each detector's walks."""
    rows = []
    for title, log in WALKS.items():
        if is_there(data, log):
            entries = comparison.run_filters(recorded(data / log), WALKERS, Config())
            cells = [
                f"{one.rms['closure on the ground']:.3f} / {one.rms['closure in space']:.3f}"
                for one in entries
            ]
            rows.append(" | ".join([title, *cells]))
    return table(" | ".join(["on the ground / in space, m", *WALKERS]), rows)


def campaign(runs: int | None = None) -> Iterator[str]:
    """Yield RMS errors and NEES over seeded flights, settings as the simulator's sensors are."""
    jobs = [
        (name, 1000 * i + luck, receiver)
        for receiver in RECEIVERS
        for i, name in enumerate(SCENARIOS)
        for luck in range(1, (runs or FLIGHTS) + 1)
    ]
    results = each(fly_all, jobs, "filters, flights")
    chosen = {
        receiver: [found for job, found in zip(jobs, results, strict=True) if job[2] == receiver]
        for receiver in RECEIVERS
    }
    return _table(
        f"receiver, flights of {DURATION:.0f} s",
        {
            f"{receiver}, {len(flights)}": [_mean(column) for column in zip(*flights, strict=True)]
            for receiver, flights in chosen.items()
        },
    )


def fly_all(job: tuple[str, int, str]) -> list[Entry]:
    """Run every navigator over one simulated flight, and return only the numbers."""
    flown = fly(*job, DURATION)
    settings = matched(flown.nominal, DELAY_STD, HARD_IRON_STD)
    recording = Recording(family="unknown", events=flown.events, truth=wire.truth(flown.flight))
    return [
        replace(one, solution=None, trajectory=None)
        for one in _judged(recording, NAVIGATORS, config=settings)
    ]


def _judged(
    recording: Recording,
    names: Sequence[str],
    *,
    config: FilterSettings | None = None,
    skip: float = SKIP,
) -> list[Entry]:
    """Run filters over a recording and compare them with its truth."""
    assert recording.truth is not None
    entries = comparison.run_filters(recording, names, config or Config())
    return comparison.score_filters(entries, recording.truth, skip, None)


def _mean(entries: Sequence[Entry]) -> Entry:
    """Return one filter's RMS over several flights, and its mean NEES."""
    first = entries[0]
    rms = {
        name: float(np.sqrt(np.mean([np.square(one.rms[name]) for one in entries])))
        for name in first.rms
    }
    nees = {name: float(np.mean([one.nees[name] for one in entries])) for name in first.nees}
    us = float(np.median([one.us for one in entries]))
    return Entry(name=first.name, solution=None, trajectory=None, us=us, rms=rms, nees=nees)


def _table(kind: str, groups: Mapping[str, Iterable[Entry]]) -> Iterator[str]:
    """Return one table; a group is named in its first row."""
    rows = []
    for group, entries in groups.items():
        title = group
        for one in entries:
            cells = [
                f"{np.sqrt(sum(np.square(one.rms[part]) for part in parts)):.3f}"
                for parts in ROWS.values()
            ]
            nees = ", ".join(
                f"{one.nees[name]:.2f}" for name in ("position", "velocity", "attitude")
            )
            rows.append(" | ".join([title, one.name, *cells, nees, f"{one.us:.0f}"]))
            title = ""
    head = [kind, "filter", *ROWS, "NEES position, velocity, attitude", "us"]
    return table(" | ".join(head), rows)


PARTS: dict[str, Part] = {
    "recorded": of_logs(navigators),
    "without": of_logs(without),
    "seed": of_logs(seed),
    "campaign": of_flights(campaign),
    "attitude": of_logs(attitude),
    "walks": of_logs(walks),
    "gaps": of_logs(gaps),
}


if __name__ == "__main__":
    document.main(__doc__, PARTS)
