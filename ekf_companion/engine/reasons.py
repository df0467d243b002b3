"""The reasons of a status in words, with their numbers: for the pilot, the log and the status.

Which of them hold, the kernel decides (``core/output/estimate.py``). The words have 29 characters
at most: a pilot's text has 50, with its sender and the status before them.
"""

from __future__ import annotations

import math

from ekf_companion.core.memory.constants import FROZEN
from ekf_companion.core.memory.enums import Aid, Azimuth
from ekf_companion.core.memory.state import State
from ekf_companion.nav.reason import ORDER, WORDS
from ekf_companion.nav.state import Reason

LONGEST_WORDS = 29
"""Characters: of 50, without ``Companion: degraded: ``."""
_MISSING = (Reason.POSITION_MISSING, Reason.HEIGHT_MISSING, Reason.UNAIDED)
_HEADINGS = {int(Azimuth.ANTENNA): "antenna heading", int(Azimuth.OTHER): "other heading"}


def in_words(x: State, reasons: Reason) -> dict[Reason, str]:
    """Return the words of each reason that holds, the foremost first."""
    return {reason: _words(x, reason) for reason in ORDER if reason in reasons}


def _words(x: State, reason: Reason) -> str:
    if reason is Reason.POSITION_REFUSED:
        return f"GNSS is {_off(x, Aid.POSITION, 2)} m off, refused"
    if reason is Reason.POSITION_OFF:
        return f"GNSS {_off(x, Aid.POSITION, 2)} m off to one side"
    if reason is Reason.SLIDE:
        return f"GNSS slides, {_number(math.hypot(*x.slide.smooth))} m so far"
    if reason is Reason.HEIGHT_REFUSED:
        return f"GNSS height is {_off(x, Aid.HEIGHT, 1)} m off"
    if reason is Reason.VELOCITY_REFUSED:
        return f"GNSS velocity {_off(x, Aid.VELOCITY, 3)} m/s off"
    if reason is Reason.HEADING_REFUSED:
        return f"{_HEADINGS.get(int(x.azimuth), 'heading')} is refused"
    if reason is Reason.COMPASS_REFUSED:
        return "compass is refused"
    if reason in _MISSING and x.fix_repeats >= FROZEN:
        return "GNSS repeats one position"
    if reason is Reason.SLOW_SAMPLES:
        return f"IMU at {1.0 / x.dt:.0f} Hz is too slow"
    if reason is Reason.ATTITUDE:
        worst = math.sqrt(max(x.P[i][i] for i in range(3)))
        return f"attitude to {min(math.degrees(worst), 180.0):.0f} deg only"
    return WORDS[reason]


def _off(x: State, aid: Aid, rows: int) -> str:
    """Return by how much the refused innovations of an aid are off by now: their line's end."""
    run = x.run[aid]
    if run.n < 1.0:
        return "some"
    spread = run.tt - run.t * run.t / run.n
    since = (x.t - run.t0) * 1e-9 - run.t / run.n
    ends = []
    for row in range(rows):
        slope = (run.tz[row] - run.t * run.z[row] / run.n) / spread if spread > 0.1 else 0.0
        ends.append(run.z[row] / run.n + slope * since)
    return _number(math.hypot(*ends))


def _number(size: float) -> str:
    """Return a size with two digits or more, and no more than five characters."""
    return f"{min(size, 99999.0):.{0 if size >= 9.95 else 1}f}"
