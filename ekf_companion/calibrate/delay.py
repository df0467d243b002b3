"""Delay of the receiver's fixes by maximum likelihood.

The estimator runs over the log once for each delay tried, and sums the log-likelihood of every
position, height and velocity that it judges (:attr:`Pipeline.log_likelihood`). The sum is highest
at the delay at which GNSS and inertial sensors agree on the motion. The noise of the inertial
samples is one for all delays, as configured, or as learnt in a first run if that is more: noise
that is learnt anew, and doubt in the samples, would explain a wrong delay away.

The top is found on a grid, then on a fine one, and then smoothed, since the noise of the inertial
samples about each fix makes the sum rough: the result is the top of a parabola through the sums
nearby.

Its 95 % interval holds two. The one ends where the parabola has lost 1.92. Innovations that are
correlated from one fix to the next carry less information than independent ones. So the sum is
taken by blocks of some seconds; if the blocks' slopes at the top scatter more than the curvature of
their sum predicts, the 1.92 is multiplied by that ratio of variances ("sandwich"). But a fix that a
gate refuses, or a reset, changes the sum by tens from one delay to the next: a few such blocks make
a narrow peak that has nothing to do with the delay. So the other interval asks what the top would
be had other blocks been flown: the blocks are drawn again, with repetition, many times.

Source: Maybeck 1982, vol. 2, ch. 10 (maximum likelihood by innovations); White 1982, Econometrica
50, 1 (misspecified likelihoods); Newey and West 1987, Econometrica 55, 3 (neighbouring blocks);
Kuensch 1989, Annals of Statistics 17, 3 (bootstrap of blocks).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.calibrate import rest
from ekf_companion.calibrate.likelihood import Likelihood
from ekf_companion.calibrate.result import Result, Setting, rounded
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import LogError, part_of
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Kind

with part_of("calibrate", "calibrate"):
    from scipy.stats import t
from ekf_companion.nav.state import Status, Table

Progress = Callable[[int, int], None]

SPAN = (-0.2, 0.6)
"""Range of delays tried, s: no receiver is later, and a correct stamp is not early."""
STEP = 0.02
"""Step of the grid of delays, s; within as much of its top the sum is smoothed by a parabola."""
FINE = 0.005
"""Step near the best, s."""
NEAR = 0.08
"""Distance from the best within which that step is used, s."""
DROP = 1.92
"""Loss of log-likelihood at the ends of a 95 % interval: half the chi-square quantile, 1 dof."""
BLOCK = 4.0
"""Length of the blocks, s: longer than innovations are correlated."""
FEWEST_BLOCKS = 5
SETTLING = 5.0
"""Time after the first position that is not counted, s: the filter is settling."""
DRAWS = 500
"""How often the blocks are drawn again."""
BIASED = 10.0
"""Widening beyond which the innovations are anything but independent."""
MOST_BIAS = 0.045
"""Largest half interval that the filter's own estimate asks for, s."""
WIDEST = 0.05
"""Largest half interval of a delay that the motion shows, s."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Delay:
    """The likelihood by delay, and the delay that it shows."""

    delays: Array
    """All delays tried, ascending, s."""
    gain: Array
    """Log-likelihood of each over that of the best."""
    best: float
    """s."""
    low: float
    """Lower end of the 95 % interval, s."""
    high: float
    widening: float
    """Square of the interval's width over that by independent innovations, >= 1."""
    rows: int
    """Number of positions, heights and velocities judged."""
    seconds: float
    """Length of the time counted, s."""
    acceleration: float
    """RMS of the horizontal acceleration in that time, m/s^2."""
    learnt: float
    """The delay that the filter estimates by itself in flight, s."""


def measure(
    recording: Recording,
    settings: FilterSettings,
    name: str = "the log",
    progress: Progress | None = None,
) -> Delay:
    """Measure the delay of a log's fixes, whatever the log and the settings declare.

    The log is on one run of the clock. The progress gets the delays done, and of how many.

    Raises:
        LogError: The log has no inertial samples or no fixes, or its motion does not show a delay.
    """
    for kind, what in ((Kind.IMU, "no inertial samples"), (Kind.GNSS, "no GNSS fix")):
        if not np.count_nonzero(recording.events.kind == kind):
            raise LogError(f"{name}: holds {what}, so the delay of fixes cannot be seen in it")
    rate = rest.rate(recording.events)
    if rate < rest.SLOW:
        raise LogError(
            f"{name}: inertial samples come at {rate:.1f} Hz, below the {rest.SLOW:.0f} Hz that "
            "motion can be integrated from, so no delay can be seen; ask for a faster stream"
        )
    # the fault hypotheses would explain what a wrong delay does
    settings = replace(settings, weigh_faults="off")
    pipeline = Pipeline(settings, recording.family, recording.gnss_delay)
    table = pipeline.run(recording.events)
    begin, end = _counted(table, name)
    edges = np.linspace(begin, end, int((end - begin) / BLOCK) + 1)
    likelihood = Likelihood(recording, _steady(settings, pipeline), edges)
    best, low, high, widening = _maximise(likelihood, name, progress)
    configured = delays_ns(settings, recording.family, recording.gnss_delay)[Kind.GNSS] * 1e-9
    learnt = float(configured) + pipeline.health().gnss_delay
    if widening > BIASED:
        # clipped or shaken samples bias all blocks alike, and the filter's own estimate otherwise
        half = min(abs(best - learnt), MOST_BIAS)
        low, high = min(low, best - half), max(high, best + half)
    delays, gain = likelihood.curve()
    found = Delay(
        delays=delays,
        gain=gain,
        best=best,
        low=low,
        high=high,
        widening=widening,
        rows=likelihood.rows,
        seconds=end - begin,
        acceleration=_acceleration(table, begin),
        learnt=learnt,
    )
    is_edge = not SPAN[0] + STEP < best < SPAN[1] - STEP
    if is_edge or 0.5 * (high - low) > WIDEST:
        raise LogError(
            f"{name}: its motion does not show the delay of fixes: anything from {low:.2f} to "
            f"{high:.2f} s fits (horizontal acceleration {found.acceleration:.2f} m/s2 RMS in "
            f"{found.seconds:.0f} s); fly starts, stops and turns, 1 m/s2 and more, for a minute"
        )
    return found


def result(found: Delay) -> Result:
    """Return a measured delay as keys of the configuration."""
    sigma = max((found.high - found.low) / 3.92, 0.002)
    notes = [
        f"{found.rows} innovations of GNSS in {found.seconds:.0f} s, horizontal acceleration "
        f"{found.acceleration:.1f} m/s2 RMS",
        f"the estimator by itself finds {found.learnt:.3f} s in this flight",
    ]
    if found.widening > 1.5:
        notes.append(
            f"the interval is {math.sqrt(found.widening):.1f} times as wide as independent "
            "innovations would make it"
        )
    return Result(
        settings=[
            Setting(
                key="gnss.delay",
                value=round(found.best, 3),
                comment=f"s; 95 %: {found.low:.3f} to {found.high:.3f}",
            ),
            Setting(
                key="gnss.delay_std",
                value=math.ceil(sigma * 1e3) / 1e3,
                comment="s; of that interval. auto lets the estimator move it more",
            ),
        ],
        notes=notes,
        data={
            "delay_s": found.best,
            "interval_s": [found.low, found.high],
            "widening": found.widening,
            "learnt_s": found.learnt,
            "acceleration_mps2": found.acceleration,
            "curve": {"delay_s": rounded(found.delays), "log_likelihood": rounded(found.gain)},
        },
    )


def _steady(settings: FilterSettings, pipeline: Pipeline) -> FilterSettings:
    """Return the settings with one noise of the inertial samples, whatever a delay makes of it."""
    learnt = pipeline.health()
    imu = replace(
        settings.imu,
        gyro_noise=max(settings.imu.gyro_noise, learnt.gyro_noise),
        accel_noise=max(settings.imu.accel_noise, learnt.accel_noise),
        learn_noise=False,
    )
    return replace(settings, imu=imu)


def _counted(table: Table, name: str) -> tuple[float, float]:
    """Return begin and end of the time that counts, s of the stamps."""
    located = np.flatnonzero(table.column("status") >= Status.OK)
    if not len(located):
        raise LogError(
            f"{name}: no position could be estimated, so the delay of fixes cannot be seen in it; "
            "`ekf-companion convert` says what is lacking"
        )
    begin = float(table.stamp_ns[located[0]]) * 1e-9 + SETTLING
    end = float(table.stamp_ns[-1]) * 1e-9
    if end - begin < FEWEST_BLOCKS * BLOCK:
        raise LogError(
            f"{name}: only {max(end - begin, 0.0):.0f} s with a position; the delay needs "
            f"{FEWEST_BLOCKS * BLOCK:.0f} s, better some minutes"
        )
    return begin, end


def _maximise(
    likelihood: Likelihood, name: str, progress: Progress | None
) -> tuple[float, float, float, float]:
    """Return the likeliest delay, the ends of its interval, and the widening."""
    grid = np.arange(SPAN[0], SPAN[1] + 0.5 * STEP, STEP)
    fine = np.arange(-NEAR, NEAR + 0.5 * FINE, FINE)
    for done, delay in enumerate(grid, 1):
        likelihood.total(float(delay))
        if progress is not None:
            progress(done, len(grid) + len(fine))
    if likelihood.rows == 0:
        raise LogError(f"{name}: no fix after the first seconds, so no delay can be seen in it")
    near = likelihood.best() + fine
    for delay in near[(near >= SPAN[0]) & (near <= SPAN[1])]:
        likelihood.total(float(delay))
    delays = likelihood.curve()[0]
    blocks = np.stack([likelihood.scaled(float(delay)) for delay in delays])
    best = _top(delays, blocks.sum(axis=1))
    low, high = _redrawn(delays, blocks, best)
    independent, half = _by_scatter(delays, blocks, best)
    low, high = min(low, best - half), max(high, best + half)
    return best, low, high, (0.5 * (high - low) / independent) ** 2 if half < math.inf else math.inf


def _top(delays: Array, sums: Array) -> float:
    """Return the top of the parabola through the sums near the largest."""
    middle = delays[np.argmax(sums)]
    offset = (delays - middle) / STEP
    near = np.abs(offset) < 1.001
    if np.count_nonzero(near) < 3:  # at the end of the range
        return float(middle)
    curve, slope, _ = np.polyfit(offset[near], sums[near], 2)
    return float(middle + STEP * (np.clip(-0.5 * slope / curve, -1.0, 1.0) if curve < 0.0 else 0.0))


def _redrawn(delays: Array, blocks: Array, best: float) -> tuple[float, float]:
    """Return the ends of the 95 % interval of the tops with the blocks drawn again.

    The percentiles of a few blocks scatter too little, as a variance about a mean does.
    """
    n = blocks.shape[1]
    weights = np.random.default_rng(n).multinomial(n, np.full(n, 1.0 / n), size=DRAWS)
    tops = [_top(delays, sums) for sums in weights @ blocks.T]
    low, high = np.percentile(tops, [2.5, 97.5]) - best
    few = float(t.ppf(0.975, n - 1)) / 1.96 * math.sqrt(n / (n - 1))
    return best + few * min(float(low), 0.0), best + few * max(float(high), 0.0)


def _by_scatter(delays: Array, blocks: Array, best: float) -> tuple[float, float]:
    """Return the half 95 % interval by the curvature alone, and by the scatter of the slopes too.

    Each block has a parabola of its own; the scatter is that of their slopes at the top,
    neighbours counted together.
    """
    reach = STEP
    while True:
        offset = (delays - best) / reach
        near = np.abs(offset) < 1.001
        powers = np.stack([np.ones_like(offset), offset, offset**2], axis=1)[near]
        terms = np.linalg.lstsq(powers, blocks[near], rcond=None)[0]
        curvature = -2.0 * float(terms[2].sum())
        half = independent = math.inf
        if curvature > 0.0:
            slope = terms[1] + 2.0 * terms[2] * float(terms[1].sum()) / curvature
            scatter = float(slope @ slope + slope[1:] @ slope[:-1]) * len(slope) / (len(slope) - 1)
            few = float(t.ppf(0.975, len(slope) - 1)) / 1.96
            independent = reach * math.sqrt(2.0 * DROP / curvature)
            half = independent * few * math.sqrt(max(scatter / curvature, 1.0))
        if 2.0 * half <= reach or reach >= NEAR:
            return independent, half
        reach *= 2.0


def _acceleration(table: Table, begin: float) -> float:
    """Return the RMS of the horizontal acceleration from a time on, over whole seconds, m/s^2."""
    velocity = np.stack([table.column("vel_n"), table.column("vel_e")])
    known = np.isfinite(velocity).all(axis=0)
    seconds = table.stamp_ns[known] * 1e-9
    at = np.arange(begin, seconds[-1], 1.0)
    even = np.stack([np.interp(at, seconds, axis[known]) for axis in velocity])
    return float(np.sqrt(np.mean(np.sum(np.diff(even, axis=1) ** 2, axis=0))))
