"""The filter's own account of itself: what became of the measurements, and its accuracy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status


class Arrival(IntEnum):
    """What became of a measurement on its arrival."""

    TAKEN = 0
    STALE = 1
    """Older than the window: nothing can be redone that far back."""
    DUPLICATE = 2
    MALFORMED = 3
    """A value that no sensor can have."""
    RESTARTED = 4
    ESTIMATED = 5
    """The newest inertial sample: there is an estimate for its stamp."""


class Verdict(IntEnum):
    """What became of an aid when the filter processed it."""

    FUSED = 0
    GATED = 1
    BEFORE_ALIGNMENT = 2
    SUPERSEDED = 3
    """A better source is in use, or the configuration excludes it."""
    DEWEIGHTED = 4
    """Fused with less weight: between the soft and the hard gate."""
    SUSPECT = 5
    """The receiver itself reports jamming or spoofing."""
    DISTURBED = 6
    """A magnetic field that is not the Earth's."""


class Aid(IntEnum):
    """What corrects the inertial solution."""

    POSITION = 0
    HEIGHT = 1
    VELOCITY = 2
    HEADING = 3
    BARO = 4
    REST = 5
    """Standing still."""


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
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The filter's own account of itself."""

    status: Status
    resets: int
    reset_reason: str
    samples: int
    gaps: int
    ratios: Mapping[Aid, float]
    """Last normalised innovation squared of each aid over its gate: above 1 it was refused."""
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
    start: str
    """How it began: ``cold``, ``cold: `` and why a checkpoint was refused, or ``warm: `` and what
    was lost."""
