"""Noise and delay of a receiver, and its lever arm, by maximum likelihood over many flights.

Each flight runs through the estimator with each parameter a step up and a step down, and the sums
of the log-likelihood of its innovations by blocks of some seconds are kept. Their differences are
slopes and curvature of the likelihood; the parameters move by Newton's method, and the scatter of
the blocks' slopes says how they go together (Berndt and others). What the receiver states of its
accuracy does not count meanwhile: it is its real noise that is asked for.

The interval of each parameter is by the scatter of the slopes from flight to flight ("sandwich",
flights as clusters), so that neither innovations that are correlated within a flight nor a model
that is not quite right make it too narrow. A quarter of the flights is left out, and the gain in
likelihood on these is what the result is worth.

Source: Berndt, Hall, Hall and Hausman 1974, Annals of Economic and Social Measurement 3, 4;
White 1982, Econometrica 50, 1; Maybeck 1982, vol. 2, ch. 10 (innovations).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np

from ekf_companion.calibrate.result import Result, Setting
from ekf_companion.config.config import Config
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import CompanionError, LogError, part_of
from ekf_companion.fleet.executor import Executor, Lost
from ekf_companion.fleet.run import Progress
from ekf_companion.fleet.source import Source
from ekf_companion.logs.recording import Recording, counted
from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.measurements import GNSS_STD, Kind
from ekf_companion.nav.state import Status
from ekf_companion.replay.read import read

NAMES = ("delay", "forward", "right", "down", "position_std", "height_std", "velocity_std")
"""Delay (s), lever arm (m), and the logarithms of the noises (m, m, m/s)."""
STEPS = np.array([0.01, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
"""Of the differences."""
LARGEST = np.array([0.06, 0.4, 0.4, 0.4, 0.7, 0.7, 0.7])
"""Largest move at once."""
PRIOR = np.array([0.3, 0.5, 0.5, 0.5, 2.0, 2.0, 2.0])
"""One sigma of what is known before: it matters only where no flight shows anything."""
SURE = np.array([0.05, 0.15, 0.15, 0.15, 0.3, 0.3, 0.3])
"""Largest half of a 95 % interval with which a parameter is set; with more it is a comment."""
MOST_MOVES, NEAR = 12, 0.2
"""Iterations, and the move in sigmas with which they end."""
FLATTEST = 0.3
"""Least curvature over the scatter of the slopes, which it equals if the model is right."""
BLOCK = 8.0
"""s: longer than innovations are correlated."""
SETTLING = 10.0
"""Time after the first position that is not counted, s."""
FEWEST, LEFT_OUT = 4, 4
"""Flights of a fit, and the share that is left out: one of so many."""
UNSTATED = 1e-3
"""What a receiver states where its own word does not count, m and m/s."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The likeliest parameters."""

    values: Array
    """In the order of ``NAMES``, noises as they are."""
    low: Array
    """Lower ends of the 95 % intervals."""
    high: Array
    is_sure: Mask
    flights: int
    left_out: int
    gain: float
    """Mean gain in log-likelihood of a flight that was left out; NaN: there is none."""
    gain_std: float
    """Its standard error."""
    refused: Sequence[str]
    """Why flights were left aside, of each."""


def tune(
    sources: Sequence[Source],
    config: Config,
    executor: Executor,
    progress: Progress | None = None,
) -> Fit:
    """Fit receiver and lever arm to flights of one vehicle.

    Raises:
        LogError: Too few flights have what it takes.
    """
    with part_of("fleet", "fleet tune"):
        from scipy.stats import t
    kept = [one for i, one in enumerate(sources) if i % LEFT_OUT != LEFT_OUT - 1]
    rest = [one for i, one in enumerate(sources) if i % LEFT_OUT == LEFT_OUT - 1]
    theta: Array | None = None
    refused: list[str] = []
    for move in range(MOST_MOVES):
        slopes, curvatures, starts = [], [], []
        task = partial(measure, theta=theta, config=config)
        for source, found in sorted(executor.run(task, kept), key=lambda one: one[0].name):
            if isinstance(found, (str, Lost)):
                why = found if isinstance(found, str) else found.why
                refused.append(f"{source.name}: {why}")
                kept = [one for one in kept if one is not source]
                continue
            begin, sums = found
            starts.append(begin)
            slopes.append((sums[1::2] - sums[2::2]) / (2.0 * STEPS[:, None]))
            curvatures.append((2.0 * sums[0] - sums[1::2] - sums[2::2]).sum(axis=1) / STEPS**2)
        if len(slopes) < FEWEST:
            raise LogError(
                f"only {counted(len(slopes), 'flight')} can be used, of {FEWEST} at least"
                + "".join(f"; {one}" for one in refused[:3])
            )
        center = np.mean(starts, axis=0) if theta is None else theta
        information, covariance = _information(slopes, curvatures)
        step = np.linalg.solve(information, np.sum([one.sum(axis=1) for one in slopes], axis=0))
        theta = center + np.clip(step, -LARGEST, LARGEST)
        sigma = np.sqrt(np.diag(covariance))
        if progress is not None:
            progress(move + 1, MOST_MOVES)
        if (np.abs(step) < NEAR * sigma).all():
            break
    if theta is None:
        raise AssertionError("there is a first move")
    half = float(t.ppf(0.975, len(slopes) - 1)) * sigma
    gains = _gains(rest, executor, config, tuned(config, theta, half, only_sure=True))
    return Fit(
        values=_shown(theta),
        low=_shown(theta - half),
        high=_shown(theta + half),
        is_sure=half <= SURE,
        flights=len(slopes),
        left_out=len(gains),
        gain=float(np.mean(gains)) if len(gains) else math.nan,
        gain_std=float(np.std(gains, ddof=1) / math.sqrt(len(gains)))
        if len(gains) > 1
        else math.nan,
        refused=tuple(refused),
    )


def _shown(theta: Array) -> Array:
    return np.concatenate([theta[:4], np.exp(theta[4:])])


def _information(slopes: Sequence[Array], curvatures: Sequence[Array]) -> tuple[Array, Array]:
    """Return the information of all flights, and the covariance of the parameters.

    The diagonal is the curvature, or more where a move would be larger than is allowed;
    the scatter of the blocks' slopes says how parameters go together.
    """
    blocks = np.concatenate(slopes, axis=1)
    total = np.abs(blocks.sum(axis=1))
    centred = blocks - blocks.mean(axis=1, keepdims=True)
    outer = centred @ centred.T + np.diag(PRIOR**-2.0)
    spread = np.sqrt(np.diag(outer))
    curved = np.maximum(np.sum(curvatures, axis=0), FLATTEST * spread**2) + PRIOR**-2.0
    scale = np.sqrt(np.maximum(curved, total / LARGEST)) / spread
    information = outer * np.outer(scale, scale)
    flights = np.array([one.sum(axis=1) for one in slopes])
    flights = flights - flights.mean(axis=0)
    scatter = flights.T @ flights * len(flights) / (len(flights) - 1) + np.diag(PRIOR**-2.0)
    inverse = np.linalg.inv(information)
    return information, inverse @ scatter @ inverse


@lru_cache(maxsize=16)
def _recording(source: Source, config: Config) -> Recording:
    with source.opened() as path:
        return read(path, config)


def measure(source: Source, theta: Array | None, config: Config) -> tuple[Array, Array] | str:
    """Return the parameters, and the likelihood of a flight's blocks about them; else why not.

    Args:
        source: The flight.
        theta: In the order of ``NAMES``; None: as configured or declared.
        config: Everything else.

    Returns:
        The likelihood has shape (1 + 2 n, blocks): at the parameters, a step up and a step down
        of each.
    """
    try:
        recording = _recording(source, config)
    except CompanionError as error:
        return str(error).removeprefix(f"{source.name}: ")
    events = recording.events
    if not (events.kind == Kind.GNSS).any():
        return "holds no GNSS fix"
    pipeline = Pipeline(config, recording.family, recording.gnss_delay)
    table = pipeline.run(events)
    located = np.flatnonzero(table.column("status") >= Status.OK)
    first = table.stamp_ns[located[0]] * 1e-9 + SETTLING if len(located) else math.inf
    last = float(table.stamp_ns[-1]) * 1e-9 if len(table) else 0.0
    if last - first < 2.0 * BLOCK:
        return "has too few seconds with a position"
    edges = np.linspace(first, last, int((last - first) / BLOCK) + 1)
    health = pipeline.health()
    steady = replace(
        config.imu,
        learn_noise=False,
        gyro_noise=max(config.imu.gyro_noise, health.gyro_noise),
        accel_noise=max(config.imu.accel_noise, health.accel_noise),
    )
    config = replace(config, imu=steady)
    if theta is None:
        theta = start(config, recording)
    values = events.values.copy()
    values[np.ix_(events.kind == Kind.GNSS, range(*GNSS_STD.indices(values.shape[1])))] = UNSTATED
    recording = replace(recording, events=replace(events, values=values))
    around = [theta]
    for i, step in enumerate(STEPS):
        around += [theta + step * np.eye(len(NAMES))[i], theta - step * np.eye(len(NAMES))[i]]
    sums = [likelihood(recording, with_parameters(config, one), edges) for one in around]
    return theta, np.array(sums)


def start(config: Config, recording: Recording) -> Array:
    """Return the parameters that are configured, or that the log declares."""
    late = delays_ns(config, recording.family, recording.gnss_delay)[Kind.GNSS] * 1e-9
    gnss = config.gnss
    # From a usual receiver's noise on, the steps lead to the top from either side
    noises = [max(gnss.position_std, 0.5), max(gnss.height_std, 1.0), max(gnss.velocity_std, 0.1)]
    return np.array([late, *gnss.lever_arm, *np.log(noises)])


def with_parameters(config: Config, theta: Array) -> Config:
    """Return a configuration in which these parameters are known for certain."""
    position, height, velocity = np.exp(theta[4:]).tolist()
    gnss = replace(
        config.gnss,
        delay=float(theta[0]),
        delay_std=0.0,
        lever_arm=tuple(theta[1:4].tolist()),
        lever_arm_std=0.0,
        white_share=1.0,
        position_std=position,
        height_std=height,
        velocity_std=velocity,
        velocity_slow_std=0.0,
    )
    return replace(config, gnss=gnss)


def tuned(config: Config, theta: Array, half: Array, *, only_sure: bool) -> Config:
    """Return the configuration with what was found; what no flight shows stays as it was."""
    gnss, shown = config.gnss, _shown(theta)
    sure = half <= SURE if only_sure else np.ones(len(NAMES), dtype=bool)
    arm = tuple(float(shown[1 + i]) if sure[1 + i] else gnss.lever_arm[i] for i in range(3))
    changes: dict[str, object] = {"lever_arm": arm}
    if sure[0]:
        changes |= {"delay": float(theta[0]), "delay_std": max(float(half[0]) / 1.96, 0.002)}
    for i, name in enumerate(NAMES[4:], 4):
        if sure[i]:
            changes[name] = float(shown[i])
    return replace(config, gnss=replace(gnss, **changes))  # type: ignore[arg-type]


def likelihood(recording: Recording, config: Config, edges: Array) -> Array:
    """Return the log-likelihood of each block between edges, s of the stamps."""
    pipeline = Pipeline(config, recording.family, recording.gnss_delay)
    newest = np.maximum.accumulate(recording.events.t_ns)
    stamps = np.rint(edges * 1e9).astype(np.int64)
    cuts = [0, *np.searchsorted(newest, stamps, side="right").tolist()]
    sums = []
    for first, last in pairwise(cuts):
        pipeline.run(recording.events.take(np.arange(first, last)))
        sums.append(pipeline.log_likelihood)
    return np.diff(sums)


def gain(source: Source, before: Config, after: Config) -> float | str:
    """Return the gain in a flight's log-likelihood by another configuration; else why not."""
    try:
        recording = _recording(source, before)
    except CompanionError as error:
        return str(error)
    t_ns = recording.events.t_ns
    edges = np.array([t_ns.min() * 1e-9 + 2.0 * SETTLING, t_ns.max() * 1e-9])
    if edges[1] < edges[0] + BLOCK:
        return "is too short"
    old, new = (likelihood(recording, one, edges).sum() for one in (before, after))
    return float(new - old)


def _gains(
    sources: Sequence[Source], executor: Executor, before: Config, after: Config
) -> list[float]:
    found = executor.run(partial(gain, before=before, after=after), sources)
    return [one for _, one in found if isinstance(one, float)]


def result(found: Fit) -> Result:
    """Return a fit as keys of the configuration."""
    units = ("s", "m", "m", "m", "m", "m", "m/s")

    def words(i: int) -> str:
        what = f"{units[i]}; 95 %: {found.low[i]:.3g} to {found.high[i]:.3g}"
        return what if found.is_sure[i] else f"{what}: these flights do not show it"

    sigma = max(float(found.high[0] - found.low[0]) / 3.92, 0.002)
    arm = range(1, 4)
    settings = [
        Setting(
            key="gnss.delay",
            value=round(float(found.values[0]), 4),
            comment=words(0),
            is_sure=bool(found.is_sure[0]),
        ),
        Setting(
            key="gnss.delay_std",
            value=math.ceil(sigma * 1e3) / 1e3,
            comment="s; of that interval",
            is_sure=bool(found.is_sure[0]),
        ),
        Setting(
            key="gnss.lever_arm",
            value=[round(float(found.values[i]), 3) for i in arm],
            comment="; ".join(f"{NAMES[i]} {words(i)}" for i in arm),
            is_sure=all(bool(found.is_sure[i]) for i in arm),
        ),
        *(
            Setting(
                key=f"gnss.{name}",
                value=float(f"{found.values[i]:.3g}"),
                comment=words(i),
                is_sure=bool(found.is_sure[i]),
            )
            for i, name in enumerate(NAMES[4:], 4)
        ),
    ]
    return Result(settings=settings, notes=list(_notes(found)), data=_data(found))


def _notes(found: Fit) -> Iterator[str]:
    yield f"fitted to {counted(found.flights, 'flight')}"
    if found.left_out:
        yield (
            f"on {counted(found.left_out, 'flight')} left out the log-likelihood gains "
            f"{found.gain:.1f} a flight (standard error {found.gain_std:.1f})"
        )
    if found.left_out and not found.gain > 2.0 * found.gain_std:
        yield "that is no more than chance: keep the configuration that there is"
    for one in found.refused[:5]:
        yield f"left aside: {one}"


def _data(found: Fit) -> dict[str, object]:
    rows = zip(NAMES, found.values.tolist(), found.low.tolist(), found.high.tolist(), strict=True)
    return {
        "parameters": {name: {"value": v, "interval": [low, high]} for name, v, low, high in rows},
        "gain": found.gain,
        "gain_std": found.gain_std,
    }
