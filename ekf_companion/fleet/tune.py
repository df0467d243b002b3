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
scatter is the interval (jackknife over flights): neither innovations that are correlated within a
flight nor a model that is not quite right make it too narrow. The gain in likelihood of each flight
under the parameters of the others is what the result is worth.

Source: Maybeck 1982, vol. 2, ch. 10 (maximum likelihood by innovations); Powell 1964, The Computer
Journal 7, 2; Efron and Stein 1981, Annals of Statistics 9, 3 (jackknife); White 1982, Econometrica
50, 1 (misspecified likelihoods); DerSimonian and Laird 1986, Controlled Clinical Trials 7, 3
(scatter between studies).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from ekf_companion.calibrate.likelihood import cuts_at, likelihood
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A number that is tuned. Of a noise all but the range is of its natural logarithm."""

    name: str
    unit: str
    low: float
    """Least value; of the noises and the delay, as a ground station may set them."""
    high: float
    begin: float
    """Where a search begins: it matters little, as each goes over the whole range."""
    step: float
    """Of the differences: the likelihood is rough below it, and a parabola within it."""
    sure: float
    """Largest half of a 95 % interval with which the flights show the parameter."""


DELAY, ARM, NOISES = 0, slice(1, 4), slice(4, 10)
PARAMETERS = (
    Parameter(name="delay", unit="s", low=-0.2, high=0.6, begin=0.1, step=0.01, sure=0.05),
    *(
        Parameter(name=axis, unit="m", low=-5.0, high=5.0, begin=0.0, step=0.05, sure=0.15)
        for axis in ("forward", "right", "down")
    ),
    *(
        Parameter(name=name, unit=unit, low=low, high=high, begin=begin, step=0.1, sure=0.3)
        for name, unit, low, high, begin in (
            ("position_std", "m", 0.005, 50.0, 1.0),
            ("height_std", "m", 0.01, 50.0, 2.0),
            ("velocity_std", "m/s", 0.005, 10.0, 0.3),
            ("timing_std", "s", 1e-3, 0.3, 0.01),
            ("accel_noise", "m/s^2/sqrt(Hz)", 1e-4, 5.0, 0.1),
            ("gyro_noise", "rad/s/sqrt(Hz)", 1e-5, 0.1, 3e-3),
        )
    ),
)
"""Delay, lever arm (forward, right, down), noises, in the order of every array of parameters."""
WHITE_SHARE = 0.01
"""Share of the variance of a position that counts as white: the least that can be set, so that the
noise is the one that is tuned, and what a receiver states is its slow error."""
UNSTATED = 1e-3
"""What a receiver states of its velocity while that is tuned, m/s: in every flight its white share
is learnt anew, and at most three times this is made of it."""
PRIOR = 3.0
"""One sigma of what is known before, in ranges of a parameter; it keeps one that no flight shows
from running off."""
SETTLING = 10.0
"""Time after the first position that is not counted, s: the filter is settling."""
SHORTEST = 20.0
"""Least time that is counted, s."""
FEWEST = 4
"""Flights of a fit."""
SEARCHED = 8
"""Flights that are searched by themselves."""
SEARCHES = 2
"""Times that the search goes over all parameters: the first finds the delay and the noise of the
receiver, the second the rest."""
CLOSE = 0.02
"""Resolution of the search, logarithm of a noise; of the others, of ``SCALE``."""
SCALE = np.array([0.3, *(1.0,) * 9])
"""Unit of each parameter in the search: 0.3 s of delay are as far as 1 m, or a factor e."""
MOST_MOVES, NEAR = 12, 0.2
"""Newton steps, and the step in sigmas with which they end: its square is a share of the variance.
The noise of the inertial samples about each fix makes the likelihood rough below that."""
TOO_FAR = 1.92
"""Loss of log-likelihood beyond which a step went too far: that at the ends of a 95 % interval."""
USUAL_ROUNDS = 6
"""Times that all flights are run through, usually: what progress is told by."""
LARGEST = 1.0
"""Largest step, of ``SCALE``."""
LEAST_DELAY_STD, LEAST_ARM_STD = 0.002, 0.02
"""s and m: what ``calibrate delay`` writes at least, and what an arm that was measured is given."""
LOW = np.array([p.low for p in PARAMETERS])
HIGH = np.array([p.high for p in PARAMETERS])
LOW[NOISES], HIGH[NOISES] = np.log(LOW[NOISES]), np.log(HIGH[NOISES])
BEGIN = np.array([p.begin for p in PARAMETERS])
BEGIN[NOISES] = np.log(BEGIN[NOISES])
STEPS = np.array([p.step for p in PARAMETERS])
SURE = np.array([p.sure for p in PARAMETERS])
N = len(PARAMETERS)


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The log-likelihood of a flight about some parameters."""

    value: float
    slope: Array
    """Shape (n,)."""
    curvature: Array
    """Second derivatives, shape (n, n)."""
    delay: float
    """The delay that is configured, or that the log declares, s."""


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
        return tuned(config, _inner(self.values), self.is_shown, std, learns=not self.is_fixed)


def mean_and_error(values: Array) -> tuple[float, float]:
    """Return the mean, and its standard error."""
    return float(values.mean()), float(values.std(ddof=1) / math.sqrt(len(values)))


def _inner(values: Array) -> Array:
    return np.concatenate([values[: NOISES.start], np.log(values[NOISES])])


def _outer(theta: Array) -> Array:
    return np.concatenate([theta[: NOISES.start], np.exp(theta[NOISES])])


def known(config: Config, theta: Array) -> Config:
    """Return a configuration in which all parameters are known, and nothing is learnt."""
    position, height, velocity, timing, accel, gyro = np.exp(theta[NOISES]).tolist()
    gnss = replace(
        config.gnss,
        delay=float(theta[DELAY]),
        delay_std=0.0,
        lever_arm=tuple(theta[ARM].tolist()),
        lever_arm_std=0.0,
        white_share=WHITE_SHARE,
        position_std=position,
        height_std=height,
        velocity_std=velocity,
        timing_std=timing,
    )
    imu = replace(config.imu, learn_noise=False, accel_noise=accel, gyro_noise=gyro)
    return replace(config, gnss=gnss, imu=imu)


def tuned(
    config: Config, theta: Array, is_shown: Mask, std: tuple[float, float], *, learns: bool
) -> Config:
    """Return the configuration with parameters that were found; what is not shown stays.

    Args:
        config: What is configured.
        theta: The parameters, noises by their logarithm.
        is_shown: Which of them the flights show.
        std: One sigma of the delay, s, and of the lever arm, m.
        learns: Whether noise is learnt in flight, as configured; then inertial noise stays too.
    """
    new = known(config, theta)
    gnss, names = config.gnss, [p.name for p in PARAMETERS]
    changes: dict[str, object] = {
        name: getattr(new.gnss, name)
        for name, shown in zip(names[4:8], is_shown[4:8], strict=True)
        if shown
    }
    if is_shown[DELAY]:
        changes |= {"delay": new.gnss.delay, "delay_std": std[0]}
    if is_shown[ARM].any():
        arm = zip(new.gnss.lever_arm, gnss.lever_arm, is_shown[ARM], strict=True)
        changes["lever_arm"] = tuple(found if shown else was for found, was, shown in arm)
    if is_shown[ARM].all():
        changes["lever_arm_std"] = std[1]
    imu = config.imu
    if not learns:
        changes["white_share"] = WHITE_SHARE
        noises = {n: getattr(new.imu, n) for n, s in zip(names[8:], is_shown[8:], strict=True) if s}
        imu = replace(imu, learn_noise=False, **noises)
    return replace(config, gnss=replace(gnss, **changes), imu=imu)  # type: ignore[arg-type]


def configured(config: Config, delay: float) -> Array:
    """Return the parameters of a configuration, as near as they may be."""
    gnss, imu = config.gnss, config.imu
    noises = [gnss.position_std, gnss.height_std, gnss.velocity_std, gnss.timing_std]
    noises += [imu.accel_noise, imu.gyro_noise]
    floor = np.log(np.maximum(noises, 1e-9))
    theta: Array = np.clip(np.array([delay, *gnss.lever_arm, *floor]), LOW, HIGH)
    return theta


# What is done with one flight


def _opened(source: Source, config: Config) -> tuple[Recording, list[int]] | str:
    """Return a flight and where what counts of it begins and ends; else why it cannot be used."""
    try:
        with source.opened() as path:
            recording = read(path, config)
    except CompanionError as error:
        return str(error).split(f"{source.name}: ")[-1]
    if not (recording.events.kind == Kind.GNSS).any():
        return "holds no GNSS fix"
    table = Pipeline(config, recording.family, recording.gnss_delay).run(recording.events)
    located = np.flatnonzero(table.column("status") >= Status.OK)
    if not len(located):
        return "no position could be estimated"
    begin, end = (float(table.stamp_ns[i]) * 1e-9 for i in (located[0], -1))
    if end - begin < SETTLING + SHORTEST:
        return f"only {end - begin:.0f} s with a position, of {SETTLING + SHORTEST:.0f} at least"
    return recording, cuts_at(recording, np.array([begin + SETTLING, end]))


class Likelihood:
    """The log-likelihood of a flight by parameters."""

    def __init__(self, recording: Recording, cuts: Sequence[int], config: Config) -> None:
        """Take a flight between two cuts."""
        values = recording.events.values.copy()
        velocity_std = range(*GNSS_STD.indices(values.shape[1]))[2]
        values[recording.events.kind == Kind.GNSS, velocity_std] = UNSTATED
        self._recording = replace(recording, events=replace(recording.events, values=values))
        self._cuts, self._config, self._rows = cuts, config, 0

    def __call__(self, theta: Array) -> float:
        """Return it; rows that were not judged count as the mean of the rest.

        These are few: where a filter had to restart. The first call settles how many there are.
        """
        sums, rows = likelihood(self._recording, known(self._config, theta), self._cuts)
        self._rows = self._rows or rows
        return float(sums.sum()) * self._rows / rows if rows else -math.inf


def search(source: Source, config: Config) -> Array | str:
    """Return the likeliest parameters of one flight alone; else why there are none."""
    from scipy.optimize import minimize

    if isinstance(found := _opened(source, config), str):
        return found
    of = Likelihood(*found, config)
    done: Any = minimize(
        lambda x: -of(x * SCALE),
        BEGIN / SCALE,
        method="Powell",
        bounds=np.stack([LOW, HIGH], axis=1) / SCALE[:, None],
        options={"xtol": CLOSE, "ftol": 1e-9, "maxiter": SEARCHES},
    )
    likeliest: Array = done.x * SCALE
    return likeliest


def look(source: Source, theta: Array, config: Config) -> Look | str:
    """Return the likelihood of a flight about some parameters; else why there is none."""
    if isinstance(found := _opened(source, config), str):
        return found
    of, h = Likelihood(*found, config), np.diag(STEPS)
    value, slope, curvature = of(theta), np.zeros(N), np.zeros((N, N))
    side = np.zeros(N)
    for i in range(N):
        up, down = of(theta + h[i]), of(theta - h[i])
        slope[i] = (up - down) / (2.0 * STEPS[i])
        side[i] = up + down - 2.0 * value
        curvature[i, i] = side[i] / STEPS[i] ** 2
    for i, j in combinations(range(N), 2):
        both = of(theta + h[i] + h[j]) + of(theta - h[i] - h[j]) - 2.0 * value
        mixed = 0.5 * (both - side[i] - side[j]) / (STEPS[i] * STEPS[j])
        curvature[i, j] = curvature[j, i] = mixed
    if not np.isfinite([value, *slope]).all():
        return "its fixes cannot be judged with these parameters"
    recording = found[0]
    late = delays_ns(config, recording.family, recording.gnss_delay)[Kind.GNSS]
    return Look(value, slope, curvature, float(late) * 1e-9)


def gain(
    item: tuple[Source, Array], is_shown: Mask, std: tuple[float, float], config: Config
) -> tuple[float, float] | str:
    """Return a flight's gains in log-likelihood with fixed noise and with learnt; else why none."""
    source, theta = item
    if isinstance(found := _opened(source, config), str):
        return found
    values, rows = [], 0
    for one in (
        config,
        tuned(config, theta, is_shown, std, learns=False),
        tuned(config, theta, is_shown, std, learns=True),
    ):
        sums, judged = likelihood(found[0], one, found[1])
        rows = rows or judged
        values.append(float(sums.sum()) * rows / max(judged, 1))
    return values[1] - values[0], values[2] - values[0]


# What is done with all flights


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
    # A parameter that no flight feels does not scatter either
    sigma = np.maximum(jackknife_sigma(others), information_sigma(looks))
    half = float(t.ppf(0.975, len(looks) - 1)) * sigma
    present = configured(config, float(np.median([one.delay for one in looks])))
    is_shown = (half <= SURE) | (np.abs(present - theta) > half)
    std = (
        max(math.hypot(sigma[DELAY], between_flights(looks)), LEAST_DELAY_STD),
        max(float(sigma[ARM].max()), LEAST_ARM_STD),
    )
    return Fit(
        values=_outer(theta),
        low=_outer(np.clip(theta - half, LOW, HIGH)),
        high=_outer(np.clip(theta + half, LOW, HIGH)),
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
            # Every so many, so that all parts of a long list are heard
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
