"""The filters by name: our own estimator and those of the articles, over the same recording.

Each is imported when it is run: some need much of SciPy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from ekf_companion.core.memory.enums import E_ATT, E_DELAY, E_POS, E_VEL
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.settings.field import Field
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.faults import NO_EVIDENCE, FaultEvidence, FoundFault
from ekf_companion.engine.health import Aid, Health
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.filters.solution import COVARIANCE_PERIOD_NS, Solution
from ekf_companion.filters.zupt_detector import Detector
from ekf_companion.logs.recording import Recording, longest_clock_run
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status, join
from ekf_companion.replay.moments import Moment
from ekf_companion.replay.own_checks import check_callable, check_solution, checked_aids

if TYPE_CHECKING:
    from ekf_companion.filters.ahrs_article import Preset
    from ekf_companion.filters.observation import Observation
    from ekf_companion.filters.sequence import MeasurementSequence

FilterName = Literal[
    "eskf",
    "euler",
    "euler:corrected",
    "euler:article",
    "iterated",
    "iterated:global",
    "iterated:robocentric",
    "iterated:sphere",
    "ukf",
    "zupt",
    "zupt:shoe",
    "zupt:mv",
    "zupt:mag",
    "zupt:are",
    "ahrs",
    "ahrs:error-state",
    "ahrs:corrected",
    "ahrs:article",
    "mahony",
    "vqf",
]
"""The filters, with their options."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EskfSolution(Solution):
    """The result of the daemon's own pipeline."""

    faults: tuple[FoundFault, ...] = ()
    """What was wrong beyond doubt, where ``weigh_faults`` asks for it."""
    evidence: FaultEvidence = NO_EVIDENCE
    """How probable each source's fault was over time."""


Run = Callable[[Recording, FilterSettings, str], Solution]
"""Recording, settings and option in, solution out."""

Over = Callable[["MeasurementSequence", str], Solution]
"""A filter over fixes and headings, with its option."""

EARLIEST, LATEST = -0.2, 0.35
"""Delays that a filter estimates beyond the declared one, s: of the receivers of 35 recordings
and 18 simulated flights they are from -0.09 to 0.19."""
SURE = 5.0
"""Sigmas of the estimated delay by which it must differ from the declared one."""

BLOCKS = [first + axis for first in (E_ATT, E_VEL, E_POS) for axis in range(3)]
"""Where the estimator's covariance holds what a solution keeps of it."""


class Filter(NamedTuple):
    """A filter that can be selected."""

    run: Run
    options: tuple[str, ...] = ()
    """Options after the colon; the first is the default."""


def run_filter(
    recording: Recording,
    name: FilterName | str | Run = "eskf",
    settings: FilterSettings | None = None,
    *,
    aids: Sequence[tuple[Moment, Observation]] = (),
) -> Solution:
    """Run a filter over a recording.

    Args:
        recording: From ``open_log``.
        name: ``NAME`` or ``NAME:OPTION`` of :data:`FILTERS`; or a filter of your own, a function of
            recording, settings and option (empty).
        settings: The estimator's, or a whole configuration; None: the defaults.
        aids: Measurements of your own for ``euler``, ``iterated`` and ``ukf``, with the times at
            which they were true (floats in s, integers in ns, or dates): see
            :class:`~ekf_companion.filters.own_aid.OwnAid`.

    Raises:
        ConfigError: There is no filter, or no option, of that name, or it takes no aids.
        DataError: Your filter, an aid of yours or its time cannot be meant.
        LogError: The recording lacks what the filter needs.
    """
    said: tuple[str, ...] = ()
    if callable(name):
        label, option, run = getattr(name, "__name__", "own filter"), "", name
        check_callable(label, name)
    else:
        if not isinstance(name, str):
            raise ConfigError(
                f"filter: {name!r:.60} is none: give a name ({', '.join(FILTERS)}), or a function "
                "of recording, settings and option"
            )
        label, option = parse_name(name)
        run = FILTERS[label.partition(":")[0]].run
    if aids:
        over = None if callable(name) else _OVER.get(label.partition(":")[0])
        if over is None:
            raise ConfigError(f"{label}: takes no aids of your own; {', '.join(_OVER)} do")
        own, said = checked_aids(aids, recording.events.t_ns[[0, -1]])
        run = partial(_run_with, over, own)
    # A filter cannot follow a clock that restarts
    events, notes = longest_clock_run(recording.events)
    recording = replace(recording, events=events)
    if label.partition(":")[0] in _OVER and not callable(name):
        # SciPy brings a BLAS of its own, which has no limit if it is loaded within one
        import_module(f"ekf_companion.filters.{label.partition(':')[0]}")
    # On matrices of 15 rows the threads of a BLAS only wait for each other
    with threadpool_limits(1, "blas"):
        found = run(recording, settings or FilterSettings(), option)
    if callable(name):
        check_solution(label, found)
    return replace(found, name=label, notes=(*found.notes, *notes, *said))


def parse_name(name: str) -> tuple[str, str]:
    """Return the name to print and the option of ``NAME`` or ``NAME:OPTION``.

    Raises:
        ConfigError: There is no filter, or no option, of that name.
    """
    known, colon, option = name.strip().partition(":")
    if known not in FILTERS:
        raise ConfigError(f"{name!r}: unknown filter; known are {', '.join(FILTERS)}")
    options = FILTERS[known].options
    if colon and option not in options:
        others = ", ".join(f"{known}:{one}" for one in options) or f"{known} alone"
        raise ConfigError(f"{name!r}: unknown option; known are {others}")
    return name.strip(), option or (options[0] if options else "")


def _eskf(recording: Recording, settings: FilterSettings, _: str) -> Solution:
    """Run the daemon's own pipeline in pieces, to record the covariance."""
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
            P = np.array(as_state(state.block).P)
            stamps.append(pipeline.stamp_ns)
            kept.append(P[np.ix_(BLOCKS, BLOCKS)])
    health = pipeline.health()
    return EskfSolution(
        name="eskf",
        faults=tuple(pipeline.found_faults()),
        evidence=pipeline.fault_evidence(),
        table=join(tables),
        covariance_ns=np.array(stamps, dtype=np.int64),
        covariance=np.array(kept).reshape(-1, 9, 9),
        counts=counts_of(health),
        notes=late_fixes(pipeline, settings, recording),
    )


def late_fixes(
    pipeline: Pipeline, settings: FilterSettings, recording: Recording
) -> tuple[str, ...]:
    """Return a note if the filter found fixes to be later, or earlier, than any receiver's."""
    delay, std = pipeline.health().gnss_delay, float(pipeline.filter_state.P[E_DELAY][E_DELAY])
    if EARLIEST < delay < LATEST or abs(delay) < SURE * std**0.5:
        return ()
    declared = delays_ns(settings, recording.family, recording.gnss_delay)[Kind.GNSS] * 1e-9
    side = "later" if delay > 0.0 else "earlier"
    return (
        f"the fixes are {abs(delay):.2f} s {side} than their times say, by the filter's own "
        f"estimate, which no usual receiver is: check the clock, or set gnss.delay to "
        f"{declared + delay:.2f}",
    )


def counts_of(health: Health) -> dict[str, tuple[int, int]]:
    """Return the numbers of fused and of refused measurements, by aid; of rest there are none."""
    return {
        aid.name.lower(): (health.fused(aid), health.refused(aid))
        for aid in Aid
        if aid is not Aid.REST and (aid <= Aid.HEADING or any(health.verdicts[aid].values()))
    }


def _run_with(
    over: Over,
    aids: Sequence[tuple[int, Observation]],
    recording: Recording,
    settings: FilterSettings,
    option: str,
) -> Solution:
    from ekf_companion.filters.sequence import MeasurementSequence

    family, delay = recording.family, recording.gnss_delay
    return over(MeasurementSequence(recording.events, settings, family, delay, aids), option)


def _euler(sequence: MeasurementSequence, option: str) -> Solution:
    from ekf_companion.filters import euler, euler_article

    return (euler_article.run if option == "article" else euler.run)(sequence)


def _zupt(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    from ekf_companion.filters import zupt

    events = _completed(recording, settings)
    return zupt.run(events, detector=Detector(option), gap=settings.imu.gap_reset)


def _iterated(sequence: MeasurementSequence, option: str) -> Solution:
    from ekf_companion.filters import iterated

    return iterated.run(
        sequence,
        frame="robocentric" if option == "robocentric" else "global",
        gravity="sphere" if option == "sphere" else "known",
    )


def _ukf(sequence: MeasurementSequence, _: str) -> Solution:
    from ekf_companion.filters import ukf

    return ukf.run(sequence)


def _ahrs(recording: Recording, settings: FilterSettings, option: str) -> Solution:
    from ekf_companion.filters import ahrs, ahrs_article

    events = _completed(recording, settings)
    if option == "error-state":
        return ahrs.run(events)
    preset: Preset = "article" if option == "article" else "corrected"
    return ahrs_article.run(events, preset, gap=settings.imu.gap_reset)


def _mahony(recording: Recording, settings: FilterSettings, _: str) -> Solution:
    from ekf_companion.filters import mahony

    return mahony.run(_completed(recording, settings), gap=settings.imu.gap_reset)


def _vqf(recording: Recording, settings: FilterSettings, _: str) -> Solution:
    from ekf_companion.filters import vqf_adapter

    return vqf_adapter.run(_completed(recording, settings), gap=settings.imu.gap_reset)


def _completed(recording: Recording, settings: FilterSettings) -> Events:
    """Return the events at their true times, with declination and corrected for iron."""
    events = recording.events
    late_ns = delays_ns(settings, recording.family, recording.gnss_delay)
    values = Field(settings.heading).complete_all(events)
    return Events(t_ns=events.t_ns - late_ns[events.kind], kind=events.kind, values=values)


_OVER: Mapping[str, Over] = {"euler": _euler, "iterated": _iterated, "ukf": _ukf}
FILTERS: Mapping[str, Filter] = {
    "eskf": Filter(_eskf),
    "euler": Filter(partial(_run_with, _euler, ()), ("corrected", "article")),
    "iterated": Filter(partial(_run_with, _iterated, ()), ("global", "robocentric", "sphere")),
    "ukf": Filter(partial(_run_with, _ukf, ())),
    "zupt": Filter(_zupt, tuple(one.value for one in Detector)),
    "ahrs": Filter(_ahrs, ("error-state", "corrected", "article")),
    "mahony": Filter(_mahony),
    "vqf": Filter(_vqf),
}
"""The names of ``--filters`` and :func:`run_filter`; a file of ``filters`` describes each."""
