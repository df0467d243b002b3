"""Noise, delay and lever arm of a vehicle by maximum likelihood over its flights.

The likelihood is that of the innovations of the receiver as the estimator has them: the sum of
-(r' S^-1 r + ln det S) / 2 over positions, heights and velocities, an outlier counted as its gate.
Nothing is learnt meanwhile (``imu.learn_noise`` off, one share of white noise, a delay and a lever
arm that are known), as noise that is learnt would explain a wrong parameter away.

Noises go by their logarithm. Far from its top the likelihood is nearly a straight line in these:
neither its slope nor the product of slopes says how far the top is. So some flights are searched by
themselves at first, along one parameter after the other over its whole range (Powell's method), and
the median of what they show is the start, whatever is configured. From there on Newton's method
goes to the top of the sum over all flights, by differences of second order in each flight.

Left out in turn, each flight has parameters of all others, one Newton step from those of all. Their
scatter is the interval (jackknife over flights), or what the curvature leaves open, where that is
more: neither innovations that are correlated within a flight nor a model that is not quite right
make it too narrow. The gain in likelihood of each flight under the parameters of the others is what
the result is worth.

Source: Maybeck 1982, vol. 2, ch. 10 (maximum likelihood by innovations); Powell 1964, The Computer
Journal 7, 2; Efron and Stein 1981, Annals of Statistics 9, 3 (jackknife); White 1982, Econometrica
50, 1 (misspecified likelihoods); DerSimonian and Laird 1986, Controlled Clinical Trials 7, 3
(scatter between studies).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError, part_of
from ekf_companion.fleet.executor import Executor, Lost
from ekf_companion.fleet.run import Progress
from ekf_companion.fleet.source import Source
from ekf_companion.fleet.tune_flight import Look, gain, look, search
from ekf_companion.fleet.tune_parameter import (
    ARM,
    DELAY,
    HIGH,
    LOW,
    SCALE,
    SURE,
    configured,
    to_theta,
    to_values,
    tuned,
)
from ekf_companion.logs.recording import counted
from ekf_companion.nav.arrays import Array, Mask

PRIOR = 3.0
"""One sigma of what is known before, in ranges of a parameter; it keeps one that no flight shows
from running off."""
FEWEST = 4
"""Flights of a fit."""
SEARCHED = 8
"""Flights that are searched by themselves."""
MOST_MOVES, NEAR = 12, 0.2
"""Newton steps, and the step in sigmas with which they end: its square is a share of the variance.
The noise of the inertial samples about each fix makes the likelihood rough below that."""
TOO_FAR = 1.92
"""Loss of log-likelihood beyond which a step went too far: that at the ends of a 95 % interval."""
USUAL_ROUNDS = 6
"""Times that all flights are run through, usually: by which progress is shown."""
LARGEST = 1.0
"""Largest step, of ``SCALE``."""
LEAST_DELAY_STD, LEAST_ARM_STD = 0.002, 0.02
"""s and m: what ``calibrate delay`` writes at least, and what an arm that was measured is given."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fit:
    """The likeliest parameters of a vehicle, in the order of ``PARAMETERS``."""

    values: Array
    """Noises as they are."""
    low: Array
    """Lower ends of the 95 % intervals."""
    high: Array
    is_shown: Mask
    """Whether the flights show it, or contradict what is configured."""
    delay_std: float
    """One sigma of the delay of another flight, s."""
    arm_std: float
    """Largest sigma of the lever arm, m."""
    flights: int
    moves: int
    """Newton steps."""
    gains: Array
    """Log-likelihood of each flight under the parameters of the others, over that under the
    configuration: with noise that is known, and with noise that is learnt; shape (flights, 2)."""
    refused: Sequence[str]
    """Names of the flights that were left aside, and why."""

    @property
    def is_fixed(self) -> bool:
        """Whether flights that were left out are likelier with fixed noise than with learnt."""
        mean, error = mean_and_error(self.gains[:, 0] - self.gains[:, 1])
        return mean > 2.0 * error

    def settings(self, config: Config) -> Config:
        """Return the configuration with what was found."""
        std = (self.delay_std, self.arm_std)
        return tuned(config, to_theta(self.values), self.is_shown, std, learns=not self.is_fixed)


def mean_and_error(values: Array) -> tuple[float, float]:
    """Return the mean, and its standard error."""
    return float(values.mean()), float(values.std(ddof=1) / math.sqrt(len(values)))


def tune(
    sources: Sequence[Source],
    config: Config,
    executor: Executor,
    progress: Progress | None = None,
) -> Fit:
    """Fit the parameters to flights of one vehicle.

    Raises:
        LogError: Too few flights can be used, or they have no likeliest parameters.
    """
    with part_of("fleet", "fleet tune"):
        from scipy.stats import t
    fleet = _Fleet(sources, config, executor, progress)
    theta, searched = fleet.start()
    before = 0
    if fleet.size > 2 * len(searched) >= 2 * FEWEST:  # most of the way is gone by these few
        theta, _, before = _climb(fleet, theta, searched)
    theta, looks, moves = _climb(fleet, theta)
    others = left_out(theta, looks)
    sigma = interval_sigma(others, looks)
    half = float(t.ppf(0.975, len(looks) - 1)) * sigma
    present = configured(config, float(np.median([one.delay for one in looks])))
    is_shown = (half <= SURE) | (np.abs(present - theta) > half)
    std = (
        max(math.hypot(sigma[DELAY], between_flights(looks)), LEAST_DELAY_STD),
        max(float(sigma[ARM].max()), LEAST_ARM_STD),
    )
    return Fit(
        values=to_values(theta),
        low=to_values(np.clip(theta - half, LOW, HIGH)),
        high=to_values(np.clip(theta + half, LOW, HIGH)),
        is_shown=is_shown,
        delay_std=std[0],
        arm_std=std[1],
        flights=len(looks),
        moves=before + moves,
        gains=fleet.gains(others, is_shown, std),
        refused=tuple(fleet.refused),
    )


class _Fleet:
    """The flights that can be used, and who runs tasks on them."""

    def __init__(
        self,
        sources: Sequence[Source],
        config: Config,
        executor: Executor,
        progress: Progress | None,
    ) -> None:
        self._sources = sorted(sources, key=lambda one: one.name)
        self._config, self._executor, self._progress = config, executor, progress
        self._done, self.refused = 0, list[str]()

    @property
    def size(self) -> int:
        """The number of flights."""
        return len(self._sources)

    def start(self) -> tuple[Array, list[Source]]:
        """Return the median of what some flights show by themselves, and these flights."""
        while len(self._sources) >= FEWEST:
            # Every so many, so that all parts of a long list count
            some = self._sources[:: max(len(self._sources) // SEARCHED, 1)][:SEARCHED]
            if found := self._each(partial(search, config=self._config), some):
                kept = [one for one in some if one in self._sources]
                return np.asarray(np.median(found, axis=0)), kept
        raise self._too_few(len(self._sources))

    def looks(self, theta: Array, some: Sequence[Source] | None = None) -> list[Look]:
        """Return a look at each flight, or at some."""
        task = partial(look, theta=theta, config=self._config)
        items = [one for one in self._sources if some is None or one in some]
        found: list[Look] = self._each(task, items)
        if len(found) < FEWEST:
            raise self._too_few(len(found))
        return found

    def gains(self, others: Array, is_shown: Mask, std: tuple[float, float]) -> Array:
        """Return the gains of each flight under the parameters of the others."""
        task = partial(gain, is_shown=is_shown, std=std, config=self._config)
        pairs = list(zip(self._sources, others, strict=True))
        found = self._each(task, pairs, lambda pair: pair[0])
        if len(found) < FEWEST:
            raise self._too_few(len(found))
        return np.array(found)

    def _each(
        self,
        task: Callable[[Any], Any],
        items: Sequence[Any],
        source_of: Callable[[Any], Source] = lambda item: item,
    ) -> list[Any]:
        """Return the results in the order of the items; leave flights aside that have none."""
        found: dict[str, Any] = {}
        for item, result in self._executor.run(task, items):
            source = source_of(item)
            if isinstance(result, (str, Lost)):
                why = result if isinstance(result, str) else result.why
                self.refused.append(f"{source.name}: {why}")
                self._sources = [one for one in self._sources if one is not source]
            else:
                found[source.name] = result
            self._done += 1
            if self._progress is not None:
                usual = SEARCHED + USUAL_ROUNDS * len(self._sources)
                self._progress(self._done, max(usual, self._done))
        return [found[name] for item in items if (name := source_of(item).name) in found]

    def _too_few(self, count: int) -> LogError:
        why = "".join(f"; {one}" for one in self.refused[:3])
        return LogError(
            f"only {counted(count, 'flight')} can be used, of {FEWEST} at least{why}; name more "
            "logs of this vehicle"
        )


def _climb(
    fleet: _Fleet, theta: Array, some: Sequence[Source] | None = None
) -> tuple[Array, list[Look], int]:
    """Go to the top from a start, by all flights or by some.

    Returns:
        The parameters, the looks there, and the steps taken.
    """
    best, top, flights = theta, -math.inf, 0
    for move in range(MOST_MOVES):
        looks = fleet.looks(theta, some)
        value = sum(one.value for one in looks)
        if value < top - TOO_FAR and len(looks) == flights:
            theta = 0.5 * (theta + best)
            continue
        best, top, flights = theta, value, len(looks)
        step = np.clip(theta + newton_step(looks), LOW, HIGH) - theta
        if (np.abs(step) <= NEAR * jackknife_sigma(left_out(theta, looks))).all():
            return theta, looks, move
        theta = theta + step * min(1.0, LARGEST / float(np.abs(step / SCALE).max()))
    raise LogError(
        f"no likeliest parameters after {MOST_MOVES} steps: these flights do not agree; are they "
        "of one vehicle?"
    )


def newton_step(looks: Sequence[Look]) -> Array:
    """Return the Newton step to the top of the sum of looks; uphill where it curves upwards."""
    step: Array = _covariance(looks) @ np.sum([one.slope for one in looks], axis=0)
    return step


def information_sigma(looks: Sequence[Look]) -> Array:
    """Return the sigma of each parameter by the curvature, as if the model were right."""
    sigma: Array = np.sqrt(np.diag(_covariance(looks)))
    return sigma


def _covariance(looks: Sequence[Look]) -> Array:
    """Return the inverse of the curvature and the prior's, without its sign."""
    unit = PRIOR * (HIGH - LOW)
    curvature = -np.sum([one.curvature for one in looks], axis=0)
    levels, axes = np.linalg.eigh(curvature * np.outer(unit, unit))
    found: Array = (axes / (np.abs(levels) + 1.0)) @ axes.T * np.outer(unit, unit)
    return found


def left_out(theta: Array, looks: Sequence[Look]) -> Array:
    """Return the parameters without each flight, one Newton step from those of all."""
    here = newton_step(looks)
    steps = [newton_step([other for other in looks if other is not one]) - here for one in looks]
    others: Array = np.clip(theta + np.array(steps), LOW, HIGH)
    return others


def jackknife_sigma(others: Array) -> Array:
    """Return the jackknife's sigma of each parameter."""
    n = len(others)
    return np.asarray(np.sqrt((n - 1) / n * np.sum((others - others.mean(axis=0)) ** 2, axis=0)))


def interval_sigma(others: Array, looks: Sequence[Look]) -> Array:
    """Return the sigma of the intervals: the jackknife's, or the curvature's where that is more.

    A parameter that no flight shows does not scatter either.
    """
    return np.maximum(jackknife_sigma(others), information_sigma(looks))


def between_flights(looks: Sequence[Look]) -> float:
    """Return one sigma of the delay from flight to flight, beyond what each does not know of it.

    Flights count that show the delay by themselves.
    """
    weight = np.array([-one.curvature[DELAY, DELAY] for one in looks])
    shows = weight * SURE[DELAY] ** 2 > 1.0
    if np.count_nonzero(shows) < 2:
        return 0.0
    weight = weight[shows]
    off = np.array([one.slope[DELAY] for one in looks])[shows] / weight
    scatter = float(weight @ off**2) - (len(weight) - 1)
    spread = float(weight.sum() - (weight @ weight) / weight.sum())
    return math.sqrt(max(scatter / spread, 0.0))
