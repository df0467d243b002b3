"""A recording of any log format: events in the order of arrival, and what to compare with."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs.onboard import Onboard
from ekf_companion.nav.arrays import Mask, Stamps
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Trajectory


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Counted:
    """The parts of a recording that its authors include in the errors."""

    t_ns: Stamps
    """Ascending, shape (n,)."""
    is_counted: Mask
    """Whether the time from each stamp to the next counts, shape (n,)."""

    def at(self, t_ns: Stamps) -> Mask:
        """Return whether each time counts; none before the first stamp does."""
        last = np.searchsorted(self.t_ns, t_ns, side="right") - 1
        return np.asarray((last >= 0) & self.is_counted[np.maximum(last, 0)])


CLOCK_SET_S = 946_684_800
"""s since 1970: a clock that shows a time before the year 2000 was not set."""
LATEST_S = 4_102_444_800
"""s since 1970: a clock that shows a time after the year 2100 is damaged."""


class Damage(NamedTuple):
    """The part of a file that could not be read."""

    words: str = ""
    """A short description for the verdict; empty: no damage."""
    share: float = 0.0
    """Share of the file, of its records or of its time; 1: not known."""

    def beside(self, other: Damage) -> Damage:
        """Return what one and another are together."""
        words = ", ".join(one for one in (self.words, other.words) if one)
        return Damage(words, max(self.share, other.share))


UNDAMAGED = Damage()


OFTEN = 0.5
"""Share of rows beyond which a note speaks of most rows."""


def misfits(lost: int, total: int, words: str, zeros: int = 0) -> list[str]:
    """Return a note on rows that were dropped because of their stamps; none if there are none.

    It names how many of them are stamped 0, and if they are most of all rows, the likely cause.
    """
    if not lost:
        return []
    why = (
        ": they are not in the order of their times, or of several clocks; sort them by time, or "
        "run each recording by itself"
    )
    words += f" ({zeros} of them 0)" if zeros else ""
    were = "was" if lost == 1 else "were"
    return [f"{counted(lost, 'row')} {words} {were} dropped{why if lost > OFTEN * total else ''}"]


def dropped(lost: int, total: int) -> Damage:
    """Return how many of all rows were dropped because of their stamps."""
    return Damage(f"{counted(lost, 'row')} dropped", lost / total) if lost else UNDAMAGED


def damaged_places(count: int) -> str:
    """Return a note on the number of damaged places."""
    return "a damaged place" if count == 1 else f"{count} damaged places"


CUT = "the recording was cut off at its end"
"""Description of a file that ends within a message, for the verdict."""


def cut_short(path: Path, size: int) -> LogError:
    """Return the error for a file that ends before its first sample, given its size in bytes."""
    return LogError(
        f"{path}: ends after {size} bytes, before any sample: the recording was cut off there, or "
        "the file was not copied whole; copy it again"
    )


def counted(count: int, what: str) -> str:
    """Return ``1 run`` or ``2 runs``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def cut_off(rest: int, unit: str) -> str:
    """Return a note on bytes at the end of a file that are an incomplete ``unit``."""
    last = "the last byte is" if rest == 1 else f"the last {rest} bytes are"
    return f"{last} no whole {unit}: the recording was cut off there"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Recording:
    """The content of a log."""

    family: str
    """``px4``, ``ardupilot`` or ``unknown``: the autopilot whose delays apply."""
    events: Events
    """All input of the estimator in the order of arrival, with the log's stamps."""
    reference: Trajectory | None = None
    """The autopilot's own estimate."""
    truth: Trajectory | None = None
    """Truth of a simulator or an optical system, if the log holds one."""
    counted: Counted | None = None
    """Times that are included in the errors; None: all."""
    gnss_delay: float | None = None
    """GNSS delay that the log declares (a parameter of the autopilot), s."""
    notes: tuple[str, ...] = field(default=())
    """What the user should know about the file, one sentence each."""
    damage: Damage = UNDAMAGED
    lost_share: float = 0.0
    """Share of rows left out, since they have no time, or one that does not fit the others."""
    extent_ns: tuple[int, int] = (0, 0)
    """First and last stamp of the log's sensors, if its events are a part of them; or 0, 0."""
    began_s: float | None = None
    """Time at which the recording began, s since 1970, UTC; None: not known."""
    utc_zero_ns: int | None = None
    """UTC at which the autopilot's clock was zero, ns since 1970; None: not known."""
    onboard: Onboard = field(default_factory=Onboard)
    """Firmware, parameters and messages of the autopilot."""
    zero_height: float = 0.0
    """Altitude at which the heights of the file are zero, m, where its position is invented."""

    def __repr__(self) -> str:
        """Return what is in it, in a line."""
        others = [f"reference {self.reference}"] if self.reference else []
        others += [f"truth {self.truth}"] if self.truth else []
        parts = [self.family, str(self.events), *others, counted(len(self.notes), "note")]
        return f"<Recording: {'; '.join(parts)}>"


def longest_clock_run(events: Events) -> tuple[Events, tuple[str, ...]]:
    """Return the longest part of events without a restart of the clock, and a note on the rest."""
    restarts = np.flatnonzero(events.kind == Kind.RESTART)
    if not len(restarts):
        return events, ()
    longest = events.take(max(np.split(np.arange(len(events)), restarts), key=len))
    return longest.take(longest.kind != Kind.RESTART), (
        "the autopilot rebooted in this log: its clock begins anew; the longest part counts",
    )
