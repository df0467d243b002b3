"""Fly for hours with every fault again and again: ``make soak``.

Errors are normal if they are within those of the same flight without faults. The estimate has
recovered once all errors have stayed normal for two seconds after a fault's end.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.document import write
from benchmarks.reliability.soak_daemon import Minute, minute
from benchmarks.reliability.soak_flight import Flown, Look, fly
from benchmarks.reliability.soak_score import (
    SCALE,
    UNITS,
    Episode,
    episodes,
    label,
    normal,
    rows,
    unnoticed,
)
from ekf_companion.nav.arrays import Array
from sim_autopilot.faults.fault import VARIETY, schedule

GAP = 45.0
"""Quiet time after each fault, s: longer than any recovery."""
LARGEST_RECOVERY = 10.0
"""s."""
REACHABLE = {
    ("px4", "reboot"): 20.0,
    ("px4", "gnss-drag"): 40.0,
    ("ardupilot", "gnss-drag"): 40.0,
}
"""Where that is not possible, s; docs/RELIABILITY.md says why."""
WARM_UP = 300.0
"""Memory is counted from here, s."""
LARGEST_GROWTH = 5.0
"""MB."""
LONGEST_QUEUE = 1024
"""Items in any container that the estimator holds."""


def growth(looks: Sequence[Look]) -> float:
    """Return the growth of memory after the warm-up, MB: the last tenth over the first."""
    after = [one.resident for one in looks if one.t >= WARM_UP]
    if len(after) < 20:
        return 0.0
    tenth = len(after) // 10
    return float(np.median(after[-tenth:]) - np.median(after[:tenth]))


def late(personality: str, found: Sequence[Episode]) -> list[Episode]:
    """Return the faults from which the estimate recovered too late."""
    return [
        one
        for one in found
        if not one.recovery <= REACHABLE.get((personality, label(one.fault)), LARGEST_RECOVERY)
    ]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Hour:
    """One flight and its score."""

    personality: str
    seed: int
    limits: Array
    found: list[Episode]
    looks: list[Look]
    cpu: float
    """s."""

    @property
    def late(self) -> list[Episode]:
        """The faults from which the estimate recovered too late."""
        return late(self.personality, self.found)

    @property
    def is_good(self) -> bool:
        """Whether all limits were kept."""
        largest = max(one.largest for one in self.looks)
        return not self.late and growth(self.looks) < LARGEST_GROWTH and largest <= LONGEST_QUEUE

    def lines(self) -> Iterator[str]:
        """Yield a summary."""
        largest = max(self.looks, key=lambda one: one.largest)
        limits = ", ".join(
            f"{unit} {value:.2f}" for unit, value in zip(UNITS, self.limits * SCALE, strict=True)
        )
        yield f"{self.personality} seed {self.seed}: {len(self.found)} faults, {self.cpu:.0f} s CPU"
        yield f"  normal is {limits}"
        yield (
            f"  memory {growth(self.looks):+.2f} MB; largest container {largest.where} "
            f"with {largest.largest}; {max(one.waiting for one in self.looks)} events waiting"
        )
        for one in self.late:
            sizes = " ".join(f"{value:.2f}" for value in one.largest * SCALE)
            yield f"  late: {one.fault} {one.recovery:.1f} s, {sizes}, resets {one.resets}"


def hour(
    personality: str,
    seed: int,
    duration: float,
    *,
    quiet: Flown | None = None,
    kinds: Sequence[str] = VARIETY,
    gap: float = GAP,
) -> Hour:
    """Fly without faults, then with all of them."""
    began = time.process_time()
    limits = normal((quiet or fly(personality, seed, duration)).errors)
    faults = schedule(kinds, seed, duration, gap)
    flown = fly(personality, seed, duration, faults)
    return Hour(
        personality=personality,
        seed=seed,
        limits=limits,
        found=episodes(flown.errors, faults, limits, seed),
        looks=flown.looks,
        cpu=time.process_time() - began,
    )


def page(hours: Sequence[Hour], live: Minute | None) -> Iterator[str]:
    """Yield the measured part of docs/RELIABILITY.md."""
    for personality in dict.fromkeys(one.personality for one in hours):
        own = [one for one in hours if one.personality == personality]
        seeds = ", ".join(str(one.seed) for one in own)
        found = [one for hour in own for one in hour.found]
        limits = np.max([one.limits for one in own], axis=0)
        quiet = unnoticed(found, limits)
        yield f"### {personality}, seeds {seeds}"
        yield ""
        sizes = ", ".join(
            f"{unit} {size:.2f}" for unit, size in zip(UNITS, limits * SCALE, strict=True)
        )
        counts = Counter(label(one.fault) for one in found).values()
        yield f"Normal is, at most: {sizes}."
        yield f"Each fault came {min(counts)} to {max(counts)} times."
        if quiet:
            yield f"Errors stay normal during {', '.join(f'`{name}`' for name in quiet)}."
        yield ""
        yield from rows([one for one in found if label(one.fault) not in quiet])
        yield ""
        yield (
            f"Memory over the hour: {max(growth(one.looks) for one in own):+.2f} MB at most; "
            f"largest container: {max(look.largest for one in own for look in one.looks)} items; "
            f"{max(one.cpu for one in own):.0f} s of CPU for the hour and its quiet twin."
        )
        yield ""
    if live is not None:
        yield "### The daemon, over UDP, in real time"
        yield ""
        yield from rows(live.found)
        yield ""
        yield f"Resident memory, largest: {live.memory:.0f} MB."


def main() -> None:
    """Fly the hours and print their scores; exit 1 if a limit was exceeded."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--personality", nargs="+", default=["px4", "ardupilot"])
    parser.add_argument("--daemon", action="store_true", help="and the daemon, in real time")
    parser.add_argument("--write", type=Path, help="put the tables into this page")
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    live = minute() if asked.daemon else None
    hours: list[Hour] = []
    for personality in asked.personality:
        for seed in asked.seeds:
            hours.append(hour(personality, seed, asked.hours * 3600.0))
            print("\n".join(hours[-1].lines()), flush=True)
    measured = "\n".join(page(hours, live)).strip()
    print(measured)
    if asked.write is not None:
        write(asked.write, "soak", measured)
    is_good = all(one.is_good for one in hours)
    if live is not None:
        is_good = is_good and not late("px4", live.found) and not live.has_exited
    sys.exit(0 if is_good else 1)


if __name__ == "__main__":
    main()
