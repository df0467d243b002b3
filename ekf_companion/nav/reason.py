"""Why an estimate is not OK: the order of the reasons, their words, and how long each held.

Reasons overlap: a receiver that is refused is soon one that is missing. So each second is charged
to one reason, the foremost of those that hold in it: a cause comes before its consequences. The
seconds by reason of a status add up to the seconds of that status.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array
from ekf_companion.nav.state import Reason, Status, Table

WORDS: Mapping[Reason, str] = {
    Reason.POSITION_REFUSED: "GNSS position refused",
    Reason.SLIDE: "GNSS position slides",
    Reason.POSITION_OFF: "GNSS position off to one side",
    Reason.CLIMB_BARO: "barometer against GNSS height",
    Reason.CLIMB_HEIGHT: "GNSS height against barometer",
    Reason.CLIMB_VELOCITY: "GNSS climb against barometer",
    Reason.CLIMB_ANY: "GNSS and barometer disagree",
    Reason.HEIGHT_REFUSED: "GNSS height refused",
    Reason.HEIGHT_OFF: "GNSS height off to one side",
    Reason.COMPASS_REFUSED: "compass refused",
    Reason.HEADING_REFUSED: "heading refused",
    Reason.VELOCITY_REFUSED: "GNSS velocity refused",
    Reason.FALL: "GNSS climb against IMU",
    Reason.SLOW_SAMPLES: "IMU too slow",
    Reason.AUTOPILOTS: "position is the autopilot's",
    Reason.GAP: "IMU gap, until fixes confirm",
    Reason.POSITION_MISSING: "no GNSS position",
    Reason.HEIGHT_MISSING: "no GNSS height",
    Reason.COMPASS_MISSING: "no compass",
    Reason.HEADING_MISSING: "no heading",
    Reason.UNPROVEN: "new attitude, not proven yet",
    Reason.ATTITUDE: "attitude not well known",
    Reason.UNAIDED: "no GNSS is used",
    Reason.UNCERTAIN: "error beyond its limit",
}
"""Each reason in words, the foremost first: a cause before its consequences."""
ORDER = tuple(WORDS)
NONE = Reason(0)
LONGEST_STEP = 5.0
"""Time between two estimates beyond which nothing was estimated, s."""

Seconds = dict[Status, dict[Reason, float]]
"""Seconds by status, and of each by foremost reason; ``NONE`` where there is none, as while OK."""


def foremost(reasons: int) -> Reason:
    """Return the foremost of a set of reasons; ``NONE`` of an empty one."""
    return next((one for one in ORDER if one & reasons), NONE)


def foremost_of(reasons: Array) -> npt.NDArray[np.int64]:
    """Return the foremost reason of each row of the column ``reasons``, shape (n,)."""
    found, rows = np.unique(_whole(reasons), return_inverse=True)
    return np.array([int(foremost(one)) for one in found.tolist()], dtype=np.int64)[rows]


def seconds_by_reason(table: Table, rows: slice = slice(None)) -> Seconds:
    """Return for how long each status held, by the foremost of its reasons.

    A step from one estimate to the next is charged to the later of them; one of more than five
    seconds, or back in time, to nothing.
    """
    stamp_ns = table.stamp_ns[rows]
    spans = np.diff(stamp_ns) * 1e-9
    spans[(spans < 0.0) | (spans > LONGEST_STEP)] = 0.0
    status = _whole(table.column("status")[rows][1:])
    reasons = _whole(table.column("reasons")[rows][1:])
    seconds: Seconds = {}
    for each in Status:
        chosen = status == each
        if not chosen.any():
            continue
        of_status, of_spans = foremost_of(reasons[chosen]), spans[chosen]
        for one in (NONE, *ORDER):
            if spent := float(of_spans[of_status == int(one)].sum()):
                seconds.setdefault(each, {})[one] = spent
    return seconds


def add_seconds(total: Seconds, more: Seconds) -> None:
    """Add seconds by status and reason to others."""
    for status, by_reason in more.items():
        into = total.setdefault(status, {})
        for reason, spent in by_reason.items():
            into[reason] = into.get(reason, 0.0) + spent


def to_words(by_reason: Mapping[Reason, float]) -> str:
    """Return seconds by reason as a clause, the longest first: ``no compass 63 s; ...``.

    Empty: there is no reason.
    """
    found = sorted(by_reason.items(), key=lambda one: -one[1])
    return "; ".join(f"{WORDS[one]} {to_seconds(spent)}" for one, spent in found if one in WORDS)


def to_seconds(spent: float) -> str:
    """Return a time in words, with a digit behind the point below ten seconds."""
    return f"{spent:.{0 if spent >= 9.95 else 1}f} s"


def to_names(by_reason: Mapping[Reason, float]) -> dict[str, float]:
    """Return seconds by the names of reasons in lower case, for JSON."""
    return {str(one.name).lower(): spent for one, spent in by_reason.items() if one}


def names(reasons: int) -> str:
    """Return a set of reasons as text, the foremost first: ``climb_baro+height_refused``."""
    return "+".join(str(one.name).lower() for one in ORDER if one & reasons)


def from_names(text: str) -> int:
    """Return the set of reasons that a text names.

    Raises:
        KeyError: It names one that there is not.
    """
    return int(sum({Reason[one.upper()] for one in text.split("+") if one}))


def _whole(numbers: Array) -> npt.NDArray[np.int64]:
    whole: npt.NDArray[np.int64] = np.nan_to_num(numbers).astype(np.int64)
    return whole
