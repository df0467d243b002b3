"""Delay of the receiver's fixes by maximum likelihood.

The estimator runs over the log once for each delay tried, and sums the log-likelihood of every
position, height and velocity that it judges (:attr:`Pipeline.log_likelihood`). The sum is highest
at the delay at which GNSS and inertial sensors agree on the motion: found on a grid, then by golden
section, and then smoothed, since the noise of the inertial samples about each fix makes the sum
rough: the result is the top of a parabola through the sums nearby.

Its 95 % interval ends where the parabola has lost 1.92. Innovations that are correlated from one
fix to the next carry less information than independent ones. So the sum is taken by blocks of some
seconds; if the blocks' slopes at the top scatter more than the curvature of their sum predicts, the
1.92 is multiplied by that ratio of variances ("sandwich").

Source: Maybeck 1982, vol. 2, ch. 10 (maximum likelihood by innovations); White 1982, Econometrica
50, 1 (misspecified likelihoods); Newey and West 1987, Econometrica 55, 3 (neighbouring blocks);
Kiefer 1953 (golden section).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from ekf_companion.calibrate import rest
from ekf_companion.calibrate.likelihood import Likelihood
from ekf_companion.calibrate.result import Result, Setting, rounded
from ekf_companion.core.from_settings import delays_ns
from ekf_companion.core.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status, Table

Progress = Callable[[int, int], None]

SPAN = (-0.2, 0.6)
"""Range of delays tried, s: no receiver is later, and a correct stamp is not early."""
STEP = 0.02
"""Step of the grid of delays, s."""
FINE = 0.001
"""Resolution of the search, s."""
DROP = 1.92
"""Loss of log-likelihood at the ends of a 95 % interval: half the chi-square quantile, 1 dof."""
BLOCK = 4.0
"""Length of the blocks, s: longer than innovations are correlated."""
FEWEST_BLOCKS = 5
SETTLING = 5.0
"""Time after the first position that is not counted, s: the filter is settling."""
NEAR = 10.0
"""Loss from the best sum within which the parabola is fitted."""
POINTS = 25
"""Number of delays that it is fitted to."""
WIDEST = 0.05
"""Largest half interval of a delay that the motion shows, s."""
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


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
    """Ratio of variances, >= 1, by which the scatter of the blocks widened the interval."""
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
    pipeline = Pipeline(settings, recording.family, recording.gnss_delay)
    table = pipeline.run(recording.events)
    begin, end = _counted(table, name)
    edges = np.linspace(begin, end, int((end - begin) / BLOCK) + 1)
    likelihood = Likelihood(recording, settings, edges)
    best, low, high, widening = _maximise(likelihood, name, progress)
    configured = delays_ns(settings, recording.family, recording.gnss_delay)[Kind.GNSS] * 1e-9
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
        learnt=float(configured) + pipeline.health().gnss_delay,
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
    for done, delay in enumerate(grid, 1):
        likelihood.total(float(delay))
        if progress is not None:
            progress(done, len(grid) + 60)  # some 60 more are tried near the best
    if likelihood.rows == 0:
        raise LogError(f"{name}: no fix after the first seconds, so no delay can be seen in it")
    best = likelihood.best()
    _golden(likelihood, best - STEP, best + STEP)
    best = likelihood.best()
    reach = max(abs(_edge(likelihood, best, side, NEAR) - best) for side in (-1.0, 1.0))
    while True:
        centre, half, widening = _parabola(likelihood, best, reach)
        if 2.0 * half <= reach or reach >= SPAN[1] - SPAN[0]:
            break
        reach *= 2.0
    # Another delay, far off, may be as likely, where the motion repeats itself
    delays, gain = likelihood.curve()
    likely = delays[gain >= -DROP * widening]
    low, high = min(centre - half, float(likely[0])), max(centre + half, float(likely[-1]))
    return centre, low, high, widening


def _parabola(likelihood: Likelihood, best: float, reach: float) -> tuple[float, float, float]:
    """Return the top of a parabola through the sums near the best, its half interval, the widening.

    Each block has a parabola of its own; the widening is the scatter of their slopes at the top,
    neighbours counted together, over the curvature.
    """
    delays = np.linspace(max(best - reach, SPAN[0]), min(best + reach, SPAN[1]), POINTS)
    blocks = np.stack([likelihood.scaled(float(delay)) for delay in delays])
    offset = (delays - best) / reach
    powers = np.stack([np.ones(POINTS), offset, offset**2], axis=1)
    terms = np.linalg.lstsq(powers, blocks, rcond=None)[0]
    curvature = -2.0 * float(terms[2].sum())
    if curvature <= 0.0:
        return best, reach, math.inf
    top = float(terms[1].sum()) / curvature
    slope = terms[1] + 2.0 * terms[2] * top
    scatter = float(slope @ slope + slope[1:] @ slope[:-1]) * len(slope) / (len(slope) - 1)
    few = float(t.ppf(0.975, len(slope) - 1)) / 1.96
    widening = max(scatter / curvature, 1.0) * few**2
    return best + top * reach, reach * math.sqrt(2.0 * DROP * widening / curvature), widening


def _golden(likelihood: Likelihood, low: float, high: float) -> None:
    """Try delays between two limits until the best is known to ``FINE``."""
    inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
    while high - low > FINE:
        if likelihood.total(inner[0]) > likelihood.total(inner[1]):
            high, inner = inner[1], [inner[1] - GOLDEN * (inner[1] - low), inner[0]]
        else:
            low, inner = inner[0], [inner[1], inner[0] + GOLDEN * (high - inner[0])]


def _edge(likelihood: Likelihood, best: float, side: float, drop: float) -> float:
    """Return the delay at which the sum has lost ``drop``, on one side of the best."""
    level = likelihood.total(best) - drop
    inside, step = 0.0, FINE
    while likelihood.total(best + side * (inside + step)) > level:
        inside, step = inside + step, 2.0 * step
        if not SPAN[0] < best + side * (inside + step) < SPAN[1]:
            return SPAN[0] if side < 0.0 else SPAN[1]
    outside = inside + step
    while outside - inside > 0.25 * FINE:
        middle = 0.5 * (inside + outside)
        if likelihood.total(best + side * middle) > level:
            inside = middle
        else:
            outside = middle
    return best + side * outside


def _acceleration(table: Table, begin: float) -> float:
    """Return the RMS of the horizontal acceleration from a time on, over whole seconds, m/s^2."""
    velocity = np.stack([table.column("vel_n"), table.column("vel_e")])
    known = np.isfinite(velocity).all(axis=0)
    seconds = table.stamp_ns[known] * 1e-9
    at = np.arange(begin, seconds[-1], 1.0)
    even = np.stack([np.interp(at, seconds, axis[known]) for axis in velocity])
    return float(np.sqrt(np.mean(np.sum(np.diff(even, axis=1) ** 2, axis=0))))
