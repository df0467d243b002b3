"""Print what the seed article's flight shows of its biases: ``python -m benchmarks.observability``.

Its samples, its noise and its biases as the article declares them; north by its magnetometer.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks import seed, seed_flight
from benchmarks.accuracy import DATA
from ekf_companion.analysis.observability import Observability, analyse
from ekf_companion.analysis.observability_figure import plot
from ekf_companion.analysis.observability_report import lines
from ekf_companion.filters.sequence import MeasurementSequence


def of_seed(data: Path) -> Observability:
    """Analyse draw 42."""
    drawn = seed_flight.draw_42(data)
    events = seed_flight.events(seed_flight.truth(data), drawn, seed_flight.Place())
    course = MeasurementSequence(events, seed.settings())
    return analyse(course, course.setup(), seed.settings())


def main() -> None:
    """Print the sentences, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="the recorded flights")
    parser.add_argument("--plot", type=Path, default=Path("seed.observability.png"))
    chosen = parser.parse_args()
    found = of_seed(chosen.data)
    for line in lines(found):
        print(line)
    plot(chosen.plot, found, "the seed article's flight")


if __name__ == "__main__":
    main()
