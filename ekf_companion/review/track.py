"""Where an estimate was in a log, how sure of it, and where the receiver was: thinned, to judge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Stamps, in_pieces, known_rows
from ekf_companion.nav.measurements import Events, of_receiver
from ekf_companion.nav.state import GEODETIC, QUATERNION, Status, Table, Trajectory
from ekf_companion.review.stretches import Stretches, of_events

SLOT_NS = 100_000_000
"""One position is kept of each such time: between two, 10 m/s2 bend a path by a centimetre."""


class Size(NamedTuple):
    """How large something was over a flight."""

    rms: float
    """m."""
    worst: float
    """m."""
    at_s: float
    """When it was that, s after the first estimate, reboots drawn one after another."""


class Track:
    """Takes blocks of a log, and keeps ten positions and attitudes a second and all fixes."""

    def __init__(self) -> None:
        self.stretches = Stretches()
        self._part: list[Indices] = []
        self._t_ns: list[Stamps] = []
        self._values: list[Array] = []
        self._attitudes: list[Array] = []
        """Of rows without a position: quaternion, sigma of tilt and yaw, NaN for the height's."""
        self._attitude_ns: list[Stamps] = []
        self._attitude_part: list[Indices] = []
        self._fix_part: list[Indices] = []
        self._fix_ns: list[Stamps] = []
        self._fixes: list[Array] = []

    def add(self, events: Events, table: Table) -> None:
        """Add a block of events and their estimates."""
        first = max(len(self.stretches.found) - 1, 0)
        part = self.stretches.add(table.stamp_ns)
        std = np.hypot(table.column("sd_pos_n"), table.column("sd_pos_e"))
        # Who says itself that its error is beyond the limit is not sent, and not judged by it
        status = table.column("status")
        is_known = (status >= Status.OK) & (status != Status.INVALID) & np.isfinite(std)
        for name in GEODETIC:
            is_known &= np.isfinite(table.column(name))
        known = np.flatnonzero(is_known)
        if len(known):
            begins = np.diff(table.stamp_ns[known] // SLOT_NS, prepend=-1) != 0
            begins[0] = True
            rows = np.flatnonzero(begins)
            worst = np.maximum.reduceat(std[known], rows)
            rows = known[rows]
            kept = Table(stamp_ns=table.stamp_ns[rows], values=table.values[rows])
            columns = [kept.columns(GEODETIC), worst, kept.columns(QUATERNION), _sigmas(kept)]
            self._part.append(part[rows])
            self._t_ns.append(kept.stamp_ns)
            self._values.append(np.column_stack(columns))
        self._add_attitudes(part, table)
        last = max(len(self.stretches.found) - 1, 0)
        is_fix = of_receiver(events) & known_rows(events.values[:, :2])
        self._fix_part.append(of_events(events, first, last)[is_fix])
        self._fix_ns.append(events.t_ns[is_fix])
        self._fixes.append(events.values[is_fix, :3])

    def _add_attitudes(self, part: Indices, table: Table) -> None:
        is_known = table.column("status") == Status.ATTITUDE
        rows = np.flatnonzero(is_known & known_rows(table.columns(QUATERNION)))
        rows = rows[np.diff(table.stamp_ns[rows] // SLOT_NS, prepend=-1) != 0]
        if len(rows):
            kept = Table(stamp_ns=table.stamp_ns[rows], values=table.values[rows])
            self._attitude_part.append(part[rows])
            self._attitude_ns.append(kept.stamp_ns)
            self._attitudes.append(np.column_stack([kept.columns(QUATERNION), _sigmas(kept)]))

    def sigma(self) -> Size | None:
        """Return one sigma of the horizontal position, as estimated; None: there is no position."""
        if not self._t_ns:
            return None
        part, t_ns, values = self._joined()
        return self._size(values[:, 3], t_ns, part)

    def size_of(self, distances: Array, t_ns: Stamps) -> Size:
        """Return how large distances are at stamps of the longest stretch."""
        return self._size(distances, t_ns, np.full(len(t_ns), self.stretches.longest))

    def _size(self, values: Array, t_ns: Stamps, part: Indices) -> Size:
        worst = int(np.argmax(values))
        shift_ns = int(self.stretches.shifts_ns()[part[worst]]) - self.stretches.found[0].first_ns
        rms = float(np.sqrt(np.mean(np.square(values))))
        return Size(rms, float(values[worst]), (int(t_ns[worst]) + shift_ns) * 1e-9)

    def gap(self) -> tuple[float, float]:
        """Return the longest time without inertial samples, and when it began, as a size's, s."""
        if not self.stretches.found:
            return 0.0, 0.0
        shifts_ns, found = self.stretches.shifts_ns(), self.stretches.found
        part = max(range(len(found)), key=lambda one: found[one].gap_ns)
        begin_ns = found[part].gap_from_ns + int(shifts_ns[part]) - found[0].first_ns
        return found[part].gap_ns * 1e-9, begin_ns * 1e-9

    def positions(self) -> Trajectory:
        """Return the positions and attitudes of the longest stretch, while there is a position."""
        t_ns, values = self._longest()
        lat, lon, alt = values[:, :3].T
        is_turned = known_rows(values[:, 4:8])
        return Trajectory(
            name="ekf-companion",
            pos_t_ns=t_ns,
            lat=np.deg2rad(lat),
            lon=np.deg2rad(lon),
            alt=alt,
            att_t_ns=t_ns[is_turned],
            q_nb=in_pieces(so3.normalise, values[is_turned, 4:8]),
        )

    def attitudes(self) -> Trajectory:
        """Return the attitudes of the longest stretch while there is no position."""
        t_ns, values = self._longest_attitudes()
        q_nb = in_pieces(so3.normalise, values[:, :4])
        return Trajectory(name="ekf-companion", att_t_ns=t_ns, q_nb=q_nb)

    def sigmas_at(self, at_ns: Stamps) -> Array:
        """Return one sigma of tilt, yaw (rad) and height (m) at stamps of it, shape (n, 3).

        They are those of :meth:`positions` or, where there is none, of :meth:`attitudes`.
        """
        t_ns, values = self._longest()
        if not len(t_ns):
            t_ns, values = self._longest_attitudes()
        rows = np.clip(np.searchsorted(t_ns, at_ns, side="right") - 1, 0, len(t_ns) - 1)
        return values[rows, -3:]

    def _longest_attitudes(self) -> tuple[Stamps, Array]:
        if not self._attitude_ns:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 7))
        is_of = np.concatenate(self._attitude_part) == self.stretches.longest
        t_ns, rows = np.unique(np.concatenate(self._attitude_ns)[is_of], return_index=True)
        return t_ns, np.concatenate(self._attitudes)[is_of][rows]

    def seconds_of(self, t_ns: int) -> float:
        """Return when a stamp of the longest stretch was, s after the first estimate."""
        shift_ns = int(self.stretches.shifts_ns()[self.stretches.longest])
        return (t_ns + shift_ns - self.stretches.found[0].first_ns) * 1e-9

    def _joined(self) -> tuple[Indices, Stamps, Array]:
        """Return stretch, stamp and numbers of all that is kept: of hours a copy is tens of MB."""
        if len(self._t_ns) > 1:
            self._part, self._t_ns = [np.concatenate(self._part)], [np.concatenate(self._t_ns)]
            self._values = [np.concatenate(self._values)]
        return self._part[0], self._t_ns[0], self._values[0]

    def _longest(self) -> tuple[Stamps, Array]:
        """Return the stamps of the longest stretch, ascending, and what is kept of each."""
        if not self._t_ns:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 11))
        part, t_ns, values = self._joined()
        is_of = part == self.stretches.longest
        if is_of.all() and (np.diff(t_ns) > 0).all():
            return t_ns, values
        t_ns, rows = np.unique(t_ns[is_of], return_index=True)
        return t_ns, values[is_of][rows]

    def fixes(self, delay: float) -> Trajectory:
        """Return the receiver's fixes of the longest stretch, that many s before their stamps."""
        is_of = np.concatenate(self._fix_part) == self.stretches.longest
        t_ns = np.concatenate(self._fix_ns)[is_of] - round(delay * 1e9)
        t_ns, rows = np.unique(t_ns, return_index=True)
        lat, lon, alt = np.concatenate(self._fixes)[is_of][rows].T
        return Trajectory(name="receiver", pos_t_ns=t_ns, lat=lat, lon=lon, alt=alt)


def _sigmas(table: Table) -> Array:
    """Return one sigma of tilt, yaw (rad) and height (m), shape (n, 3)."""
    tilt = np.hypot(table.column("sd_roll"), table.column("sd_pitch"))
    return np.column_stack([tilt, table.column("sd_yaw"), table.column("sd_pos_d")])
