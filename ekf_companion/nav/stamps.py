"""The rule by which a stamp belongs to a clock, for stamps as they arrive and for those of a log.

A stamp is judged by its step from the newest one of its clock. It goes on from it if it is behind
by no more than packets overtake one another, or ahead by no more than the evidence allows: by
``NEAR_US`` at once, by ``LONG_US`` where another stamp is to be confirmed, by ``GAP_US`` after a
silence, which a second stamp must confirm. Any other step belongs to another clock, or the stamp is
damaged. A counter that goes round goes on.

:mod:`ekf_companion.mavlink.timebase` judges each stamp as it arrives. It knows when that was, so a
burst of old packets proves nothing, but not what follows: a leap is held back until enough has been
heard of the new clock. :mod:`ekf_companion.logs.clock_run` judges all stamps of a log at once. It
knows no times of arrival, but what follows: one row or a few that the rest contradict are damage,
and of several clocks it keeps the one with most rows.
"""

from __future__ import annotations

import math
from typing import Any

BACK_US = 2_000_000
"""A clock that goes back by more has restarted; by less, packets may have overtaken each other."""
BACK_NS = 1000 * BACK_US
NEAR_US = 100_000
"""A stamp that is further ahead moves the clock only when a second one goes on from it."""
AHEAD_US = 1_000_000
"""After a silence of the link of up to so long the next stamp is believed."""
LONG_US = 10_000_000
"""Another stamp confirms one that is held back if it is no further away; at no rate is a longer
step believed at once."""
GAP_US = 3_600_000_000
"""A leap of more than an hour is another clock, not a gap."""
SKEW = 100e-6
"""By so much of the time two clocks may run apart."""
SHORT = 1 << 32
"""Counts of 32 bits go round: 71.6 minutes of microseconds, 49.7 days of milliseconds."""


def goes_on(step_us: Any, ahead_us: Any) -> Any:
    """Return whether a stamp, or each of many, may go on from another, which it follows by a step.

    Args:
        step_us: Its step from the other.
        ahead_us: How far ahead it may be.
    """
    return (step_us >= -BACK_US) & (step_us <= ahead_us)


def rounds(stamp: Any, reference: Any, period: int, far: int) -> Any:
    """Return how often a counter, or each of many, went round between a reference and a stamp.

    0 where it would still be far from the reference.

    Args:
        stamp: What the counter holds, without its rounds.
        reference: A stamp near to it, with all its rounds.
        period: After how much the counter goes round.
        far: Distance from the reference up to which a stamp is near to it.
    """
    count = (reference - stamp + period // 2) // period
    return count * (abs(stamp + count * period - reference) <= far)


def least_lag(last: int, lag: int, elapsed: int) -> int:
    """Return by how much stamps lag behind arrivals if nothing delays them.

    The least that was seen is nearest: what comes late, or waits, lags more.

    Args:
        last: What was found by now.
        lag: That of a stamp that has just come, in the same unit.
        elapsed: Time since the one before, in which the clocks may have run apart.
    """
    return min(last + math.ceil(SKEW * max(elapsed, 0)), lag)
