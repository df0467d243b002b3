"""The heart: measurements in, estimates out."""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal

import numpy as np

from ekf_companion.core.memory.enums import Fault, NeedsReset
from ekf_companion.core.memory.overlay import as_estimate, as_state
from ekf_companion.core.memory.scratch import OUT
from ekf_companion.core.memory.state import BLOCK
from ekf_companion.core.memory.state import State as FilterState
from ekf_companion.core.order.timeline import COMPILED_BLOCK, Timeline
from ekf_companion.core.settings.anchors import Anchors
from ekf_companion.core.settings.field import Field
from ekf_companion.core.settings.from_settings import delays_ns, parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.checkpoint import Origin, State, settings_fingerprint
from ekf_companion.engine.faults import ENDS, FaultEvidence, FoundFault, by_source, suspicions
from ekf_companion.engine.health import (
    HEADING_SENSORS,
    RESET_REASONS,
    Aid,
    Arrival,
    Health,
    Verdict,
)
from ekf_companion.engine.reasons import in_words
from ekf_companion.engine.slow_errors import oddities, slow_errors
from ekf_companion.engine.wrong import Held, Hypothesis, Wrong, wrong_now
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, Kind, Measurement, Row
from ekf_companion.nav.state import ODOMETRY_SIZE, Odometry, Reason, Status, Table

QUALITY = {Status.OK: 100, Status.DEGRADED: 50, Status.DEAD_RECKONING: 20, Status.INVALID: -1}
"""Quality of an estimate by its status, as ODOMETRY carries it: per cent, -1 for failed."""
_OF_FIELD, _ESTIMATED = {int(Kind.GNSS), int(Kind.MAG)}, int(Arrival.ESTIMATED)
_ANCHOR = int(Kind.ANCHOR)
"""Faster to compare than enums."""

if COMPILED_BLOCK != BLOCK:
    raise ImportError("the compiled kernel is older than its source; install the package anew")


class Pipeline:
    """Estimator of one vehicle; to be called from one thread."""

    def __init__(
        self,
        settings: FilterSettings,
        family: str = "unknown",
        gnss_delay: float | None = None,
        *,
        keeps_history: bool = False,
    ) -> None:
        """Begin with nothing known.

        Args:
            settings: The estimator's settings.
            family: ``px4``, ``ardupilot`` or ``unknown``: settles what is ``auto``.
            gnss_delay: Delay that the log itself declares, s; beats ``auto``.
            keeps_history: Events that leave the window are kept until :meth:`history` is asked.
        """
        self._field, self._anchors = Field(settings.heading), Anchors(settings.anchor_range)
        self.family = family
        """``px4``, ``ardupilot`` or ``unknown``."""
        self._gnss_delay = gnss_delay
        self._slow_time = settings.gnss.slow_time
        self._decides = settings.weigh_faults == "act"
        k, late = parameters(settings, family, gnss_delay), delays_ns(settings, family, gnss_delay)
        self._late = late
        self._fingerprint = settings_fingerprint(k, late)
        self._timeline = Timeline(
            k, late, round(settings.window * 1e9), keeps_history=keeps_history
        )
        self._arrival = int(Arrival.TAKEN)
        self.start = "cold"
        """How it began, as :attr:`Health.start` says."""
        self.resets_before = 0
        """How many of its resets were those of the runs before, whose state it goes on from."""
        self.sent_before = 0
        """Resets that a run before has sent, whose state this one does not go on from."""

    def process(self, measurement: Measurement) -> Estimate | None:
        """Process a measurement; return an estimate if it is the newest inertial sample."""
        return self.process_row(measurement.row())

    def process_row(self, row: Row) -> Estimate | None:
        """Process a measurement that is given as a row, as :meth:`process` does."""
        # Add the magnetic field of its place to a fix, remove the vehicle's own from a magnetometer
        t_ns, kind, values = self._field.complete(row) if row[1] in _OF_FIELD else row
        if kind == _ANCHOR:
            t_ns, kind, values = self._anchors.complete(row)

        # Refuse what no sensor can say, put the rest in its place in time, redo what came after
        self._arrival = self._timeline.insert(t_ns, kind, values)
        return Estimate(self, t_ns, values) if self._arrival == _ESTIMATED else None

    def run(self, events: Events) -> Table:
        """Process a whole recording by the same steps; return an estimate per inertial sample."""
        samples = int(np.count_nonzero(events.kind == Kind.IMU))
        stamps = np.zeros(samples, dtype=np.int64)
        out = np.empty((samples, OUT))
        values = self._field.complete_all(events)
        self._anchors.complete_all(events, values)
        n = self._timeline.run_log(events.t_ns, events.kind, values, stamps, out)
        return Table(stamp_ns=stamps[:n], values=out[:n])

    def retune(self, settings: FilterSettings) -> None:
        """Go on with other noise, gates and time-outs; delays stay as they were.

        What a late event makes run again from now on is run with these too.
        """
        k = parameters(settings, self.family, self._gnss_delay)
        self._fingerprint = settings_fingerprint(k, self._late)
        self._timeline.retune(k)

    def history(self, is_over: bool = False) -> list[tuple[int, int, Array, Array]]:
        """Return the events that are final, as ``Timeline.history`` does."""
        return list(self._timeline.history(is_over))

    @property
    def arrival(self) -> Arrival:
        """What became of the last measurement that was processed."""
        return Arrival(self._arrival)

    @property
    def fingerprint(self) -> bytes:
        """Fingerprint of the settings; that of a state must be equal to go on from it."""
        return self._fingerprint

    def state(self) -> State:
        """Return everything that another pipeline needs to go on from here."""
        return State(
            epoch_ns=int(self._timeline.epoch_ns),
            stamp_ns=self.stamp_ns,
            block=self._timeline.block(),
            waiting=self._timeline.waiting(),
            settings=self._fingerprint,
            sent_before=self.sent_before,
            bank=self._timeline.bank(),
        )

    def restore(self, state: State) -> None:
        """Go on from a state; the next inertial sample tells how much time was lost.

        Whether the state may be used is decided in :mod:`.checkpoint`, not here.
        """
        block = state.block.copy()
        # What the last reset before it has moved is not what this one moves
        moved = as_state(block).moved
        moved.pos_n[:] = moved.vel_n[:] = (0.0, 0.0, 0.0)
        moved.yaw = 0.0
        self._timeline.restore(block, state.waiting, state.epoch_ns, state.stamp_ns, state.bank)
        self.sent_before = state.sent_before
        self.start = "warm"
        self.resets_before = int(as_state(state.block).resets)

    def set_origin(self, origin: Origin, age: float = 0.0) -> None:
        """Begin with an origin that is given, before anything is processed; ``age`` is in s.

        The first fix is then a place in that frame: its position less the
        slow error that the receiver had then, as far as that has not faded.
        """
        lat, lon, alt, offset = origin.later(age, self._slow_time)
        self._timeline.set_origin(lat, lon, alt, np.array(offset))

    def found_faults(self, *, is_now: bool = False) -> list[FoundFault]:
        """Return the faults that were beyond doubt so far; none without ``weigh_faults``.

        ``is_now``: only those since the autopilot's clock last began anew.
        """
        return [
            FoundFault(Fault(kind), onset, until, size, std, evidence)
            for kind, onset, until, size, std, evidence in self._timeline.found(is_now)
        ]

    def wrong_now(self) -> tuple[Wrong, ...]:
        """Return what is wrong now; none where the fault hypotheses do not decide."""
        if not self._decides:
            return ()
        timeline = self._timeline
        hypotheses = [
            Hypothesis(Fault(kind), p, onset, size)
            for kind, p, onset, size in timeline.hypotheses()
        ]
        position, height, velocity, climb, heading, *slides = timeline.declared()
        is_sliding = bool(slides[0]), bool(slides[1])
        held = Held(position, height, velocity, climb, heading, is_sliding)
        return wrong_now(hypotheses, self.found_faults(is_now=True), held, self.stamp_ns)

    def fault_evidence(self) -> FaultEvidence:
        """Return how probable each source's fault was over time; empty without ``weigh_faults``."""
        table = self._timeline.evidence()
        return FaultEvidence(table[:, 0].astype(np.int64), table[:, 3:], table[:, 1:3])

    @property
    def resets(self) -> int:
        """How often the estimate has jumped on purpose."""
        return int(self._timeline.resets)

    @property
    def reboots(self) -> int:
        """How many of these were reboots of the autopilot."""
        return int(self._timeline.reboots)

    @property
    def reset_reason(self) -> str:
        """Why it last jumped, reboots aside."""
        return RESET_REASONS[self._timeline.reset_reason]

    @property
    def stamp_ns(self) -> int:
        """Stamp of the estimate: that of the newest inertial sample, ns."""
        return int(self._timeline.stamp_ns)

    @property
    def given(self) -> int:
        """Inertial samples that arrived and are well-formed, used or not."""
        counts = self._timeline.arrivals[Kind.IMU]
        return int(counts.sum() - counts[Arrival.MALFORMED])

    def nis_sums(self) -> tuple[Array, Array]:
        """Return sum and number of the normalised innovations squared, by aid, shape (6,)."""
        x = as_state(self._timeline.block())
        return np.array(x.nis_sum), np.array(x.nis_n)

    def estimate(self) -> Estimate:
        """Return the estimate of now, at the stamp of the newest inertial sample."""
        return Estimate(self, self.stamp_ns)

    def values(self) -> Array:
        """Return the estimate of now: ``nav.state.COLUMNS`` without the time, shape (34,)."""
        return np.asarray(self._timeline.describe())

    def health(self) -> Health:
        """Return the filter's own account of itself."""
        x, now = as_state(self._timeline.block()), as_estimate(self.values())
        arrivals = self._timeline.arrivals
        probability, faults = self._timeline.suspected(), self.found_faults(is_now=True)
        suspected = suspicions(probability, decides=self._decides)
        levels = self._timeline.protection()
        return Health(
            status=Status(int(now.status)),
            resets=int(x.resets),
            reset_reason=RESET_REASONS[int(x.reset_reason)],
            samples=int(x.samples),
            gaps=int(x.gaps),
            ratios={aid: x.ratio[aid] for aid in Aid},
            denied={aid: bool(x.is_denied[aid]) for aid in Aid},
            verdicts={aid: {why: int(x.count[aid][why]) for why in Verdict} for aid in Aid},
            headings={
                sensor: {why: int(x.heading_count[i][why]) for why in Verdict}
                for i, sensor in enumerate(HEADING_SENSORS)
            },
            arrivals={
                kind: {arrival: int(arrivals[kind, arrival]) for arrival in Arrival}
                for kind in Kind
            },
            reruns=int(self._timeline.reruns),
            reset_delta=(*x.moved.pos_n, *x.moved.vel_n, x.moved.yaw),
            nis={aid: x.nis_sum[aid] / n if (n := x.nis_n[aid]) else math.nan for aid in Aid},
            imu_rate=1.0 / x.dt if x.dt > 0.0 else 0.0,
            gnss_delay=x.gnss_delay,
            velocity_lag=x.lag.late,
            white_shares={
                aid: max(x.white_share[aid], 0.01)
                for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY)
            },
            hard_iron=tuple(x.hard_iron),
            gyro_noise=math.sqrt(max(x.noise[:3])),
            accel_noise=math.sqrt(max(x.noise[3:])),
            std_horizontal=float(np.hypot(now.std_pos[0], now.std_pos[1])),
            std_vertical=now.std_pos[2],
            is_position_autopilots=bool(x.fix_t > x.raw_fix_t),
            start=self.start,
            reasons=in_words(x, Reason(self._timeline.reasons)),
            faults=by_source(probability),
            suspected=suspected,
            wrong=self.wrong_now(),
            found=tuple(one.words_ago(self.stamp_ns, repaired=self._decides) for one in faults),
            found_counts=Counter(one.source.name.lower() for one in faults if one.kind not in ENDS),
            protection_horizontal=levels[0],
            protection_vertical=levels[1],
            receiver=int(x.receiver),
            compass=int(x.compass),
            oddities=(*oddities(slow_errors(x)), *self._anchors.oddities()),
        )

    @property
    def filter_state(self) -> FilterState:
        """A copy of the filter's state."""
        return as_state(self._timeline.block())

    @property
    def log_likelihood(self) -> float:
        """Sum over all GNSS rows judged so far, -(nis + log det S) / 2, nis no more than its gate.

        It compares settings, such as delays, over the same log; by itself it has no meaning.
        """
        return float(as_state(self._timeline.block()).log_likelihood)

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (rad), altitude (m) of the local frame; None before a fix."""
        return self._timeline.origin


class Estimate:
    """The estimate at the stamp of the newest inertial sample.

    One is made 250 times a second and few are looked at, so its content is computed when it is
    asked for: ask before the next sample is processed.
    """

    __slots__ = ("_odometry", "_pipeline", "sample", "t_ns")

    def __init__(
        self, pipeline: Pipeline, t_ns: int, sample: tuple[float, ...] | None = None
    ) -> None:
        self.t_ns = t_ns
        """Time of validity: the sample's stamp, autopilot clock, ns."""
        self.sample = sample
        """The sample: angular rate (rad/s) and specific force (m/s^2), b, before anything else;
        None: not given."""
        self._pipeline = pipeline
        self._odometry: Odometry | Literal[False] | None = False

    @property
    def odometry(self) -> Odometry | None:
        """Content of an ODOMETRY, the same for all listeners; None while there is no position."""
        if self._odometry is False:
            timeline = self._pipeline._timeline
            status, resets, numbers = timeline.odometry()
            if status < Status.OK:
                self._odometry = None
            else:
                count, quality = self._pipeline.sent_before + resets, QUALITY[Status(status)]
                whole, relative = numbers[:ODOMETRY_SIZE], numbers[ODOMETRY_SIZE:]
                self._odometry = Odometry(
                    self.t_ns, whole, count, quality, relative, timeline.origin
                )
        return self._odometry

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (rad), altitude (m) of the local frame; None before a fix."""
        return self._pipeline.origin

    @property
    def health(self) -> Health:
        """The filter's own account of itself."""
        return self._pipeline.health()

    @property
    def values(self) -> Array:
        """The whole estimate: ``nav.state.COLUMNS`` without the time, shape (34,)."""
        return self._pipeline.values()

    @property
    def unaided_s(self) -> float:
        """Time since a position or a velocity was fused, s."""
        x = self._pipeline.filter_state
        return float(x.t - max(x.used_t[Aid.POSITION], x.used_t[Aid.VELOCITY])) * 1e-9

    @property
    def is_reset_due(self) -> bool:
        """Whether the next fix resets position and velocity, as it does after a gap."""
        return bool(self._pipeline.filter_state.needs_reset == NeedsReset.FIX)

    def add_resets(self, count: int) -> None:
        """Count jumps that were told beside the filter's own resets."""
        self._pipeline.sent_before += count
        self._odometry = False
