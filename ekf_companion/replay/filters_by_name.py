"""The filters by name: our own estimator and its rivals, over the same recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.core import state as at
from ekf_companion.core.field import Field
from ekf_companion.core.settings import FilterSettings, delays_ns
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.filters import (
    ahrs,
    ahrs_article,
    euler,
    iterated,
    mahony,
    ukf,
    vqf_adapter,
    zupt,
)
from ekf_companion.filters.detector import Detector
from ekf_companion.filters.solution import COVARIANCE_PERIOD_NS, Solution
from ekf_companion.logs.recording import Recording, one_course
from ekf_companion.nav.measurements import Events
from ekf_companion.nav.state import Status, join

Run = Callable[[Recording, FilterSettings, str], Solution]
"""Recording, settings and option in, solution out."""

BLOCKS = [*range(at.E_ATT, at.E_ATT + 3), *range(at.E_VEL, at.E_VEL + 3)]
BLOCKS += range(at.E_POS, at.E_POS + 3)
"""Where the estimator's covariance holds what a solution keeps of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Filter:
    """A filter that can be named."""

    run: Run
    options: tuple[str, ...]
    """What may follow the colon; the first is the default."""
    about: str
    """In one line."""


def run_filter(
    recording: Recording, name: str = "eskf", settings: FilterSettings | None = None
) -> Solution:
    """Run a filter over a recording.

    Args:
        recording: As ``open_log`` gives it.
        name: ``NAME`` or ``NAME:OPTION`` of :data:`FILTERS`.
        settings: The estimator's, or a whole configuration; None: the defaults.

    Raises:
        ConfigError: There is no filter, or no option, of that name.
        LogError: The recording lacks what the filter needs.
    """
    label, option = parse_name(name)
    # A filter cannot follow a clock that restarts
    events, notes = one_course(recording.events)
    recording = replace(recording, events=events)
    run = FILTERS[label.partition(":")[0]].run
    found = run(recording, settings or FilterSettings(), option)
    return replace(found, name=label, notes=(*found.notes, *notes))


def parse_name(name: str) -> tuple[str, str]:
    """Return the name to print and the option of ``NAME`` or ``NAME:OPTION``.

    Raises:
        ConfigError: There is none of that name.
    """
    known, colon, option = name.strip().partition(":")
    if known not in FILTERS:
        raise ConfigError(f"{name!r}: unknown filter; known are {', '.join(FILTERS)}")
    options = FILTERS[known].options
    if colon and option not in options:
        others = ", ".join(f"{known}:{one}" for one in options) or f"{known} alone"
        raise ConfigError(f"{name!r}: unknown option; known are {others}")
    return name.strip(), option or (options[0] if options else "")


def _eskf(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    """Run the daemon's own pipeline over it, in pieces, to sample the covariance."""
    del option
    pipeline = Pipeline(settings, recording.family, recording.gnss_delay)
    events = recording.events
    if not len(events):
        raise LogError("holds no measurement")
    slots = np.maximum.accumulate(events.t_ns) // COVARIANCE_PERIOD_NS
    tables, stamps, kept = [], [], []
    for rows in np.split(np.arange(len(events)), np.flatnonzero(np.diff(slots)) + 1):
        tables.append(pipeline.run(events.take(rows)))
        state = pipeline.state()
        if len(tables[-1]) and tables[-1].column("status")[-1] >= Status.OK:
            P = state.block[at.X_COV : at.X_COV + at.N * at.N].reshape(at.N, at.N)
            stamps.append(pipeline.stamp_ns)
            kept.append(P[np.ix_(BLOCKS, BLOCKS)].copy())
    health = pipeline.health()
    return Solution(
        name="eskf",
        table=join(tables),
        covariance_ns=np.array(stamps, dtype=np.int64),
        covariance=np.array(kept).reshape(-1, 9, 9),
        counts={
            aid.name.lower(): (
                health.verdicts[aid][Verdict.FUSED] + health.verdicts[aid][Verdict.DEWEIGHTED],
                health.verdicts[aid][Verdict.GATED],
            )
            for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY, Aid.HEADING)
        },
    )


def _euler(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    return euler.run(
        recording.events,
        settings,
        recording.family,
        recording.gnss_delay,
        preset="article" if option == "article" else "corrected",
    )


def _zupt(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    events = _completed(recording, settings)
    return zupt.run(events, detector=Detector(option), gap=settings.imu.gap_reset)


def _iterated(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    return iterated.run(
        recording.events,
        settings,
        recording.family,
        recording.gnss_delay,
        frame="robocentric" if option == "robocentric" else "global",
        gravity="sphere" if option == "sphere" else "known",
    )


def _ukf(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    del option
    return ukf.run(recording.events, settings, recording.family, recording.gnss_delay)


def _ahrs(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    events = _completed(recording, settings)
    if option == "error-state":
        return ahrs.run(events)
    preset: ahrs_article.Preset = "article" if option == "article" else "corrected"
    return ahrs_article.run(events, preset, gap=settings.imu.gap_reset)


def _mahony(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    del option
    return mahony.run(_completed(recording, settings), gap=settings.imu.gap_reset)


def _vqf(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    del option
    return vqf_adapter.run(_completed(recording, settings), gap=settings.imu.gap_reset)


def _completed(recording: Recording, settings: FilterSettings) -> Events:
    """Return the events at the times when they were true, with declination, without hard iron."""
    events = recording.events
    late_ns = delays_ns(settings, recording.family, recording.gnss_delay)
    values = Field(settings.heading).complete_all(events)
    return replace(events, t_ns=events.t_ns - late_ns[events.kind], values=values)


FILTERS: Mapping[str, Filter] = {
    "eskf": Filter(run=_eskf, options=(), about="our own estimator, as it flies"),
    "euler": Filter(
        run=_euler,
        options=("corrected", "article"),
        about="the seed article's direct filter of Euler angles; as published, with its slips",
    ),
    "iterated": Filter(
        run=_iterated,
        options=("global", "robocentric", "sphere"),
        about="iterated error-state filter of LINS and FAST-LIO",
    ),
    "ukf": Filter(run=_ukf, options=(), about="unscented filter on the manifold"),
    "zupt": Filter(
        run=_zupt,
        options=tuple(one.value for one in Detector),
        about="inertial navigation of a foot or a wheel, held by its own rests",
    ),
    "ahrs": Filter(
        run=_ahrs,
        options=("error-state", "corrected", "article"),
        about="attitude alone: our own; the article's, corrected or with its slips",
    ),
    "mahony": Filter(run=_mahony, options=(), about="attitude alone: complementary, on SO(3)"),
    "vqf": Filter(run=_vqf, options=(), about="attitude alone: the published package (extra: vqf)"),
}
"""The filters of ``--filters`` and :func:`run_filter`, by name."""
