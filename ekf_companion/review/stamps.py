"""Whether the inertial samples of a log have stamps of their own, in order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.repetition import SPIKE, STUCK, ZERO
from ekf_companion.replay.screen import Screen

INERTIAL = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")
"""Messages of inertial samples that are read."""
OFTEN, RARELY = 0.5, 0.05
"""Shares of the inertial samples with a stamp that cannot be: most, and more than some."""


class StampCount(NamedTuple):
    """Inertial samples, and how many of them have the stamp of one before, or an earlier one."""

    total: int
    repeated: int = 0
    back: int = 0
    lost_share: float = 0.0
    """Of the rows of the file: left out, for they have no time or one that does not fit."""
    shuffled_share: float = 0.0
    """Of the frames of a .tlog: recorded earlier than the one before, by their recorder."""
    unused_share: float = 0.0
    """Of the samples: no estimate follows from them, for they came too late or out of order."""

    @property
    def words(self) -> str:
        """What is wrong with them, in a few words; empty: nothing."""
        if self.lost_share > OFTEN:
            return "the times of most rows do not fit each other"
        if self.repeated > RARELY * self.total:
            return "inertial samples share their stamps"
        if min(self.shuffled_share, self.unused_share) > RARELY:
            return "frames not in the order in which they came"
        if self.back > RARELY * self.total:
            return "samples not in the order of their stamps"
        if self.unused_share > RARELY:
            return f"{self.unused_share:.0%} of the inertial samples came too late to be used"
        return ""

    @property
    def note(self) -> str:
        """A sentence of it; empty: nothing is wrong."""
        if self.repeated > RARELY * self.total:
            return (
                f"{self.repeated} of {self.total} inertial samples have the stamp of the one "
                "before, so they count as one: the stamps are repeated, or have lost digits "
                "(1.73234e+09 holds six of them); write each sample's own time, with all digits"
            )
        if min(self.shuffled_share, self.unused_share) > RARELY:
            return (
                f"{self.shuffled_share:.0%} of the frames are stamped earlier than the one before, "
                f"so {self.unused_share:.0%} of the inertial samples gave no estimate: the file is "
                "not in the order in which they came; sort its records by their stamps"
            )
        if self.back > RARELY * self.total:
            return (
                f"{self.back} of {self.total} inertial samples are stamped earlier than the one "
                "before: the rows are not in the order of their times; sort them by time"
            )
        if self.unused_share > RARELY:
            return (
                f"{self.unused_share:.0%} of the inertial samples gave no estimate: they stand "
                "behind later ones by more than the window of the filter; sort them by time"
            )
        return ""

    @property
    def is_most(self) -> bool:
        """Whether it is so of most samples."""
        worst = max(self.repeated, self.back)
        return worst > OFTEN * self.total or max(self.lost_share, self.unused_share) > OFTEN


NO_SAMPLES = StampCount(0)


def of_columns(screen: Screen, lost_share: float) -> StampCount:
    """Return what the screen of a columnar log found; of its rows a share was left out before."""
    refused = screen.left_out
    lost = sum(refused[Kind.IMU, why] for why in (SPIKE, STUCK, ZERO))
    judged = screen.total[Kind.IMU] - lost
    return StampCount(judged, screen.repeated, screen.back, lost_share)


def of_telemetry(
    refused: Mapping[str, int], counts: Mapping[Kind, int], shuffled_share: float = 0.0
) -> StampCount:
    """Return what the readers of messages found of stamps, by their counts of what was refused.

    A stamp that leaps, or a clock that is set back, again and again, is one out of order too.
    """
    from ekf_companion.mavlink.decode.inertial import REPEATED

    repeated = refused.get(f"refused: IMU: {REPEATED}", 0)
    leaps = sum(refused.get(f"refused: {one}: stamp leaps", 0) for one in INERTIAL)
    total = counts.get(Kind.IMU, 0) + repeated + leaps
    back = leaps + refused.get("refused: clock set back", 0)
    return StampCount(total, repeated, back, shuffled_share=shuffled_share)
