"""Print the tables of docs/accuracy, from recorded and simulated flights: ``make accuracy``.

``--write docs/accuracy`` puts them between the marks ``<!-- name -->`` and ``<!-- end -->`` there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy.typing as npt

from benchmarks import document
from benchmarks.accuracy import (
    compassless,
    consistency,
    four_imus,
    outages,
    receiver_faults,
    seed,
)
from benchmarks.document import Part, is_there, of_flights, of_logs, table
from benchmarks.recorded import AUTOPILOT, POOR, TRUTH, Case, estimate
from ekf_companion.analysis import score
from ekf_companion.analysis.score import Score, Spread
from ekf_companion.errors import CompanionError
from ekf_companion.logs.estimate import to_trajectory
from ekf_companion.nav.state import COLUMNS

QUANTITIES = {
    "horizontal, m": ("horizontal", 1.0),
    "vertical, m": ("vertical", 1.0),
    "velocity, m/s": ("velocity", 1.0),
    "roll, deg": ("roll", 57.29577951308232),
    "pitch, deg": ("pitch", 57.29577951308232),
    "yaw, deg": ("yaw", 57.29577951308232),
}


def scores(data: Path, case: Case) -> list[Score]:
    """Compare as ``ekf-companion compare`` does: ours, then the autopilot's own where truth is."""
    estimates, report = estimate(data / case.log)
    own, truth = report.own, report.truth
    columns: dict[str, npt.NDArray[Any]] = {"time_us": estimates.stamp_ns // 1000}
    columns |= {name: estimates.column(name) for name in COLUMNS[1:]}
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
    """Yield RMS (and largest) differences from the autopilot's estimate."""
    rows = (
        _row(case.title, scores(data, case)[0]) for case in AUTOPILOT if is_there(data, case.log)
    )
    return table(" | ".join(["log", *QUANTITIES]), rows)


def against_truth(data: Path) -> Iterator[str]:
    """Yield RMS (and largest) errors, ours above the autopilot's own."""
    rows = []
    for case in TRUTH:
        if is_there(data, case.log):
            ours, own = scores(data, case)
            rows.append(_row(f"{case.title}: ours", ours))
            rows.append(_row(f"{case.title}: {own.estimate.partition(' (')[0]}", own))
    return table(" | ".join(["log, RMS (largest)", *QUANTITIES]), rows)


def poor(data: Path) -> Iterator[str]:
    """Yield what is reported of logs that lack something."""
    rows = []
    for log in POOR:
        if is_there(data, log):
            try:
                report = estimate(data / log)[1]
            except CompanionError as error:
                sentence = str(error).removeprefix(f"{data / log}: ")
                rows.append(f"{Path(log).parent} | exit code 3 | {sentence}")
                continue
            spent = ", ".join(
                f"{each.name.lower()} {s:.0f} s" for each, s in report.seconds.items()
            )
            rows.append(f"{Path(log).parent} | {spent} | {'; '.join(report.notes) or '-'}")
    return table("log | what can be estimated | what is said", rows)


def _row(title: str, score: Score) -> str:
    cells = [title]
    for attribute, scale in QUANTITIES.values():
        spread: Spread | None = getattr(score, attribute)
        cells.append(f"{spread.rms * scale:.2f} ({spread.largest * scale:.2f})" if spread else "-")
    return " | ".join(cells)


PARTS: dict[str, Part] = {
    "autopilot": of_logs(against_autopilot),
    "truth": of_logs(against_truth),
    "poor": of_logs(poor),
    "consistency": of_flights(consistency.tables),
    "seed": of_logs(seed.tables),
    "outages": outages.tables,
    "four imus": of_logs(four_imus.tables),
    "receiver faults": of_flights(receiver_faults.tables),
    "compassless": of_flights(compassless.tables),
}


if __name__ == "__main__":
    document.main(__doc__, PARTS)
