"""The heart: a measurement in, what became of it and the estimate of now out."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ekf_companion.core.field import Field
from ekf_companion.core.from_settings import delays_ns, parameters
from ekf_companion.core.memory import as_estimate, as_state
from ekf_companion.core.scratch import OUT
from ekf_companion.core.settings import FilterSettings
from ekf_companion.core.state import BLOCK
from ekf_companion.core.timeline import COMPILED_BLOCK, Timeline
from ekf_companion.engine.checkpoint import State, settings_fingerprint
from ekf_companion.engine.health import RESET_REASONS, Aid, Arrival, Health, Verdict
from ekf_companion.nav.measurements import Events, Kind, Measurement, Row
from ekf_companion.nav.state import Odometry, Status, Table

Array = npt.NDArray[np.float64]


_ARRIVALS = tuple(Arrival)


QUALITY = {Status.OK: 100, Status.DEGRADED: 50, Status.DEAD_RECKONING: 20, Status.INVALID: -1}
"""Per cent, as ODOMETRY tells it."""
if COMPILED_BLOCK != BLOCK:
    raise ImportError("the compiled kernel is older than its source; build it anew: make setup")


class Pipeline:
    """Estimator of one vehicle. Not a thread's business: call it from one loop."""

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
        self._field = Field(settings.heading)
        self._family, self._gnss_delay = family, gnss_delay
        k, late = parameters(settings, family), delays_ns(settings, family, gnss_delay)
        self._late = late
        self._fingerprint = settings_fingerprint(k, late)
        self._timeline = Timeline(
            k, late, round(settings.window * 1e9), keeps_history=keeps_history
        )
        self.start = "cold"
        """How it began, as :attr:`Health.start` says."""
        self.resets_before = 0
        """How many of its resets were those of the runs before, whose state it goes on from."""
        self.told_before = 0
        """Resets that a run before has told, whose state this one does not go on from."""

    def process(self, measurement: Measurement) -> Arrival:
        """Take one measurement; ESTIMATED says that :meth:`estimate` is that of its stamp."""
        return self.insert(measurement.row())

    def insert(self, row: Row) -> Arrival:
        """Take one measurement as a row; :meth:`process` says what comes of it."""
        # Add what the place knows: its magnetic field; take off the vehicle's own
        t_ns, kind, values = self._field.complete(row)

        # Refuse what no sensor can say, put the rest in its place in time, redo what came after
        return _ARRIVALS[self._timeline.insert(t_ns, kind, values)]

    def run(self, events: Events) -> Table:
        """Take a whole recording by the same steps, and give an estimate per inertial sample."""
        samples = int(np.count_nonzero(events.kind == Kind.IMU))
        stamps = np.zeros(samples, dtype=np.int64)
        out = np.empty((samples, OUT))
        values = self._field.complete_all(events)
        n = self._timeline.run_log(events.t_ns, events.kind, values, stamps, out)
        return Table(stamp_ns=stamps[:n], values=out[:n])

    def retune(self, settings: FilterSettings) -> None:
        """Go on with other noise, gates and time-outs; delays stay as they were.

        What a late event makes run again from now on is run by these too.
        """
        k = parameters(settings, self._family)
        self._fingerprint = settings_fingerprint(k, self._late)
        self._timeline.retune(k)

    def history(self, is_over: bool = False) -> list[tuple[int, int, Array, Array]]:
        """Give the events that can change no more, as ``Timeline.history`` does."""
        return list(self._timeline.history(is_over))

    @property
    def fingerprint(self) -> bytes:
        """What a state must have been estimated under for this pipeline to go on from it."""
        return self._fingerprint

    def state(self) -> State:
        """Give everything that another pipeline needs to go on from here."""
        return State(
            epoch_ns=int(self._timeline.epoch_ns),
            stamp_ns=self.stamp_ns,
            block=self._timeline.block(),
            waiting=self._timeline.waiting(),
            settings=self._fingerprint,
            told_before=self.told_before,
        )

    def restore(self, state: State) -> None:
        """Go on from a state; the next inertial sample says how much time was lost.

        Whether the state may be believed is asked in :mod:`.checkpoint`, not here.
        """
        self._timeline.restore(state.block, state.waiting, state.epoch_ns, state.stamp_ns)
        self.told_before = state.told_before
        self.start = "warm"
        self.resets_before = int(as_state(state.block).resets)

    @property
    def resets(self) -> int:
        """How often the estimate has jumped on purpose."""
        return int(self._timeline.resets)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the estimate: that of the newest inertial sample, ns."""
        return int(self._timeline.stamp_ns)

    @property
    def given(self) -> int:
        """Inertial samples that it was given and that can be meant, used or not."""
        counts = self._timeline.arrivals[Kind.IMU]
        return int(counts.sum() - counts[Arrival.MALFORMED])

    def nis_sums(self) -> tuple[Array, Array]:
        """Give the sum of the normalised innovations squared, and how many, by aid, shape (6,)."""
        x = as_state(self._timeline.block())
        return np.array(x.nis_sum), np.array(x.nis_n)

    def estimate(self) -> Array:
        """Give the estimate of now: ``nav.state.COLUMNS`` without the time, shape (33,)."""
        return np.asarray(self._timeline.describe())

    def odometry(self) -> Odometry | None:
        """Give what is to be told of the estimate of now; None while there is no position."""
        status, resets, numbers = self._timeline.odometry()
        if status < Status.OK:
            return None
        count = self.told_before + resets
        return Odometry(self.stamp_ns, numbers, count, QUALITY[Status(status)])

    def health(self) -> Health:
        """Give the filter's own account of itself."""
        x = as_state(self._timeline.block())
        now = as_estimate(self.estimate())
        arrivals = self._timeline.arrivals
        return Health(
            status=Status(int(now.status)),
            resets=int(x.resets),
            reset_reason=RESET_REASONS[int(x.reset_reason)],
            samples=int(x.samples),
            gaps=int(x.gaps),
            ratios={aid: x.ratio[aid] for aid in Aid},
            verdicts={aid: {why: int(x.count[aid][why]) for why in Verdict} for aid in Aid},
            arrivals={
                kind: {arrival: int(arrivals[kind, arrival]) for arrival in Arrival}
                for kind in Kind
            },
            reruns=int(self._timeline.reruns),
            reset_delta=(*x.moved.pos_n, *x.moved.vel_n, x.moved.yaw),
            nis={aid: x.nis_sum[aid] / n if (n := x.nis_n[aid]) else math.nan for aid in Aid},
            imu_rate=1.0 / x.dt if x.dt > 0.0 else 0.0,
            gnss_delay=x.gnss_delay,
            white_shares={
                aid: max(x.white_share[aid], 0.01)
                for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY)
            },
            hard_iron=tuple(x.hard_iron),
            gyro_noise=math.sqrt(max(x.noise[:3])),
            accel_noise=math.sqrt(max(x.noise[3:])),
            std_horizontal=float(np.hypot(now.std_pos[0], now.std_pos[1])),
            std_vertical=now.std_pos[2],
            start=self.start,
        )

    @property
    def log_likelihood(self) -> float:
        """Sum over all GNSS rows judged so far, -(nis + log det S) / 2, nis no more than its gate.

        It compares settings over the same log: delays, for one. A number by itself says nothing.
        """
        return float(as_state(self._timeline.block()).log_likelihood)

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (rad), altitude (m) of the local frame; None before a fix."""
        origin = as_state(self._timeline.block()).origin
        return (origin.lat, origin.lon, origin.alt) if origin.is_known else None
