"""The seed article's flight: our errors beside its own filter's, the limits, and the bound."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks import seed_flight as seed
from benchmarks.campaign import PROCESSES, each
from benchmarks.seed_flight import Draw, Place, Truth
from benchmarks.seed_reference import Compass, Reference
from ekf_companion.core.settings import FilterSettings, GnssSettings, HeadingSettings, ImuSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.replay.smoothing import smooth

Array = npt.NDArray[np.float64]

DRAWS = 20
LIMITS = (0.27, 0.27, 0.20, 0.55, 0.42, 0.19, 0.050, 0.053, 0.025)
"""RMSE from 20 s on, by ``NAMES``: degrees, m, m/s."""
START = 20.0
"""s; the errors before are not counted."""
ALMOST_NONE = 1e-4
"""rad, gauss; the simulated magnetometer has no slow error, and the setting must be positive."""
HEAD = (
    "roll, deg",
    "pitch, deg",
    "yaw, deg",
    "north, m",
    "east, m",
    "height, m",
    "vN, m/s",
    "vE, m/s",
    "vD, m/s",
)


def settings(samples: str = "instant", lag: float = 0.0) -> FilterSettings:
    """Give the settings that declare the simulation's noise."""
    root = seed.PERIOD**0.5
    return FilterSettings(
        imu=ImuSettings(
            gyro_noise=seed.GYRO_NOISE * root,
            accel_noise=seed.ACCEL_NOISE * root,
            gyro_bias_walk=0.0,
            accel_bias_walk=0.0,
            gyro_bias=seed.GYRO_BIAS,
            accel_bias=seed.ACCEL_BIAS,
            learn_noise=False,
            lag=lag,
            samples=samples,  # type: ignore[arg-type]
        ),
        gnss=GnssSettings(
            delay=0.0,
            delay_std=0.0,
            timing_std=0.0,
            velocity_slow_std=0.0,
            white_share=1.0,
            position_std=0.0,
            height_std=0.0,
            velocity_std=0.0,
        ),
        heading=HeadingSettings(
            magnetometer_std=ALMOST_NONE,
            hard_iron_std=ALMOST_NONE,
            hard_iron_walk=0.0,
            magnetometer_noise=seed.MAG_STD * seed.STRENGTH,
            heading_std=seed.MAG_STD,
        ),
    )


def ours(
    motion: Truth,
    drawn: Draw,
    place: Place = Place(),  # noqa: B008  # frozen
    told: FilterSettings | None = None,
) -> Array:
    """Give our RMSE, by ``NAMES``."""
    table = Pipeline(told or settings()).run(seed.events(motion, drawn, place))
    t = np.asarray(table.stamp_ns * 1e-9, dtype=np.float64)
    return seed.rmse(motion, t, seed.states(table, place), START)


def smoothed(motion: Truth, drawn: Draw) -> Array:
    """Give the RMSE of our estimate after going back over the flight, by ``NAMES``."""
    place = Place()
    table = smooth(seed.events(motion, drawn, place), settings())
    t = np.asarray(table.stamp_ns * 1e-9, dtype=np.float64)
    return seed.rmse(motion, t, seed.states(table, place), START)


def reference(motion: Truth, drawn: Draw, compass: Compass) -> Array:
    """Give the reference's RMSE, by ``NAMES``."""
    return seed.rmse(motion, motion.t, Reference(motion, compass).run(drawn), START)


def bound(motion: Truth, compass: Compass) -> Array:
    """Give the least RMSE to be expected, by ``NAMES``."""
    sigma = Reference(motion, compass).bound()[motion.t >= START]
    return np.asarray(np.sqrt(np.mean(np.square(sigma), axis=0)))


def tables(data: Path, runs: int | None = None) -> Iterator[str]:
    """Give the flight's RMSE, then how the samples are best understood, then other draws."""
    if not (data / seed.FOLDER).is_dir():
        print(f"{seed.FOLDER}: absent, left out")
        return
    motion, drawn, author = seed.truth(data), seed.draw_42(data), seed.draw_author(data)
    yield from _header("RMSE from 20 s on")
    yield _row("limit", LIMITS)
    theirs = seed.rmse(motion, motion.t, seed.estimate_of_seed(data), START)
    yield _row("draw 42: the seed's own filter", theirs)
    yield _row("draw 42: **ours**", ours(motion, drawn), is_judged=True)
    yield _row("draw 42: ours, smoothed", smoothed(motion, drawn))
    yield _row("ours, positions not taken to metres", ours(motion, drawn, Place(stretched=False)))
    yield _row("ours, at 48 degrees north", ours(motion, drawn, Place(lat=48.0)))
    yield _row("ours, on an Earth whose turning shows", ours(motion, drawn, Place(turns=True)))
    for compass, words in (("azimuth", "azimuth only"), ("vector", "whole vector")):
        yield _row(f"draw 42: reference, {words}", reference(motion, drawn, compass))  # type: ignore[arg-type]
        yield _row(f"bound, {words}", bound(motion, compass))  # type: ignore[arg-type]
    theirs = seed.rmse(motion, motion.t, seed.estimate_of_author(data), START)
    yield _row("author's draw: the author's own filter", theirs)
    yield _row("author's draw: ours", ours(motion, author))
    yield _row("author's draw: reference", reference(motion, author, "level"))
    yield ""
    yield from _header("draw 42: `imu.samples`, `imu.lag`")
    for samples in ("mean", "instant"):
        for lag in (-0.05, 0.0, 0.05):
            found = ours(motion, drawn, told=settings(samples, lag))
            yield _row(f"{samples}, {lag:g} s", found)
    yield ""
    yield from _draws(data, runs or DRAWS)


def draw_of(job: tuple[Path, int]) -> tuple[Array, Array, Array]:
    """Give RMSE of ours, and of the reference by azimuth and by vector, for another draw."""
    data, number = job
    motion = seed.truth(data)
    drawn = seed.draw(motion, number)
    return (
        ours(motion, drawn),
        reference(motion, drawn, "azimuth"),
        reference(motion, drawn, "vector"),
    )


def _draws(data: Path, count: int, processes: int = PROCESSES) -> Iterator[str]:
    found = np.array(each(draw_of, [(data, i) for i in range(count)], "seed, draws", processes))
    yield from _header(f"{count} other draws")
    for i, name in enumerate(("ours", "reference, azimuth only", "reference, whole vector")):
        yield _row(f"{name}: mean RMSE", found[:, i].mean(axis=0))
        yield _row("standard deviation", found[:, i].std(axis=0, ddof=1))
        share = 100.0 * (found[:, i] <= LIMITS).mean(axis=0)
        yield f"| within the limit | {' | '.join(f'{each_:.0f} %' for each_ in share)} |"


def _header(first: str) -> Iterator[str]:
    yield f"| {first} | {' | '.join(HEAD)} |"
    yield "|---" * (len(HEAD) + 1) + "|"


def _row(title: str, values: Iterable[float], is_judged: bool = False) -> str:
    cells = [
        f"{value:.3f}" + (" above" if is_judged and not value <= limit else "")
        for value, limit in zip(values, LIMITS, strict=True)
    ]
    return f"| {title} | {' | '.join(cells)} |"
