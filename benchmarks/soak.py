"""The hostile hour: every fault again and again in one flight, ``make soak``.

What is right is what the same flight shows without faults. A fault is over once its end has passed
and all errors stay inside that for two seconds.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.soak_flight import Array, Errors, Flown, Look, fly
from sim_autopilot.faults.fault import VARIETY, Fault, schedule

QUANTILE = 0.999
MARGIN = 1.5
"""Of the quiet flight's quantile."""
SETTLED = 60.0
"""Of the quiet flight this counts for nothing: alignment, take-off, what is learnt at first, s."""
GAP = 20.0
"""Quiet time after each fault, s."""
LARGEST_RECOVERY = 10.0
"""s."""
HOLD = 2.0
"""s."""
WARM_UP = 300.0
"""Memory is counted from here, s."""
LARGEST_GROWTH = 5.0
"""MB."""
LONGEST_QUEUE = 1024
"""Items in any container that the estimator holds."""
UNITS = ("position m", "velocity m/s", "tilt deg", "yaw deg")
_SCALE = np.array([1.0, 1.0, math.degrees(1.0), math.degrees(1.0)])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Episode:
    """What one fault did."""

    fault: Fault
    seed: int
    largest: Array
    """Position m, velocity m/s, tilt and yaw rad, from its begin until all was right again."""
    recovery: float
    """From its end until all errors stay inside the limits, s; inf: they never did."""
    resets: int


def normal(errors: Errors) -> Array:
    """Give the limits of what is right, from a flight without faults, shape (4,)."""
    return MARGIN * np.quantile(errors.size[errors.t > SETTLED], QUANTILE, axis=0)


def episodes(errors: Errors, faults: Sequence[Fault], limits: Array, seed: int) -> list[Episode]:
    """Look at each fault, up to the next."""
    starts = [*(fault.start for fault in faults), math.inf][1:]
    return [
        _episode(errors, fault, until, limits, seed)
        for fault, until in zip(faults, starts, strict=True)
    ]


def _episode(errors: Errors, fault: Fault, until: float, limits: Array, seed: int) -> Episode:
    after = (errors.t >= fault.end) & (errors.t < until)
    t = errors.t[after]
    is_right = (errors.size[after] <= limits).all(axis=1)
    wrong = np.append(t[~is_right], math.inf)
    following = wrong[np.searchsorted(wrong, t)]
    good = t[is_right & (following - t >= HOLD)]
    recovery = float(good[0] - fault.end) if len(good) else math.inf
    own = (errors.t >= fault.start) & (errors.t < min(until, fault.end + recovery))
    counts = errors.resets[(errors.t >= fault.start - 1.0) & (errors.t < until)]
    return Episode(
        fault=fault,
        seed=seed,
        largest=errors.size[own].max(axis=0) if own.any() else np.full(4, math.nan),
        recovery=recovery,
        resets=int(counts.max() - counts.min()) if len(counts) else 0,
    )


def label(fault: Fault) -> str:
    """Give a fault without its time: variants are told apart by what is not their default."""
    said = [
        f"{key}={value if isinstance(value, str) else format(value, 'g')}"
        for key, value in fault.values.items()
        if value != getattr(fault.kind.values[key], "default", _first(fault, key))
    ]
    return fault.kind.name + (":" + ",".join(said) if said else "")


def _first(fault: Fault, key: str) -> object:
    return getattr(fault.kind.values[key], "words", (None,))[0]


def table(found: Sequence[Episode]) -> Iterator[str]:
    """Give a table by kind of fault, in markdown."""
    yield f"| fault | n | {' | '.join(UNITS)} | recovery median s | worst s | resets |"
    yield "|---" + "|---:" * 8 + "|"
    for name in sorted({label(one.fault) for one in found}):
        of_it = [one for one in found if label(one.fault) == name]
        sizes = np.stack([one.largest for one in of_it])
        largest = np.nanmax(sizes, axis=0) * _SCALE if not np.isnan(sizes).all() else sizes[0]
        recoveries = [one.recovery for one in of_it]
        cells = [
            *(f"{value:.2f}" if value < 10.0 else f"{value:.0f}" for value in largest),
            *(f"{value:.1f}" for value in (float(np.median(recoveries)), max(recoveries))),
        ]
        resets = sum(one.resets for one in of_it)
        yield f"| `{name}` | {len(of_it)} | {' | '.join(cells)} | {resets} |"


def growth(looks: Sequence[Look]) -> float:
    """Give by how much memory grew after the warm-up, MB: the last tenth over the first."""
    after = [one.resident for one in looks if one.t >= WARM_UP]
    if len(after) < 20:
        return 0.0
    tenth = len(after) // 10
    return float(np.median(after[-tenth:]) - np.median(after[:tenth]))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Hour:
    """One flight and what is to be said of it."""

    personality: str
    seed: int
    limits: Array
    found: list[Episode]
    looks: list[Look]
    cpu: float
    """s."""

    @property
    def is_good(self) -> bool:
        """Whether it all held."""
        late = [one for one in self.found if not one.recovery <= LARGEST_RECOVERY]
        largest = max(one.largest for one in self.looks)
        return not late and growth(self.looks) < LARGEST_GROWTH and largest <= LONGEST_QUEUE

    def say(self) -> Iterator[str]:
        """Say it in lines."""
        largest = max(self.looks, key=lambda one: one.largest)
        limits = ", ".join(
            f"{unit} {value:.2f}"
            for unit, value in zip(UNITS, self.limits * _SCALE, strict=True)
        )
        yield f"{self.personality} seed {self.seed}: {len(self.found)} faults, {self.cpu:.0f} s CPU"
        yield f"  right is {limits}"
        yield (
            f"  memory {growth(self.looks):+.2f} MB; largest container {largest.where} "
            f"with {largest.largest}; {max(one.waiting for one in self.looks)} events waiting"
        )
        for one in self.found:
            if not one.recovery <= LARGEST_RECOVERY:
                sizes = " ".join(f"{value:.2f}" for value in one.largest * _SCALE)
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
    """Fly it without faults, then with all of them."""
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


def main() -> None:
    """Fly the hours and say what came of them; exit 1 where something did not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--personality", nargs="+", default=["px4", "ardupilot"])
    parser.add_argument("--write", type=Path, help="put the tables into this page")
    asked = parser.parse_args()
    logging.disable(logging.CRITICAL)
    hours: list[Hour] = []
    for personality in asked.personality:
        for seed in asked.seeds:
            hours.append(hour(personality, seed, asked.hours * 3600.0))
            print("\n".join(hours[-1].say()), flush=True)
        of_it = [one for own in hours if own.personality == personality for one in own.found]
        print("\n".join(table(of_it)), flush=True)
    sys.exit(0 if all(one.is_good for one in hours) else 1)


if __name__ == "__main__":
    main()
