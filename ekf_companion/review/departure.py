"""How far an estimate's yaw, tilt and height are from a witness's, and what a verdict says of it.

Yaw and tilt count by their sigma as well as by their size. An autopilot's estimate is a peer and no
truth: where its attitude jumps, as at a reset of its heading, and ours turns on as before, the
difference is worth a word and is not held against ours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

YAW, TILT = np.deg2rad(10.0), np.deg2rad(5.0)
"""rad. An undisturbed compass, and down by two estimators, differ by less."""
NAMED = {"yaw": np.deg2rad(3.0), "tilt": np.deg2rad(2.0)}
"""RMS, rad, from which on it is named: a well calibrated vehicle has less."""
SIGMAS = 3.0
"""Sigmas of its own beyond which an error is not explained."""
LONG_S = 1.0
"""Time at a stretch beyond its sigma from which on it counts, s."""
OFTEN = 0.2
"""Share of the flight beyond its sigma, by a truth, from which on the attitude is poor."""
HEIGHT = 2.0
"""m. A receiver's height alone is as uncertain."""


class Excess(NamedTuple):
    """What of an angle's error its sigma does not explain."""

    seconds: float
    """For so long, together, s."""
    worst: float
    """rad."""
    sigmas: float
    """How many sigmas that was."""
    at_s: float
    """When it was that, s after the first estimate."""

    @property
    def when(self) -> str:
        """When it was worst, and how many sigmas that was, in words."""
        return f"at {self.at_s:.0f} s ({self.sigmas:.1f} sigma)"


class Angle(NamedTuple):
    """How far yaw or tilt is from a witness's."""

    name: str
    """``yaw`` or ``tilt``."""
    limit: float
    """Size that matters, rad."""
    rms: float
    """After the start, without where the witness's jumped, rad; NaN: not known."""
    spent: float
    """Time that was compared, s."""
    ours: Excess | None = None
    """Beyond its sigma; None: it was not, or not for long."""
    jumped: Excess | None = None
    """Likewise, where it was the witness's that jumped."""


class Height(NamedTuple):
    """How far the height is from a witness's."""

    mean: float
    """m, ours above the witness's: perhaps of another datum."""
    rms: float
    """m, about the mean."""
    sigma: float
    """m, RMS of one sigma by the estimate itself."""


class Departure(NamedTuple):
    """How far yaw, tilt and height are from a witness's."""

    is_truth: bool = False
    """Whether the witness is a truth; else it is the autopilot's estimate."""
    angles: tuple[Angle, ...] = ()
    height: Height | None = None

    @property
    def witness(self) -> str:
        """The witness, in words."""
        return "the truth" if self.is_truth else "the autopilot's"

    @property
    def is_close(self) -> bool:
        """Whether yaw, tilt and height are as the witness's, as far as it has them."""
        height = self.height
        return all(one.ours is None and not one.rms > one.limit for one in self.angles) and (
            height is None
            or max(abs(height.mean), height.rms) <= max(HEIGHT, SIGMAS * height.sigma)
        )

    def sizes(self) -> list[str]:
        """Return what is large, without a judgement: ``yaw 4.0 deg``."""
        words = [
            f"{one.name} {_degrees(one.rms)}" for one in self.angles if one.rms > NAMED[one.name]
        ]
        if self.height is not None and self.height.rms > HEIGHT:
            words.append(f"height {self.height.rms:.1f} m")
        return words

    def reasons(self) -> tuple[list[str], list[str], list[str]]:
        """Return what makes an estimate poor, fair, and what is worth a word besides."""
        poor: list[str] = []
        fair: list[str] = []
        aside: list[str] = []
        for one in self.angles:
            if one.ours is not None:
                is_often = self.is_truth and one.ours.seconds > OFTEN * one.spent
                words = f"{one.name} up to {_degrees(one.ours.worst)} from {self.witness}"
                (poor if is_often else fair).append(f"{words} {one.ours.when}")
            elif one.rms > one.limit:
                words = f"{one.name} is not close to {self.witness}"
                (poor if self.is_truth and one.rms > 3.0 * one.limit else fair).append(words)
            if one.jumped is not None:
                words = f"the autopilot's {one.name} jumped: up to {_degrees(one.jumped.worst)}"
                aside.append(f"{words} from ours {one.jumped.when}")
        if (height := self.height) is not None:
            if self.is_truth and height.rms > max(HEIGHT, SIGMAS * height.sigma):
                fair.append("the height's error is beyond its sigma")
            if abs(height.mean) > max(HEIGHT, SIGMAS * height.sigma):
                where = "above" if height.mean > 0.0 else "below"
                words = f"height {abs(height.mean):.1f} m {where} {self.witness} in the mean"
                aside.append(f"{words} (another datum?)")
        return poor, fair, aside

    def attitude(self) -> str:
        """Return how far the attitude is from the witness's, whatever its size; empty: unknown."""
        found = [f"{one.name} {_degrees(one.rms)}" for one in self.angles if np.isfinite(one.rms)]
        return f"{', '.join(found)} RMS from {self.witness}" if found else ""

    def guess(self) -> str:
        """Return what is said of an attitude that could not be estimated well."""
        words, found = "so the attitude is a guess", self.attitude()
        return f"{words} ({found})" if found else words


def _degrees(angle: float) -> str:
    degrees = float(np.rad2deg(angle))
    return f"{degrees:.{int(degrees < 10.0)}f} deg"
