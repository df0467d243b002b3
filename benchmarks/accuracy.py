"""Print the tables of docs/ACCURACY.md, from recorded and simulated flights: ``make accuracy``.

With ``--write FILE`` they go between the marks ``<!-- name -->`` and ``<!-- end -->`` in that file.
A log that is not there is said to be absent; a whole table without logs leaves the file as it is.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy.typing as npt

from benchmarks import (
    arrival,
    compassless,
    consistency,
    copter,
    evidence,
    lies,
    outages,
    seed,
)
from benchmarks.cases import AUTOPILOT, POOR, TRUTH, Case, estimate
from ekf_companion.analysis import score
from ekf_companion.analysis.score import Score, Spread
from ekf_companion.errors import CompanionError
from ekf_companion.logs.estimate import to_trajectory
from ekf_companion.nav.state import COLUMNS

DATA = Path("../shared/data")
QUANTITIES = (
    ("horizontal, m", "horizontal", 1.0),
    ("vertical, m", "vertical", 1.0),
    ("velocity, m/s", "velocity", 1.0),
    ("roll, deg", "roll", 57.29577951308232),
    ("pitch, deg", "pitch", 57.29577951308232),
    ("yaw, deg", "yaw", 57.29577951308232),
)


def scores(data: Path, case: Case) -> list[Score]:
    """Compare as ``ekf-companion compare`` does: ours, then the autopilot's own where truth is."""
    table, _, own, truth = estimate(data / case.log)
    columns: dict[str, npt.NDArray[Any]] = {"time_us": table.stamp_ns // 1000}
    columns |= {name: table.column(name) for name in COLUMNS[1:]}
    ours = to_trajectory(columns, "ekf-companion")
    against = truth if truth is not None else own
    assert against is not None, f"{case.log} holds nothing to compare with"
    skip = case.skip if case.skip is not None else 20.0 if truth is None else 30.0
    end = None if case.until is None else int(ours.att_t_ns[0]) + round(case.until * 1e9)
    result = [score.score(ours, against, skip, end_ns=end)]
    if truth is not None and own is not None:
        result.append(score.score(own, truth, 0.0, start_ns=result[0].start_ns, end_ns=end))
    return result


def against_autopilot(data: Path) -> Iterator[str]:
    """Give RMS (and largest) differences from the autopilot's estimate."""
    yield from _header("log")
    for case in AUTOPILOT:
        if _is_there(data, case.log):
            yield _row(case.title, scores(data, case)[0])


def against_truth(data: Path) -> Iterator[str]:
    """Give RMS (and largest) errors, ours above the autopilot's own."""
    yield from _header("log, RMS (largest)")
    for case in TRUTH:
        if _is_there(data, case.log):
            ours, own = scores(data, case)
            yield _row(f"{case.title}: ours", ours)
            yield _row(f"{case.title}: {own.estimate.partition(' (')[0]}", own)


def printed(data: Path) -> Iterator[str]:
    """Give what ``ekf-companion compare`` prints, log by log."""
    for case in (*AUTOPILOT, *TRUTH):
        if _is_there(data, case.log):
            yield from (f"`{case.command}`", "", "```")
            yield from score.table(scores(data, case))
            yield from ("```", "")


def poor(data: Path) -> Iterator[str]:
    """Give what is said of logs that lack something."""
    yield "| log | what can be estimated | what is said |"
    yield "|---|---|---|"
    for log in POOR:
        if _is_there(data, log):
            try:
                report = estimate(data / log)[1]
            except CompanionError as error:
                sentence = str(error).removeprefix(f"{data / log}: ")
                yield f"| {Path(log).parent} | exit code 3 | {sentence} |"
                continue
            spent = ", ".join(
                f"{each.name.lower()} {s:.0f} s" for each, s in report.seconds.items()
            )
            yield f"| {Path(log).parent} | {spent} | {'; '.join(report.notes) or '-'} |"


PARTS: dict[str, Callable[[Path], Iterator[str]]] = {
    "autopilot": against_autopilot,
    "truth": against_truth,
    "magnetometers": evidence.magnetometers,
    "yaw resets": evidence.yaw_resets,
    "judge": copter.judge,
    "trims": copter.trims,
    "crash": copter.crash,
    "poor": poor,
    "printed": printed,
}
"""Made from the recorded flights alone."""
CAMPAIGNS: dict[str, Callable[[Path, int | None], Iterator[str]]] = {
    "consistency": consistency.tables,
    "seed": seed.tables,
    "outages": outages.tables,
    "lies": lies.tables,
    "arrival": arrival.tables,
    "compassless": compassless.tables,
}
"""Made from many simulated flights; told how many of each kind."""


def main() -> None:
    """Print all parts, or write them into a document."""
    names = [*PARTS, *CAMPAIGNS]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="the recorded flights")
    parser.add_argument("--write", type=Path, metavar="FILE", help="a document with marks")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=names, default=names)
    parser.add_argument("--runs", type=int, help="simulated flights of each kind in a campaign")
    asked = parser.parse_args()
    has_data = asked.data.is_dir()
    if not has_data:
        print(f"{asked.data}: the recorded flights are not here; name their folder with --data")
    document = asked.write.read_text(encoding="utf-8") if asked.write else ""
    for name in asked.only:
        if name in PARTS and not has_data:
            continue
        part = PARTS[name](asked.data) if name in PARTS else CAMPAIGNS[name](asked.data, asked.runs)
        lines = "\n".join(part).strip()
        if asked.write is None:
            print(f"\n## {name}\n\n{lines}")
        elif lines.count("\n") > 1:
            document = insert(document, name, lines)
            asked.write.write_text(document, encoding="utf-8")


def insert(document: str, name: str, lines: str) -> str:
    """Put lines between the marks of a name."""
    marks = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    return marks.sub(lambda match: f"{match[1]}{lines}\n{match[2]}", document)


def _is_there(data: Path, log: str) -> bool:
    if not (data / log).is_file():
        print(f"{log}: absent, left out")
        return False
    return True


def _header(first: str) -> Iterator[str]:
    yield f"| {first} | " + " | ".join(name for name, _, _ in QUANTITIES) + " |"
    yield "|---" * (len(QUANTITIES) + 1) + "|"


def _row(title: str, score: Score) -> str:
    cells = []
    for _, attribute, scale in QUANTITIES:
        spread: Spread | None = getattr(score, attribute)
        cells.append(f"{spread.rms * scale:.2f} ({spread.largest * scale:.2f})" if spread else "-")
    return f"| {title} | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
