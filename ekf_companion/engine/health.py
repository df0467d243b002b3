"""The filter's own account of itself: what became of the measurements, and its accuracy."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from ekf_companion.core.memory.enums import Aid, Arrival, Source, Verdict
from ekf_companion.engine.wrong import RECEIVER, Wrong
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Reason, Status

RESET_REASONS = (
    "none",
    "position",
    "velocity",
    "height",
    "heading",
    "inertial gap",
    "clock",
    "state out of bounds",
    "heading against the motion",
    "restart",
    "new origin",
)

HEADING_SENSORS = ("antennas", "other", "compass")
"""Kinds of sensor of a heading: two antennas, another estimate (as the autopilot's), a compass."""
REFUSALS = (Verdict.GATED, Verdict.SUSPECT, Verdict.DISTURBED, Verdict.DENIED)
"""Why an aid's measurement is not fused: by a gate, as the receiver doubts itself, as the magnetic
field is not the Earth's, or as other evidence contradicts it."""
DECIMATED = 80.0
"""Inertial samples below this rate miss what a multicopter does, Hz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The filter's own account of itself."""

    status: Status
    """How far the estimate can be trusted."""
    resets: int
    """Jumps on purpose, counted from run to run, as ODOMETRY's ``reset_counter``."""
    reset_reason: str
    """Of the last."""
    samples: int
    gaps: int
    ratios: Mapping[Aid, float]
    """Last normalised innovation squared of each aid over its gate: above 1 it was refused; NaN:
    there was no covariance to judge it by."""
    verdicts: Mapping[Aid, Mapping[Verdict, int]]
    arrivals: Mapping[Kind, Mapping[Arrival, int]]
    reruns: int
    reset_delta: tuple[float, ...]
    """By how much the last reset moved position n e d (m), velocity n e d (m/s), yaw (rad)."""
    nis: Mapping[Aid, float]
    """Mean normalised innovation squared over its degrees of freedom: 1 if all is well; NaN: none
    yet. Over all of the filter's life; a :class:`~.snapshot.Snapshot` has that of the last seconds.
    """
    imu_rate: float
    """Measured rate of the inertial samples, Hz; 0: none yet."""
    gnss_delay: float
    """Estimated addition to the configured delay, s."""
    velocity_lag: float
    """How much later the velocity of a fix is true than its position, s."""
    white_shares: Mapping[Aid, float]
    """Learnt share of the variance that the receiver states which is white noise."""
    hard_iron: tuple[float, float, float]
    """Estimate of the vehicle's own magnetic field, b, gauss."""
    gyro_noise: float
    """Learnt white noise, largest axis, rad/s per square root of Hz."""
    accel_noise: float
    """m/s^2 per square root of Hz."""
    std_horizontal: float
    """One sigma of the horizontal position, m; NaN: no position yet."""
    std_vertical: float
    """One sigma of the height, m."""
    is_position_autopilots: bool
    """Whether the position in use is the autopilot's own estimate, not its receiver's."""
    start: str
    """How it began: ``cold``, ``cold: `` and why a checkpoint was refused, or ``warm: `` and what
    was lost."""
    receiver: int = 0
    """Whose fixes are used: 0 the first receiver's, 1 the second's."""
    compass: int = 0
    """Whose magnetic field is used: 0 the first compass's."""
    reasons: Mapping[Reason, str] = field(default_factory=dict)
    """Why the status is worse than OK, in words; the foremost first."""
    denied: Mapping[Aid, bool] = field(default_factory=dict)
    """Whether the last of each aid was refused on other evidence, whatever its ratio is."""
    headings: Mapping[str, Mapping[Verdict, int]] = field(default_factory=dict)
    """The verdicts on headings by :data:`HEADING_SENSORS`."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """How probable it is of each source that it is wrong, by name, from a thousandth on; empty
    without ``weigh_faults``."""
    suspected: tuple[str, ...] = ()
    """What is more likely wrong than right, in words: ``height: GNSS height or barometer (0.93)``.
    """
    wrong: tuple[Wrong, ...] = ()
    """What is suspected, and what was found and is not right again; empty where the fault
    hypotheses do not decide."""
    found: tuple[str, ...] = ()
    """Faults that were beyond doubt so far, in words, with how long ago each began and was so."""
    found_counts: Mapping[str, int] = field(default_factory=dict)
    """How many there were by source."""
    protection_horizontal: float = math.nan
    """What the horizontal error exceeds with the probability ``integrity.risk``, m; NaN: the fault
    hypotheses do not decide, or there is no position."""
    protection_vertical: float = math.nan
    """The same of the height, m."""
    oddities: tuple[str, ...] = ()
    """Slow errors of aids that no good sensor has, a sentence each."""

    @property
    def is_receiver_refused(self) -> bool:
        """Whether the last position or velocity of the receiver was refused, and why ever.

        Or more likely wrong than right, or found to be wrong.
        """
        return self.has_wrong(RECEIVER) or any(
            self.ratios[aid] > 1.0 or self.denied.get(aid, False)
            for aid in (Aid.POSITION, Aid.VELOCITY)
        )

    def has_wrong(self, sources: Collection[Source]) -> bool:
        """Return whether one of these sources is wrong now."""
        return any(one.source in sources for one in self.wrong)

    def fused(self, aid: Aid) -> int:
        """Return how many measurements of an aid were fused, with full or with less weight."""
        return fused_of(self.verdicts[aid])

    def refused(self, aid: Aid) -> int:
        """Return how many measurements of an aid were looked at and not believed."""
        return refused_of(self.verdicts[aid])

    def refused_share(self, aid: Aid) -> float:
        """Return the share of an aid's measurements that was refused."""
        refused = self.refused(aid)
        return refused / max(refused + self.fused(aid), 1)


def fused_of(verdicts: Mapping[Verdict, int]) -> int:
    """Return how many measurements were fused, with full or with less weight."""
    return verdicts[Verdict.FUSED] + verdicts[Verdict.DEWEIGHTED]


def refused_of(verdicts: Mapping[Verdict, int]) -> int:
    """Return how many measurements were looked at and not believed."""
    return sum(verdicts[why] for why in REFUSALS)


__all__ = ["REFUSALS", "RESET_REASONS", "Aid", "Arrival", "Health", "Verdict"]
