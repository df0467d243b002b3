"""What one asks of a fleet: the worst flights, a receiver's noise, whether a version is better.

Each answer is a :class:`Answer`, a table of few columns with the sentences that go with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ekf_companion.errors import ConfigError, part_of
from ekf_companion.logs.recording import counted
from ekf_companion.nav.arrays import Array

GRADES = ("good", "fair", "short", "slow", "attitude only", "poor")
"""From the best to the worst."""
COMPARED = (
    "truth_horizontal_m",
    "truth_vertical_m",
    "truth_velocity_mps",
    "truth_tilt_deg",
    "truth_yaw_deg",
    "autopilot_horizontal_m",
    "autopilot_vertical_m",
    "autopilot_velocity_mps",
    "autopilot_tilt_deg",
    "autopilot_yaw_deg",
    "degraded_s",
    "dead_reckoning_s",
    "invalid_s",
    "resets",
)
"""Columns of which less is better."""
GROUPS = ("airframe", "receiver", "firmware", "hardware", "autopilot", "vehicle")
"""Columns by which flights can be grouped."""
NOISES = ("gyro_noise_rps", "accel_noise_mps2", "gnss_delay_s", "imu_hz", "gnss_hz")
LEAST_SHARE = 0.001
"""Relative difference of two numbers of one log that counts as one: other roundings are none."""
SURE = 0.05
"""Probability that chance alone makes a family of differences look significant."""
MOST_NAMED = 3


@dataclass(frozen=True, slots=True)
class Answer:
    """A table, and what is to be said with it."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    notes: Sequence[str] = field(default=())

    def to_dict(self) -> dict[str, Any]:
        """Return everything for JSON."""
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return {"rows": rows, "notes": list(self.notes)}

    def lines(self) -> list[str]:
        """Return the table in columns of equal width, then the notes."""
        cells = [[_cell(one) for one in row] for row in (self.columns, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        padded = ([c.ljust(w) for c, w in zip(row, widths, strict=True)] for row in cells)
        return [*("  ".join(row).rstrip() for row in padded), *self.notes]


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def worst(logs: Any, count: int = 20) -> Answer:
    """Return the flights with the worst verdicts and why, the worst first.

    Within a grade the one comes first that was longest not good.
    """
    rows = []
    for one in logs.to_pylist():
        if one["outcome"] == "estimated":
            bad = sum(
                one[f"{status}_s"] or 0.0 for status in ("degraded", "dead_reckoning", "invalid")
            )
            grade = one["grade"] if one["grade"] in GRADES else GRADES[-1]
            error = one["truth_horizontal_m"] or one["autopilot_horizontal_m"]
            order = (-GRADES.index(grade), -bad, one["log"])
            rows.append((order, (one["log"], grade, bad, one["resets"], error, one["verdict"])))
    columns = ("log", "grade", "not_ok_s", "resets", "horizontal_m", "verdict")
    by_grade = [f"{sum(r[1][1] == g for r in rows)} {g}" for g in GRADES]
    failed = sum(one != "estimated" for one in logs.column("outcome").to_pylist())
    notes = (f"{counted(len(rows), 'flight')}: {', '.join(by_grade)}; {failed} not estimated",)
    return Answer(columns, [row for _, row in sorted(rows, key=lambda r: r[0])[:count]], notes)


def noise(logs: Any, by: Sequence[str] = GROUPS[:3]) -> Answer:
    """Return the learnt noise, the delay and the rates of each group of flights.

    They are medians, and of noise and delay the fifth and ninety-fifth percentile too.

    Raises:
        ConfigError: There is no such column to group by.
    """
    if unknown := {*by} - {*GROUPS}:
        raise ConfigError(f"--by: {sorted(unknown)[0]}: is none of {', '.join(GROUPS)}")
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for one in logs.to_pylist():
        if one["outcome"] == "estimated":
            groups.setdefault(tuple(one[name] or "" for name in by), []).append(one)
    columns = [*by, "flights"]
    for name in NOISES:
        columns += [name, f"{name}_p05", f"{name}_p95"] if name in NOISES[:3] else [name]
    rows = []
    for names, flights in sorted(groups.items()):
        row: list[Any] = [*names, len(flights)]
        for name in NOISES:
            values = np.array([f[name] for f in flights if f[name] is not None], dtype=float)
            levels = [50.0, 5.0, 95.0] if name in NOISES[:3] else [50.0]
            row += np.percentile(values, levels).tolist() if len(values) else [None] * len(levels)
        rows.append(row)
    return Answer(columns, rows)


def compare(before: Any, after: Any) -> Answer:
    """Return what differs between two runs over the same logs, paired by log.

    For each column: how many logs are better (less), worse and equal, the median of the relative
    change, and the probability of such a difference if neither were better: Wilcoxon's signed-rank
    test, corrected by Holm for the number of columns. Logs are paired by content, else by name.

    Raises:
        ConfigError: The two have no log in common.
        MissingPackageError: SciPy is not installed.
    """
    with part_of("fleet", "compare"):
        from scipy.stats import wilcoxon
    pairs = _pairs(before.to_pylist(), after.to_pylist())
    if not pairs:
        raise ConfigError("the two have no log in common, by content or by name")
    found = []
    for name in COMPARED:
        values = [
            (a[name], b[name]) for a, b in pairs if a["outcome"] == b["outcome"] == "estimated"
        ]
        both = [(a or 0.0, b or 0.0) for a, b in values if not (a is None and b is None)]
        if name.startswith(("truth", "autopilot")):
            both = [(a, b) for a, b in values if a is not None and b is not None]
        if not both:
            continue
        a, b = np.array(both, dtype=float).T
        change = np.where(_differ(a, b), b - a, 0.0)
        p = float(wilcoxon(change).pvalue) if np.count_nonzero(change) > 1 else 1.0
        found.append([name, a, b, change, p])
    corrected = _holm([row[-1] for row in found])
    rows = [_compared(row, p) for row, p in zip(found, corrected, strict=True)]
    columns = (
        "column",
        "logs",
        "better",
        "worse",
        "equal",
        "median_before",
        "median_after",
        "p",
        "",
    )
    return Answer(columns, rows, _notes(pairs, len(before), len(after)))


def _differ(a: Array, b: Array) -> Any:
    return np.abs(b - a) > LEAST_SHARE * np.maximum(np.abs(a), np.abs(b))


def _compared(row: Sequence[Any], p: float) -> list[Any]:
    name, a, b, change, _ = row
    better, worse = int((change < 0.0).sum()), int((change > 0.0).sum())
    word = "" if p > SURE else "better" if better > worse else "worse"
    equal = len(change) - better - worse
    return [
        name,
        len(change),
        better,
        worse,
        equal,
        float(np.median(a)),
        float(np.median(b)),
        p,
        word,
    ]


def _pairs(
    before: Sequence[Mapping[str, Any]], after: Sequence[Mapping[str, Any]]
) -> list[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    """Pair the rows by content and name, else by name alone."""

    def key(row: Mapping[str, Any], is_by_content: bool) -> tuple[str, ...]:
        return (row["log"], row["content"]) if is_by_content else (row["log"],)

    has_content = all(row["content"] for row in (*before[:1], *after[:1]))
    ours = {key(row, has_content): row for row in before}
    return [(ours[key(row, has_content)], row) for row in after if key(row, has_content) in ours]


def _holm(p: Sequence[float]) -> list[float]:
    """Return probabilities corrected for their number.

    Source: Holm 1979, Scandinavian Journal of Statistics 6, 2.
    """
    order, largest = np.argsort(p), 0.0
    corrected = [1.0] * len(p)
    for place, index in enumerate(order.tolist()):
        largest = max(largest, min((len(p) - place) * p[index], 1.0))
        corrected[index] = largest
    return corrected


def _notes(
    pairs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]], before: int, after: int
) -> list[str]:
    notes = [f"{counted(len(pairs), 'log')} in both, of {before} before and {after} after"]
    ends = [
        (b["log"], a["outcome"], b["outcome"]) for a, b in pairs if a["outcome"] != b["outcome"]
    ]
    grades = [
        (b["log"], a["grade"], b["grade"])
        for a, b in pairs
        if a["grade"] in GRADES and b["grade"] in GRADES and a["grade"] != b["grade"]
    ]
    better = [one for one in grades if GRADES.index(one[2]) < GRADES.index(one[1])]
    worse = [one for one in grades if one not in better]
    for what, some in (("end otherwise", ends), ("better", better), ("worse", worse)):
        named = "; ".join(f"{log} ({a} to {b})" for log, a, b in some[:MOST_NAMED])
        more = f" and {len(some) - MOST_NAMED} more" if len(some) > MOST_NAMED else ""
        notes.append(f"{len(some)} verdicts {what}{': ' if some else ''}{named}{more}")
    return notes


def to_arrow(answer: Answer) -> Any:
    """Return an answer as a ``pyarrow.Table``."""
    import pyarrow as pa

    columns = list(zip(*answer.rows, strict=True)) or [() for _ in answer.columns]
    names = [name or "word" for name in answer.columns]
    return pa.table({name: pa.array(one) for name, one in zip(names, columns, strict=True)})
