"""A recording as a sequence of intervals of motion with aids at their ends, and a filter over it.

Events count at the time when they were true: the delays of
:mod:`ekf_companion.core.settings.settings` are subtracted, and an aid between
two inertial samples splits their interval.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Protocol

import numpy as np

from ekf_companion.core.settings.field import Field
from ekf_companion.core.settings.from_settings import delays_ns
from ekf_companion.core.settings.settings import HABITS, FilterSettings
from ekf_companion.errors import FilterError, LogError
from ekf_companion.filters import aiding
from ekf_companion.filters.alignment import InitialEstimate, align
from ekf_companion.filters.gap import IRREGULAR, Lost, lost_motion, over_gap, seen_share
from ekf_companion.filters.gate import Gate
from ekf_companion.filters.inertial import inertial_samples, longest_part
from ekf_companion.filters.observation import Azimuth, Observation
from ekf_companion.filters.solution import Recorder, Solution
from ekf_companion.filters.strapdown import Earth, Interval, Noise, Nominal
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import GNSS_POSITION, Events, Kind

AROUND_NS = 2_000_000_000
"""Largest distance of a fix or a heading from the inertial samples."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Step:
    """An interval, and the aids at its end."""

    t_ns: int
    """End of the interval."""
    over: Interval | None
    """None: the interval is empty."""
    aids: tuple[Observation, ...]
    is_sample: bool
    """The interval ends at an inertial sample: an estimate is due."""
    share: float = 1.0
    """In a gap: the share of what its ends show that is expected."""
    lost: Lost | None = None
    """What the gap hides that ends with the sample."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Setup:
    """The start of a filter: first estimate, Earth, noise and gate."""

    start: InitialEstimate
    earth: Earth
    noise: Noise
    gate: Gate


class NavigationFilter(Protocol):
    """A filter of 15 states, aided by fixes and a heading."""

    @property
    def state(self) -> Nominal:
        """The present estimate."""

    def predict(self, over: Interval) -> None:
        """Predict the estimate over an interval."""

    def inflate(self, Q: Array) -> None:
        """Add to the covariance of the error state, shape (15, 15)."""

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse the aids of one time."""

    def covariance(self) -> Array:
        """Return the covariance of attitude, velocity and position in n, shape (9, 9)."""


class MeasurementSequence:
    """The events of a recording in order of the time when they were true."""

    def __init__(
        self,
        events: Events,
        settings: FilterSettings,
        family: str = "unknown",
        gnss_delay: float | None = None,
        own: Sequence[tuple[int, Observation]] = (),
    ) -> None:
        """Sort events in any order, and select the aids by the daemon's settings.

        The family of the autopilot resolves ``auto`` in them; ``gnss_delay`` is the delay that the
        log declares, s; ``own`` are further aids, with the times at which they were true, ns.

        Raises:
            LogError: There are no inertial samples, no fixes or no heading.
        """
        self._settings, self._family = settings, family
        kind = settings.imu.samples
        self.is_mean = (HABITS[family].imu_samples if kind == "auto" else kind) == "mean"
        """Whether an inertial sample is the mean since the one before."""
        t_ns = events.t_ns - delays_ns(settings, family, gnss_delay)[events.kind]
        values = Field(settings.heading).complete_all(events)
        order = np.lexsort((events.kind, t_ns))
        ordered = Events(t_ns=t_ns[order], kind=events.kind[order], values=values[order])
        imu = inertial_samples(ordered)
        if len(imu) < 2:
            raise LogError("no inertial samples: nothing can be integrated")
        imu, self.notes = longest_part(imu, settings.imu.gap_reset)
        is_near = ordered.t_ns > imu.t_ns[0] - AROUND_NS
        ordered = ordered.take(is_near & (ordered.t_ns < imu.t_ns[-1] + AROUND_NS))
        is_part = (ordered.t_ns >= imu.t_ns[0]) & (ordered.t_ns <= imu.t_ns[-1])
        self._events = ordered.take((ordered.kind != Kind.IMU) | is_part)
        self.t_ns: Stamps = imu.t_ns
        """Times of the inertial samples."""
        self.gyro: Array = imu.values[:, :3]
        """rad/s, b, shape (n, 3)."""
        self.accel: Array = imu.values[:, 3:6]
        """m/s^2, b."""
        fixes = aiding.fixes(ordered, settings)
        self.frame = LocalFrame(*fixes.values[0, GNSS_POSITION].tolist())
        """Of the positions; its origin is the first fix."""
        self.earth = Earth.at(self.frame)
        nearest = np.clip(np.searchsorted(self.t_ns, fixes.t_ns), 0, len(self.t_ns) - 1)
        aids = aiding.fix_observations(fixes, self.gyro[nearest], self.frame, settings)
        aids += aiding.azimuths(ordered, fixes, settings)
        aids += own
        self._usual = float(np.median(np.diff(self.t_ns))) * 1e-9
        self.aids: list[tuple[int, Observation]] = sorted(aids, key=lambda one: one[0])
        """Times and aids, ascending."""

    @property
    def window_ns(self) -> int:
        """Return how old a heading may be at a start that is not the main estimator's, ns."""
        return round(self._settings.align.time * 1e9)

    @property
    def noise(self) -> Noise:
        """The process noise."""
        imu = self._settings.imu
        return Noise(
            gyro=imu.gyro_noise,
            accel=imu.accel_noise,
            gyro_walk=imu.gyro_bias_walk,
            accel_walk=imu.accel_bias_walk,
        )

    def setup(self) -> Setup:
        """Return the start of a filter.

        Raises:
            LogError: The recording ends before level, north and position are known.
        """
        start = align(self._events, self.frame, self._settings, self._family)
        gate = Gate(self._settings.gate)
        return Setup(start=start, earth=self.earth, noise=self.noise, gate=gate)

    def steps(self, after_ns: int) -> Iterator[Step]:
        """Yield the intervals after a time, which must be that of an inertial sample."""
        first = int(np.searchsorted(self.t_ns, after_ns, side="right"))
        later = groupby((one for one in self.aids if one[0] > after_ns), key=lambda one: one[0])
        waiting = deque((t_ns, tuple(aid for _, aid in group)) for t_ns, group in later)
        for k in range(max(first, 1), len(self.t_ns)):
            now, end = self.t_ns[k - 1 : k + 1].tolist()
            span = (end - now) * 1e-9
            lost = lost_motion(span, self._settings.imu.gap, self.gyro[k - 1 : k + 1])
            share = 1.0 if lost is None else seen_share(span, self.gyro[k])
            while waiting and waiting[0][0] <= end:
                at_ns, aids = waiting.popleft()
                over = self._interval(k, now, at_ns)
                yield Step(
                    t_ns=at_ns,
                    over=over,
                    aids=aids,
                    is_sample=at_ns == end,
                    share=share,
                    lost=lost if at_ns == end else None,
                )
                now = at_ns
            if now < end:
                over = self._interval(k, now, end)
                yield Step(t_ns=end, over=over, aids=(), is_sample=True, share=share, lost=lost)

    def _interval(self, k: int, begin: int, end: int) -> Interval | None:
        """Return the measurements between two times within those of samples k - 1 and k."""
        if end <= begin:
            return None
        ends = []
        if self.t_ns[k] - self.t_ns[k - 1] > IRREGULAR * self._usual * 1e9:
            # Of the time that the sample does not stand for, both ends say as much
            middle = [0.5 * (one[k - 1] + one[k]) for one in (self.gyro, self.accel)]
            return Interval(
                dt=(end - begin) * 1e-9,
                gyro0=middle[0],
                gyro1=middle[0],
                accel0=middle[1],
                accel1=middle[1],
            )
        for readings in (self.gyro, self.accel):
            before, after = (readings[k], readings[k]) if self.is_mean else readings[k - 1 : k + 1]
            t0, t1 = int(self.t_ns[k - 1]), int(self.t_ns[k])
            for t in (begin, end):
                share = (t - t0) / (t1 - t0)
                ends.append(before + share * (after - before))
        return Interval(
            dt=(end - begin) * 1e-9, gyro0=ends[0], gyro1=ends[1], accel0=ends[2], accel1=ends[3]
        )


def advance(tried: NavigationFilter, step: Step, earth: Earth) -> None:
    """Predict a filter over an interval, and correct it at the end."""
    if step.over is not None:
        over = step.over
        if step.share < 1.0:
            over = over_gap(over, tried.state, earth, step.share)
        tried.predict(over)
    if step.lost is not None:
        tried.inflate(step.lost.covariance(tried.state.q_nb))
    if step.aids:
        now = tried.state
        aids = [
            aid.about(now) if isinstance(aid, Azimuth) else aid
            for aid in step.aids
            if not isinstance(aid, Azimuth) or aid.is_usable(now)
        ]
        tried.correct(step.t_ns, aids)


def run_sequence(
    name: str, tried: NavigationFilter, sequence: MeasurementSequence, setup: Setup
) -> Solution:
    """Run a filter over a recording, or as far as it can go.

    Raises:
        FilterError: It cannot go on, and has estimated nothing.
    """
    recorder = Recorder(name, sequence.frame)
    notes = sequence.notes
    for step in sequence.steps(setup.start.t_ns):
        try:
            advance(tried, step, setup.earth)
        except FilterError as why:
            if not len(recorder):
                raise
            notes = (*notes, stopped(step.t_ns, why))
            break
        if step.is_sample:
            resets = sum(setup.gate.resets.values())
            recorder.add(step.t_ns, tried.state, tried.covariance(), resets)
    notes += tuple(
        f"{aid} was taken anew {count} times: for too long none had agreed with the estimate"
        for aid, count in setup.gate.resets.items()
    )
    return recorder.solution(counts=setup.gate.counts, notes=notes)


def stopped(t_ns: int, why: FilterError) -> str:
    """Return the note that the estimates end at a time."""
    return f"the estimates end at {t_ns * 1e-9:.2f} s of the log: {why}"
