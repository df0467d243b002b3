"""What the seed article's two slips cost on its own flight, beside our estimator and the rest."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks import seed
from benchmarks.seed_flight import FOLDER, NAMES, rmse, truth
from ekf_companion.core.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.filters import euler, euler_article, iterated
from ekf_companion.filters.euler_article import Constants
from ekf_companion.filters.sequence import MeasurementSequence, run_sequence
from ekf_companion.logs import csv
from ekf_companion.nav.earth import SIMULATED
from ekf_companion.nav.state import Table

Array = npt.NDArray[np.float64]

SLIPS = {
    "both slips (the article)": Constants(),
    "R of the heading as meant": Constants(heading_variance=4e-4),
    "Q of the biases as meant": Constants(bias_walk=1e-5),
    "neither slip": Constants(heading_variance=4e-4, bias_walk=1e-5),
}


def errors(data: Path, table: Table) -> Array:
    """Give RMSE from 20 s on, by ``seed_flight.NAMES``: degrees, m, m/s.

    Positions are taken as they stand, not to the metres of the velocities.
    """
    place = (np.radians(table.column("lat_deg")), np.radians(table.column("lon_deg")))
    pos_n = SIMULATED.to_ned(*place, table.column("alt_m")) * [1.0, 1.0, -1.0]
    names = ("roll", "pitch", "yaw", "vel_n", "vel_e", "vel_d")
    columns = [table.column(name) for name in names]
    estimate = np.stack([*columns[:3], *pos_n.T, *columns[3:]], axis=1)
    return rmse(truth(data), np.asarray(table.stamp_ns * 1e-9), estimate)


def articles(data: Path) -> Iterator[tuple[str, Array]]:
    """Give the errors of the article's run, with each of its slips."""
    recording = csv.read(data / FOLDER / "uavSensors.csv")
    course = MeasurementSequence(recording.events, FilterSettings())
    for name, constants in SLIPS.items():
        yield name, errors(data, euler_article.run(course, constants).table)


def others(data: Path) -> Iterator[tuple[str, Array]]:
    """Give those of filters that are told the sensors as they were drawn, then of defaults."""
    recording = csv.read(data / FOLDER / "uavSensors.csv")
    for words, told in (("declared", seed.settings()), ("defaults", FilterSettings())):
        sequence = MeasurementSequence(recording.events, told)
        table = euler.run(sequence).table
        yield f"`euler`, corrected, {words}", errors(data, table)
        setup = sequence.setup()
        tried = iterated.Iterated(setup)
        yield (
            f"`iterated`, {words}",
            errors(data, run_sequence("iterated", tried, sequence, setup).table),
        )
        yield f"`eskf`, {words}", errors(data, Pipeline(told).run(recording.events))


def main() -> None:
    """Print the table."""
    data = Path(__file__).parents[2] / "shared" / "data"
    print(f"| | {' | '.join(NAMES)} |\n|{' --- |' * (len(NAMES) + 1)}")
    for part in (articles, others):
        for name, found in part(data):
            print(f"| {name} | {' | '.join(f'{one:.3f}' for one in found)} |", flush=True)


if __name__ == "__main__":
    main()
