"""Time order: events are processed at their times of validity, whenever they arrive.

A window of the last seconds is kept as sorted rows, with snapshots of the state between them.
A late event goes back to the snapshot before it and all that came after is run again; so the state
depends on what was measured, never on the order in which it arrived. One more snapshot, the mark,
lies where the next late event is expected by the rhythm of those of its kind: most go back to it.

An event between two inertial samples waits for the second one, whose interval it splits: no guess
about the rate is ever made and corrected later.

An inertial stamp is believed when its neighbours confirm it. One that leaps ahead waits for a
second: if the stamps go on from it, samples were lost; if they go on from before, it was wrong, or
it came early, and then there is room for it when they reach it. Late samples fill holes; samples
that are all behind the newest and fill none, one interval after another, are of a clock that was
set back, unless they show the motion of their stamps once more: then they are of a second path. Of
messages it is known by their arrival whether they are late, or the clock may have been set back.

Rows, snapshots and cursor only ever change together: so one class holds them, in a long file.
"""

from __future__ import annotations

import cython
import numpy as np
from cython import address
from cython.cimports.ekf_companion.core.filter import columns
from cython.cimports.ekf_companion.core.filter.slow_error import (
    add_covariance,
    add_variance,
    carried,
)
from cython.cimports.ekf_companion.core.filter.strapdown import set_origin
from cython.cimports.ekf_companion.core.memory import enums
from cython.cimports.ekf_companion.core.memory.bank import BANK
from cython.cimports.ekf_companion.core.memory.constants import THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.overlay import (
    Numbers,
    as_banks,
    as_estimate,
    as_events,
    as_odometry,
    as_parameters,
    as_state,
    as_states,
    copy_state,
)
from cython.cimports.ekf_companion.core.memory.scratch import ODOMETRY, OUT, ROW, VALUES, Scratch
from cython.cimports.ekf_companion.core.memory.state import BLOCK
from cython.cimports.ekf_companion.core.order import step
from cython.cimports.ekf_companion.core.order.events import (
    compare,
    is_late,
    is_sane,
    last_sample,
    next_sample,
)
from cython.cimports.ekf_companion.core.order.restart import is_sound, recover
from cython.cimports.ekf_companion.core.order.second_path import (
    inflate_by_second_path,
    weigh_second_path,
)
from cython.cimports.ekf_companion.core.order.stamps import Held, add, remove
from cython.cimports.ekf_companion.core.output.estimate import (
    find_reasons,
    late_fix,
    write_estimate,
)
from cython.cimports.ekf_companion.core.output.odometry import write_odometry
from cython.cimports.ekf_companion.core.output.protection import find_levels
from cython.cimports.ekf_companion.core.start.reboot import carry_over
from cython.cimports.ekf_companion.core.trust import shape
from cython.cimports.ekf_companion.core.trust.gate import begin_reset
from cython.cimports.libc.math import sqrt

from ekf_companion.core.memory.packing import pack, unpack
from ekf_companion.nav.arrays import Column, Table

EPOCH_STEP = cython.declare(cython.longlong, 1 << 52)
"""Epochs are whole multiples of 52 days: times since one are exact in a double."""
SNAPSHOT_EVERY = cython.declare(cython.Py_ssize_t, 16)
"""Inertial samples between two snapshots: at 250 Hz a late event re-runs 32 ms more at the most."""
SAVED = cython.declare(cython.Py_ssize_t, 64)
"""Snapshots with fault hypotheses, at most, of some 0.3 MB each: four seconds at 250 Hz."""
LOST_AFTER = cython.declare(cython.Py_ssize_t, 250)
"""So many inertial samples in a row too old for the window mean that the clock itself went back."""
LEAP = cython.declare(cython.double, 1e8)
"""An inertial stamp that is further ahead than this, ns, and than LEAP_STEPS, waits for another."""
LEAP_STEPS = cython.declare(cython.double, 10.0)
"""Intervals of the stream; a slow one leaps further."""
AHEAD = cython.declare(cython.Py_ssize_t, 16)
"""Samples that wait for another, at most."""
BEHIND = cython.declare(cython.Py_ssize_t, 1024)
"""Events that wait until it is known whether the clock was set back, at most."""
SURE = cython.declare(cython.Py_ssize_t, 8)
"""So many samples in a row that are behind and find no room tell whether the clock was set back."""
CERTAIN = cython.declare(cython.double, 6.9)
"""Log-likelihood by which they are of a second path: odds of a thousand, for if they are not, some
motion is lost that no sigma has. A clock that is set in doubt leaves the doubt in P. In 300 tries
of four kinds of flight no clock that was set back came beyond odds of ten; a second path comes to
these in all of a figure-eight, in 92 % of a hover (91 % to ten times as much), in few of a steady
circle. Of one who stands between steps both do."""
ROOM = cython.declare(cython.double, 1.9)
"""Intervals between two samples, between which there is room for another: one was lost or late."""
ORDERLY = cython.declare(cython.double, 1e9)
"""Time, ns, in which no sample came late."""
EVER = cython.declare(cython.double, 1e300)
EVIDENCE = cython.declare(cython.Py_ssize_t, 4096)
"""Moments at which it is kept how probable each source's fault was: once a second for an hour, of a
longer flight less often."""
Vector3 = tuple[float, float, float]
COMPILED_BLOCK = BLOCK
"""Size of the state that this module was compiled for."""


def root(variance: float) -> float:
    """Return the root of a variance, of which rounding may have left less than none."""
    return sqrt(variance) if variance > 0.0 else 0.0


class Timeline:
    """The estimator over time: insert events as they arrive, and read the current state.

    To read: ``epoch_ns``, what the times in the state count from; ``stamp_ns``, the stamp of the
    newest inertial sample; ``reruns``, how often a late event made the filter go back;
    ``reboots``, how many of its resets were reboots of the autopilot.
    """

    def __init__(
        self,
        parameters: np.ndarray,
        delay_ns: np.ndarray,
        window_ns: int,
        capacity: int = 8192,
        keeps_history: bool = False,
    ) -> None:
        """Begin with an empty timeline.

        Args:
            parameters: :class:`~.parameters.Parameters` as numbers, shape (PARAMETERS,).
            delay_ns: How late the stamps of each kind are, ns, shape (kinds,).
            window_ns: How far back a late event is still taken, ns.
            capacity: Rows to hold, at least 64; with fewer than come in twice the window, the
                window shrinks.
            keeps_history: Rows that leave the window are kept for :meth:`history`.
        """
        if not cython.compiled:
            self.w = Scratch()
        self.retune(parameters)
        self.delay: Column[np.int64] = np.ascontiguousarray(delay_ns, dtype=np.int64).copy()
        self.window = float(window_ns)
        self.capacity = capacity
        self.table = np.zeros((capacity, ROW))
        self.rows = as_events(self.table)
        # between two snapshots there are always so many inertial rows
        self.snapshot_table = np.zeros((capacity // SNAPSHOT_EVERY + 2, BLOCK))
        self.snapshots = as_states(self.snapshot_table)
        self.snapshot_row = np.zeros(capacity // SNAPSHOT_EVERY + 2, dtype=np.int64)
        self.blocks = np.zeros((4, BLOCK))
        self.x = as_state(self.blocks[0])
        self.y = as_state(self.blocks[1])
        self.first = as_state(self.blocks[2])
        self.mark = as_state(self.blocks[3])
        self.mark_row = -1
        # banks of the state, of the mark, of the snapshots: pages that are not used cost nothing
        has_bank = cython.declare(cython.bint, self.k.weighs_faults != 0.0)
        self.most_snaps: int = SAVED if has_bank else capacity
        count = 2 + self.most_snaps if has_bank else 1
        self.bank_table = np.zeros((count, BANK if has_bank else 1))
        self.banks = as_banks(self.bank_table)
        self.w.observation.has_bank = has_bank
        self.w.observation.bank = self.banks
        self.evidence_table = np.zeros((EVIDENCE if has_bank else 1, 3 + enums.SOURCES))
        self.evidence_size = 0
        self.evidence_step = 1e9
        self.expected_t = EVER
        self.late_last = np.zeros(len(self.delay))
        self.late_next = np.full(len(self.delay), -1.0)
        self.out = np.zeros(OUT)
        self.numbers = np.zeros(ODOMETRY)
        self.singles = np.zeros(ODOMETRY, dtype=np.float32)
        self.given = np.zeros(VALUES)
        self.counters = np.zeros((len(self.delay), 8), dtype=np.int64)
        self.ahead = Held(AHEAD)
        self.behind = Held(BEHIND)
        self.interval = self.late_t = self.behind_t = self.behind_first = self.second_path = 0.0
        self.has_epoch = False
        self.is_restored = False
        self.is_set = False
        self.epoch_ns = 0
        self.lost = 0
        self.reruns = 0
        self.reboots = 0
        self.rebooted_at = 0
        self.reason_before: int = enums.RESET_NONE
        self.stretch = 0
        self.keeps = keeps_history
        self.gone: list[tuple[int, int, np.ndarray, np.ndarray]] = []
        self.banks_before: list[tuple[int, np.ndarray]] = []
        self._clear()

    def _clear(self) -> None:
        """Forget all events; the state that remains is the one to begin from."""
        self.size = 0
        self.cursor = 0
        self.snaps = 1
        self.snapshot_row[0] = -1
        self.mark_row = -1
        copy_state(address(self.snapshots[0]), self.x)
        self._copy_bank(2, 0)
        self.newest = -1.0
        self.oldest = -1.0
        self.reach = EVER
        self.stamp_ns = 0
        self.behind.size = 0
        self.behind_samples = 0
        self.second_path = 0.0
        self.is_leaping = False
        while self.ahead.size > 0:
            self._recount(self.ahead, 0, enums.ARRIVAL_STRAY)
            remove(self.ahead, 0)

    def _restart(self) -> None:
        """Begin anew on a clock that began anew.

        Beside the count of resets lives on what was learnt of what did not begin anew.
        """
        resets = self.x.resets + 1.0 if self.x.mode != enums.MODE_INIT else self.x.resets
        self._hand_over(self.cursor)
        copy_state(self.y, self.x)
        self.blocks[0, :] = 0.0
        if self.w.observation.has_bank:
            if self.banks[0].finds > 0:
                self._keep_found()
            self.bank_table[0, :] = 0.0
        if self.y.mode == enums.MODE_NAVIGATE:
            carry_over(self.x, self.y, self.k)
        self.x.resets = resets
        self.x.reset_reason = enums.RESET_CLOCK
        self.has_epoch = False
        self.is_restored = False
        self.is_set = False
        self.lost = 0
        self._begin_stretch()
        self._clear()

    def _keep_found(self) -> None:
        """Keep what was found by a clock that begins anew, for :meth:`found`."""
        self.banks_before.append((self.epoch_ns, np.array(self.bank_table[:1])))

    def _reboot(self) -> None:
        """Begin anew as the autopilot does, and count that beside the resets of other reasons."""
        before = cython.declare(cython.double, self.x.resets)
        reason = cython.declare(cython.longlong, self._last_reason())
        self._restart()
        if self.x.resets > before:
            self.reboots += 1
        self.rebooted_at = cython.cast(cython.longlong, self.x.resets)
        self.reason_before = reason

    def _last_reason(self) -> int:
        """Return why the last reset was made that was no reboot."""
        if self.rebooted_at > 0 and self.x.resets == self.rebooted_at:
            return self.reason_before
        return cython.cast(cython.longlong, self.x.reset_reason)

    def _begin_stretch(self) -> None:
        """Begin a stretch of the history with the state of now."""
        copy_state(self.first, self.x)
        self.stretch += 1

    def _set_clock(self, t_ns: int) -> None:
        """Continue on a clock that was set: its first inertial sample follows the last of the old.

        How long there was between the two nobody knows; it is taken for the usual interval, and the
        position is no surer than the way in the time by which the clock went back: the same motion
        may have been heard twice. What was heard by the old clock stays as it is, and no event goes
        behind it. It counts as a reset: whoever compares stamps is told that they have moved.
        """
        self.is_set = False
        self._hand_over(self.cursor)
        begin_reset(self.x, enums.RESET_CLOCK)
        back = cython.declare(cython.double, 1e-9 * (self.stamp_ns - t_ns))
        for i in range(3):
            add_variance(self.x, enums.E_POS + i, self.x.vel_n[i] * self.x.vel_n[i] * back * back)
            for j in range(i):
                way = self.x.vel_n[i] * self.x.vel_n[j] * back * back
                add_covariance(self.x, enums.E_POS + i, enums.E_POS + j, way)
        if self.x.mode == enums.MODE_NAVIGATE:
            # until fixes by the new clock have had their say
            proven_t = self.x.t + 1e9 * late_fix(self.x)
            if self.x.at_rest == 0.0 and proven_t > self.x.proven_t:
                self.x.proven_t = proven_t
        shown = cython.cast(cython.longlong, self.x.t + 1e9 * self.x.dt)
        self.epoch_ns = t_ns - self.delay[enums.KIND_IMU] - shown
        self._begin_stretch()
        self._begin_from(self.x.t, t_ns)

    def set_origin(self, lat: float, lon: float, alt: float, offset: np.ndarray) -> None:
        """Begin with an origin that is given (rad, rad, m), not at the first fix.

        Args:
            lat: Its latitude.
            lon: Its longitude.
            alt: Its altitude.
            offset: The receiver's slow error when it was last estimated in that frame, n, shape
                (3,), m: what the first fix is expected to be off by.
        """
        set_origin(self.x, lat, lon, alt)
        for i in range(3):
            self.x.gnss_offset[i] = offset[i]
        copy_state(address(self.snapshots[0]), self.x)

    def restore(
        self,
        block: Numbers,
        waiting: Table[np.float64],
        epoch_ns: int,
        stamp_ns: int,
        bank: Numbers,
    ) -> None:
        """Go on from a state that another timeline was in; that counts as a reset.

        The next inertial sample decides: within the gap that is bridged (``imu.gap``) nothing was
        lost, and it runs on to the bit. Later, what was true meanwhile was not all heard, so none
        of it is used: the sample ends a gap, and the window begins with it.

        Args:
            block: The state, shape (BLOCK,).
            waiting: Rows that waited for a sample, in order of time, shape (n, ROW).
            epoch_ns: What the times in both count from, ns.
            stamp_ns: Stamp of the newest inertial sample, ns.
            bank: The fault hypotheses of that state, as :meth:`bank` returned them; empty: none
                are known, and they begin anew.
        """
        count = min(waiting.shape[0], self.capacity // 2)
        self.blocks[0, :] = block
        self.x.resets += 1.0
        self.x.reset_reason = enums.RESET_RESTART
        self.epoch_ns = epoch_ns
        self.has_epoch = True
        self.is_restored = True
        self.is_set = False
        self.lost = 0
        if self.w.observation.has_bank:
            np.asarray(self.bank_table)[0] = unpack(np.asarray(bank))
            if bank.shape[0] > 0 and self.banks[0].resets == self.x.resets:
                self.banks[0].resets += 1.0  # the reset just counted has moved nothing
        self._begin_from(self.x.t, stamp_ns)
        self.table[:count, :] = waiting[:count, :]
        self.size = count

    def _begin_from(self, t: float, t_ns: int) -> None:
        """Forget all events up to the newest sample, which was at t: none may go behind it."""
        self._clear()
        self.newest = t
        self.oldest = t
        self.stamp_ns = t_ns

    def insert(self, t_ns: int, kind: int, values: np.ndarray | tuple[float, ...]) -> int:
        """Insert one event on its arrival and run the filter as far as it now can.

        Args:
            t_ns: Its stamp.
            kind: :class:`~.nav.measurements.Kind`.
            values: As many as a row of nav.measurements holds.

        Returns:
            What became of it: an :class:`~.enums.Arrival`; ESTIMATED for an inertial sample that is
            the newest, so that there is an estimate for its stamp.
        """
        for i in range(VALUES):
            self.given[i] = values[i]
        return self._put(t_ns, kind, self.given)

    def _put(self, t_ns: int, kind: int, values: Numbers) -> int:
        """Do the work of :meth:`insert`, and count the result by kind."""
        result = enums.ARRIVAL_MALFORMED
        if kind == enums.KIND_RESTART:
            if values[0] != 0.0 and self.newest >= 0.0:
                self.is_set = True
            else:
                self._reboot()
            result = enums.ARRIVAL_RESTARTED
        elif kind < self.delay.shape[0] and is_sane(kind, values):
            result = self._place(t_ns, kind, values)
        if 0 <= kind < self.delay.shape[0]:
            self.counters[kind, result] += 1
        if result == enums.ARRIVAL_ESTIMATED and self.w.observation.has_bank:
            self._keep_evidence(t_ns)
        return result

    def _keep_evidence(self, t_ns: int) -> None:
        """Keep how probable each source's fault is, and the protection levels, once in a while."""
        n = self.evidence_size
        t = cython.cast(cython.double, t_ns)
        if n > 0 and 0.0 <= t - self.evidence_table[n - 1, 0] < self.evidence_step:
            return
        if n == EVIDENCE:  # every second one stays
            n = EVIDENCE // 2
            for i in range(n):
                for j in range(self.evidence_table.shape[1]):
                    self.evidence_table[i, j] = self.evidence_table[2 * i, j]
            self.evidence_step *= 2.0
        find_levels(self.x, self.k, address(self.w))
        self.evidence_table[n, 0] = t
        self.evidence_table[n, 1] = self.w.protection.horizontal
        self.evidence_table[n, 2] = self.w.protection.vertical
        self._write_probabilities(self.evidence_table[n, 3:])
        self.evidence_size = n + 1

    def _write_probabilities(self, out: Numbers) -> None:
        """Write how probable it is of each source that it is wrong, shape (SOURCES,)."""
        for source in range(enums.SOURCES):
            out[source] = 0.0
        for i in range(self.banks[0].n):
            h = address(self.banks[0].instance[i])
            out[self.k.fault[h.kind].source] += h.p

    def _place(self, t_ns: int, kind: int, values: Numbers) -> int:
        """Insert a well-formed event at its time, and rerun what came after it."""
        is_bridge = cython.declare(cython.bint, False)
        is_stale = cython.declare(cython.bint, False)
        if not self.has_epoch:
            # the same whichever event comes first, and near enough for exact doubles
            self.epoch_ns = t_ns // EPOCH_STEP * EPOCH_STEP
            self.has_epoch = True
        t = cython.cast(cython.double, t_ns - self.delay[kind] - self.epoch_ns)
        if self.is_set and self.behind.size == 0:
            # which time it is now, the next inertial sample says
            if kind != enums.KIND_IMU:
                return enums.ARRIVAL_STALE
            if t > self.newest or t < self.newest - self.window or t <= self.oldest:
                self._set_clock(t_ns)
                t = cython.cast(cython.double, t_ns - self.delay[kind] - self.epoch_ns)

        # Too old to go back to?
        if self.size == self.capacity or self.snaps == self.most_snaps:
            self._trim()
        is_stale = self.newest >= 0.0 and (t < self.newest - self.window or t <= self.oldest)
        if kind != enums.KIND_IMU:
            if self.behind.size > 0 and add(self.behind, t_ns, kind, values, enums.ARRIVAL_TAKEN):
                return enums.ARRIVAL_TAKEN
            return enums.ARRIVAL_STALE if is_stale else self._fit(t_ns, t, kind, values)

        # The first sample after a restart: what waits for it was true while nobody listened?
        if self.is_restored and not is_stale:
            self.is_restored = False
            is_bridge = (t - self.x.t) * 1e-9 > self.k.gap
            if is_bridge:
                self.size = 0

        # Do its neighbours confirm its stamp?
        elif self.is_set and t > self.newest:
            return self._judge_clock(t_ns, values)
        elif t > self.reach:
            if not self._is_confirmed(t):
                return self._hold(t_ns, values)
            self._release(t)
        elif t <= self.newest:
            return self._go_behind(t_ns, t, values, is_stale)
        self.second_path = 0.0
        if self.behind.size > 0:
            self._flush()
        self._learn_interval(t - self.newest)
        result = self._fit(t_ns, t, kind, values)
        if is_bridge:
            self._begin_from(t, t_ns)
        elif self.ahead.size > 0:
            self._settle(t)
        return result

    def _fit(self, t_ns: int, t: float, kind: int, values: Numbers) -> int:
        """Insert an event that is neither too old nor in doubt; rerun what came after it."""
        if self.size == self.capacity or self.snaps == self.most_snaps:
            self._trim()

        # Find the place: after all that is earlier, in an order that arrival has no part in
        i = self.size
        while i > 0:
            order = compare(address(self.rows[i - 1]), t, kind, values)
            if order == 0:
                return enums.ARRIVAL_DUPLICATE
            if order < 0:
                break
            i -= 1
        self._write_row(i, t, kind, values)
        if i < self.cursor:
            self._expect_late(t, kind)
            self._go_back(i)
            self._run()
            return enums.ARRIVAL_TAKEN
        if kind != enums.KIND_IMU:
            return enums.ARRIVAL_TAKEN
        self._run()
        self.lost = 0
        self.newest = t
        self.stamp_ns = t_ns
        self.is_leaping = False
        self.reach = EVER
        if self.interval > 0.0:
            far = LEAP_STEPS * self.interval
            self.reach = t + (far if far > LEAP else LEAP)
        return enums.ARRIVAL_ESTIMATED

    def _learn_interval(self, step: float) -> None:
        """Learn the usual interval from a step to the next sample: rather the shorter ones."""
        if self.newest < 0.0:
            self.late_t = self.newest + step
        elif self.interval == 0.0:
            self.interval = step
        elif step < self.interval:
            self.interval += 0.2 * (step - self.interval)
        elif step < 2.0 * self.interval:
            self.interval += 0.05 * (step - self.interval)
        else:
            self.interval *= 1.05

    def _time_of(self, held: Held, i: int) -> float:
        """Return the time of an event that is held."""
        return cython.cast(cython.double, held.t_ns[i] - self.delay[held.kind[i]] - self.epoch_ns)

    def _recount(self, held: Held, i: int, result: int) -> None:
        """Count for an event that was held what became of it."""
        self.counters[held.kind[i], held.result[i]] -= 1
        self.counters[held.kind[i], result] += 1

    def _has_room(self, t: float) -> bool:
        """Return whether a sample is missing where an earlier time than the newest's lies."""
        i = last_sample(self.rows, self.size, t)
        following = next_sample(self.rows, self.size, i)
        before = self.rows[i].t if i >= 0 else self.oldest
        after = self.rows[following].t if following < self.size else self.newest
        return before < 0.0 or after - before > ROOM * self.interval

    def _is_confirmed(self, t: float) -> bool:
        """Return whether a stamp that leaps ahead goes on from one that did so before."""
        if self.ahead.size == 0:
            return False
        if self.is_leaping and t > self._time_of(self.ahead, self.ahead.size - 1):
            return True
        for i in range(self.ahead.size):
            step = t - self._time_of(self.ahead, i)
            if 0.0 < step <= self.reach - self.newest:
                return True
        return False

    def _hold(self, t_ns: int, values: Numbers) -> int:
        """Let a sample whose stamp leaps ahead wait."""
        self.is_leaping = True
        if not add(self.ahead, t_ns, enums.KIND_IMU, values, enums.ARRIVAL_HELD):
            return enums.ARRIVAL_STRAY
        return enums.ARRIVAL_HELD

    def _release(self, t: float) -> None:
        """Insert the samples that wait and are not later than a time: samples before were lost."""
        while True:
            i = self._earliest()
            if i < 0 or self._time_of(self.ahead, i) > t:
                break
            at = self._time_of(self.ahead, i)
            self._fit(self.ahead.t_ns[i], at, enums.KIND_IMU, self.ahead.values[i])
            self._recount(self.ahead, i, enums.ARRIVAL_TAKEN)
            remove(self.ahead, i)

    def _settle(self, t: float) -> None:
        """Decide on the samples that wait whose time the others have reached.

        One that came early finds room there. One without room had a wrong stamp; but as long as
        samples come late it cannot be said what room there will be.
        """
        is_orderly = cython.declare(cython.bint, t - self.late_t > ORDERLY)
        margin = self.interval if is_orderly else 0.0
        while True:
            i = self._earliest()
            if i < 0 or self._time_of(self.ahead, i) + margin > t:
                break
            at = self._time_of(self.ahead, i)
            result = enums.ARRIVAL_STRAY
            if not is_orderly or self._has_room(at):
                result = self._fit(self.ahead.t_ns[i], at, enums.KIND_IMU, self.ahead.values[i])
            self._recount(self.ahead, i, result)
            remove(self.ahead, i)

    def _earliest(self) -> int:
        """Return which of the samples that wait is the earliest; -1: none does."""
        first = -1
        for i in range(self.ahead.size):
            if first < 0 or self.ahead.t_ns[i] < self.ahead.t_ns[first]:
                first = i
        return first

    def _go_behind(self, t_ns: int, t: float, values: Numbers, is_stale: bool) -> int:
        """Insert a sample that is not the newest, unless it may be of a clock that was set back.

        Samples that find no room wait, with all that came since, until SURE of them have followed
        one another by the interval: no stream has room for so many that are merely late.
        """
        if is_late(values) and not is_stale and not self.is_set:
            self._flush()
            return self._fit(t_ns, t, enums.KIND_IMU, values)
        if is_stale:
            self.lost += 1
            if self.lost >= LOST_AFTER:
                self._restart()
                return enums.ARRIVAL_STALE
        elif self._is_known(t, values):
            if self.is_set:
                self.is_set = False
                self._flush()
            return enums.ARRIVAL_DUPLICATE
        elif not self.is_set and self._has_room(t):
            self.late_t = self.newest
            self._flush()
            return self._fit(t_ns, t, enums.KIND_IMU, values)
        step = t - self.behind_t
        if self.behind.size > 0 and not 0.0 < step <= self.reach - self.newest:
            if self.is_set:
                return self._judge_clock(t_ns, values)
            self._flush()
        result = enums.ARRIVAL_STALE if is_stale else enums.ARRIVAL_TAKEN
        if not add(self.behind, t_ns, enums.KIND_IMU, values, result):
            self._flush()
            return result if is_stale else self._fit(t_ns, t, enums.KIND_IMU, values)
        if self.behind.size > 1 and step < self.interval:
            self.interval += 0.2 * (step - self.interval)
        self.behind_t = t
        if is_stale:
            return result
        self.behind_samples += 1
        if self.behind_samples == 1:
            self.behind_first = t
        if self.behind_samples < SURE:
            return result
        usual = (SURE - 1) * self.interval
        if self.is_set or 0.5 * usual <= t - self.behind_first <= 1.5 * usual:
            return self._follow_clock()
        self._flush()
        return result

    def _judge_clock(self, t_ns: int, values: Numbers) -> int:
        """Decide by the samples that wait whether the clock was set, then insert another."""
        self._follow_clock()
        return self._place(t_ns, enums.KIND_IMU, values)

    def _is_known(self, t: float, values: Numbers) -> bool:
        """Return whether a sample is a copy of one that is in the window."""
        for i in range(self.size - 1, -1, -1):
            order = compare(address(self.rows[i]), t, enums.KIND_IMU, values)
            if order <= 0:
                return order == 0
        return False

    def _follow_clock(self) -> int:
        """Go on by a clock that was set back, from the first event that came by it.

        Unless what came is of a second path: then it is late.
        """
        result = enums.ARRIVAL_TAKEN
        offset = self.delay[enums.KIND_IMU] + self.epoch_ns
        self.second_path += weigh_second_path(self.rows, self.size, self.behind, offset)
        if self.second_path > CERTAIN:
            self.is_set = False
            self._flush()
            return result
        if not self.is_set:
            self.counters[enums.KIND_RESTART, enums.ARRIVAL_RESTARTED] += 1
        events = self.behind
        self.behind = Held(BEHIND)
        if self.x.mode == enums.MODE_NAVIGATE and self.x.at_rest == 0.0:
            then = 0
            begin = self._time_of(events, 0)
            while then < self.snaps - 1 and self.snapshots[then + 1].t <= begin:
                then += 1
            inflate_by_second_path(self.x, address(self.snapshots[then]), self.second_path)
        self._set_clock(events.t_ns[0])
        for i in range(events.size):
            result = self._place(events.t_ns[i], events.kind[i], events.values[i])
            if i < events.size - 1:
                self._recount(events, i, result)
        return result

    def _flush(self) -> None:
        """Insert the events that waited until it was known that the clock was not set back."""
        self.behind_samples = 0
        for i in range(self.behind.size):
            result = self.behind.result[i]
            if result == enums.ARRIVAL_TAKEN:
                t = self._time_of(self.behind, i)
                if t < self.newest - self.window or t <= self.oldest:
                    result = enums.ARRIVAL_STALE
                else:
                    kind = self.behind.kind[i]
                    result = self._fit(self.behind.t_ns[i], t, kind, self.behind.values[i])
            self._recount(self.behind, i, result)
        self.behind.size = 0

    def _write_row(self, i: int, t: float, kind: int, values: Numbers) -> None:
        """Write an event as row i; the rows from there on move up."""
        for j in range(self.size, i, -1):
            self.rows[j] = self.rows[j - 1]
        self.rows[i].t = t
        self.rows[i].kind = kind
        for j in range(VALUES):
            self.rows[i].values.all[j] = values[j]
        self.size += 1

    def _expect_late(self, t: float, kind: int) -> None:
        """Learn from a late event at which time the next one is expected.

        Those of each kind come as far apart as the last two. A wrong guess costs time, no bit.
        """
        self.late_next[kind] = t + (t - self.late_last[kind])
        self.late_last[kind] = t
        self.expected_t = EVER
        for other in range(self.delay.shape[0]):
            soonest = self.late_next[other]
            if other != enums.KIND_IMU and t <= soonest < self.expected_t:
                self.expected_t = soonest

    def _go_back(self, i: int) -> None:
        """Go back to the last snapshot before row i, or to the mark."""
        while self.snapshot_row[self.snaps - 1] >= i:
            self.snaps -= 1
        base = self.snapshot_row[self.snaps - 1]
        if base < self.mark_row < i:
            copy_state(self.x, self.mark)
            self._copy_bank(0, 1)
            self.cursor = self.mark_row + 1
        else:
            copy_state(self.x, address(self.snapshots[self.snaps - 1]))
            self._copy_bank(0, 1 + self.snaps)
            self.cursor = base + 1
        if self.mark_row >= i:
            self.mark_row = -1
        self.reruns += 1

    def _copy_bank(self, to: int, source: int) -> None:
        """Copy a bank, where there are any: the first one runs, the others are saved."""
        if not self.w.observation.has_bank:
            return
        if source == 0:
            columns.save(address(self.banks[to]), address(self.banks[0]), carried(self.x))
        elif to == 0:
            columns.load(address(self.banks[0]), address(self.banks[source]))
        else:
            columns.copy_saved(address(self.banks[to]), address(self.banks[source]))

    def _run(self) -> None:
        """Step through all rows up to the last inertial sample, leaving snapshots behind.

        Snapshots lie at samples of round number, so that whatever order the events came in, the
        last good state is the same one. A state that cannot be is replaced by it; what cannot be a
        second time so soon is not kept: the filter starts over.
        """
        first = self.cursor
        for i in range(self.cursor, self.size):
            if self.rows[i].kind != enums.KIND_IMU:
                continue
            step.step(self.x, self.k, address(self.w), self.rows, first, i)
            first = i + 1
            self.cursor = first
            if not is_sound(self.x):
                good = address(self.snapshots[self.snaps - 1])
                recover(self.x, self.k, good, self.rows[i].t)
                self._copy_bank(0, 1 + self.snaps)
            if self.x.samples % SNAPSHOT_EVERY == 0.0:
                copy_state(address(self.snapshots[self.snaps]), self.x)
                self._copy_bank(2 + self.snaps, 0)
                self.snapshot_row[self.snaps] = i
                self.snaps += 1
            # One interval early: stamps jitter
            ahead = self.expected_t - self.rows[i].t - self.interval
            if 0.0 < ahead <= self.interval:
                copy_state(self.mark, self.x)
                self._copy_bank(1, 0)
                self.mark_row = i

    def _trim(self) -> None:
        """Drop the rows older than the window; if there is no room, what matters least."""
        base = 0
        first = 0
        for i in range(1, self.snaps):
            if self.rows[self.snapshot_row[i]].t < self.newest - self.window:
                base = i
        if base == 0 and self.size - self.cursor > self.size // 2:
            # half waits for a sample that does not come: the older ones have waited enough
            first = self.cursor
            gone = (self.size - self.cursor + 1) // 2
        else:
            if base == 0:
                base = self.snaps // 2
            if base == 0:
                # hardly an inertial sample among all these rows: begin from now
                base = 1
                copy_state(address(self.snapshots[1]), self.x)
                self._copy_bank(3, 0)
                self.snapshot_row[1] = self.cursor - 1
                self.snaps = 2
            gone = self.snapshot_row[base] + 1
            self._hand_over(gone)
            self.oldest = self.snapshots[base].t
            for i in range(base, self.snaps):
                copy_state(address(self.snapshots[i - base]), address(self.snapshots[i]))
                self._copy_bank(2 + i - base, 2 + i)
                self.snapshot_row[i - base] = self.snapshot_row[i] - gone
            self.snaps -= base
            self.snapshot_row[0] = -1
            self.cursor -= gone
            self.mark_row = max(self.mark_row - gone, -1)
        for i in range(first + gone, self.size):
            self.rows[i - gone] = self.rows[i]
        self.size -= gone

    def run_log(
        self,
        t_ns: Column[np.int64],
        kind: Column[np.int64],
        values: Table[np.float64],
        stamps: Column[np.int64],
        out: Table[np.float64],
    ) -> int:
        """Insert a table of events in order of arrival, and write an estimate per newest sample.

        Args:
            t_ns: Stamps, shape (n,).
            kind: Kinds, shape (n,).
            values: Values, shape (n, WIDTH).
            stamps: Receives the stamps of the estimates, shape at least (inertial samples,).
            out: Receives the estimates, shape as stamps, by OUT.

        Returns:
            The number of estimates written.
        """
        n = 0
        with cython.nogil:  # whatever else is done with the estimates goes on meanwhile
            for i in range(t_ns.shape[0]):
                arrival = self._put(t_ns[i], cython.cast(cython.int, kind[i]), values[i])
                if arrival == enums.ARRIVAL_ESTIMATED:
                    write_estimate(self.x, self.k, self.y, address(self.w), as_estimate(out[n]))
                    stamps[n] = t_ns[i]
                    n += 1
        return n

    def _hand_over(self, count: int) -> None:
        """Keep the first rows for the history: they were stepped through and stay as they are."""
        if self.keeps and count > 0:
            self._keep(count)

    def _keep(self, count: int) -> None:
        """Do the work of ``_hand_over``, which needs the interpreter."""
        state, rows = np.array(self.blocks[2]), np.array(self.table[:count])
        self.gone.append((self.stretch, self.epoch_ns, state, rows))

    def history(self, is_over: bool = False) -> list[tuple[int, int, np.ndarray, np.ndarray]]:
        """Return the rows that have left the window since this was asked last, in order of time.

        Args:
            is_over: No event comes any more: with what is in the window, up to the newest sample.

        Returns:
            Parts, each ending with an inertial sample: the number of the stretch (a restart of the
            clock begins another), its epoch (ns), the state that it began from, shape (BLOCK,), and
            the rows, shape (n, ROW).
        """
        if is_over:
            self._hand_over(self.cursor)
        parts = self.gone
        self.gone = []
        return parts

    def describe(self) -> np.ndarray:
        """Return the estimate at the newest sample's stamp, shape (OUT,)."""
        write_estimate(self.x, self.k, self.y, address(self.w), as_estimate(self.out))
        return np.array(self.out)

    def odometry(self) -> tuple[int, int, bytes]:
        """Return status, resets and ODOMETRY's numbers of the estimate of now, as floats.

        The numbers are of no use before there is a position.
        """
        w = address(self.w)
        out = as_estimate(self.out)
        status = write_estimate(self.x, self.k, self.y, w, out)
        write_odometry(self.x, self.y, out, w, as_odometry(self.numbers))
        for i in range(ODOMETRY):
            self.singles[i] = self.numbers[i]
        return status, int(self.x.resets), bytes(self.singles)

    def retune(self, parameters: np.ndarray) -> None:
        """Go on with other numbers of the filter, shape (PARAMETERS,).

        What a late event makes run again from now on is run by these too.
        """
        self.parameters: Numbers = np.ascontiguousarray(parameters, dtype=np.float64).copy()
        self.k = as_parameters(self.parameters)
        self.mark_row = -1

    def block(self) -> np.ndarray:
        """Return a copy of the state, shape (BLOCK,)."""
        return np.array(self.blocks[0])

    def waiting(self) -> np.ndarray:
        """Return a copy of the rows that wait for the next inertial sample, shape (n, ROW)."""
        return np.array(self.table[self.cursor : self.size])

    def bank(self) -> np.ndarray:
        """Return a copy of the fault hypotheses, as far as there are any; empty: without a bank."""
        if not self.w.observation.has_bank:
            return np.zeros(0)
        return pack(np.asarray(self.bank_table[0]))

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (rad), altitude (m) of the local frame; None before a fix."""
        origin = address(self.x.origin)
        return (origin.lat, origin.lon, origin.alt) if origin.is_known else None

    @property
    def reasons(self) -> int:
        """Why the estimate is not OK, as bits: a :class:`~.nav.state.Reason`."""
        return find_reasons(self.x, self.k, address(self.w))

    def hypotheses(self) -> list[tuple[int, float, int, tuple[float, float, float]]]:
        """Return what may be wrong now: of each instance kind, probability, onset and size.

        Empty without ``weigh_faults``. The onset is a stamp, ns; the size is in the fault's unit.
        """
        held = []
        if self.w.observation.has_bank:
            for i in range(self.banks[0].n):
                h = address(self.banks[0].instance[i])
                onset = int(h.t0) + self.epoch_ns
                held.append((int(h.kind), float(h.p), onset, (h.b[0], h.b[1], h.b[2])))
        return held

    def found(self, is_now: bool = False) -> list[tuple[int, int, int, Vector3, Vector3, float]]:
        """Return the faults that were beyond doubt; or only those by the clock of now.

        Of each: kind, onset, until when (stamps, ns), size and one sigma of that by component, and
        the log-likelihood beside that of no fault, then.
        """
        told = []
        before = [] if is_now else self.banks_before
        for epoch, table in [*before, (self.epoch_ns, np.asarray(self.bank_table))]:
            numbers: Table[np.float64] = table
            for i in range(as_banks(numbers)[0].finds if self.w.observation.has_bank else 0):
                one = address(as_banks(numbers)[0].found[i])
                onset, until = int(one.onset) + epoch, int(one.until) + epoch
                size = one.b[0], one.b[1], one.b[2]
                std = root(one.var[0]), root(one.var[1]), root(one.var[2])
                told.append((int(one.kind), onset, until, size, std, float(one.evidence)))
        return told

    def suspected(self) -> np.ndarray:
        """Return how probable it is of each source that it is wrong, shape (SOURCES,).

        What shows in the level and what shows in the vertical may be there at once: one sum each.
        Zero without ``weigh_faults``.
        """
        found = np.zeros(enums.SOURCES)
        if self.w.observation.has_bank:
            self._write_probabilities(found)
        return found

    def declared(self) -> tuple[float, float, float, float, float, bool, bool]:
        """Return by how much sources are off that were declared and are not right again.

        Position and height of the receiver (m), its velocity in the level and vertically (m/s), the
        heading (rad), each 0 where that is no more than what is not known of it, or than its usual
        slow error; and whether position and height go on to slide.
        """
        off = [0.0, 0.0]
        slides = [False, False]
        rates = [0.0, 0.0]
        heading = 0.0
        if self.w.observation.has_bank:
            b = address(self.banks[0])
            for level, kind in enumerate((enums.FAULT_RECOVERY, enums.FAULT_RECOVERY_HEIGHT)):
                size = root(shape.held_square(b, kind))
                slides[level] = bool(shape.slide_square(b, kind) > 0.0)
                # as of the end of such a fault
                if slides[level] or size > root(THREE_SIGMA2 * shape.end_variance(self.x, b, kind)):
                    off[level] = size
            o = self.x.gnss_vel_offset
            usual = root(THREE_SIGMA2) * float(self.k.gnss_vel_slow_std)
            speeds = root(o[0] * o[0] + o[1] * o[1]), abs(float(o[2]))
            rates = [speed if speed > usual else 0.0 for speed in speeds]
            var = self.x.heading_std * self.x.heading_std + b.heading_off_var
            if b.heading_off * b.heading_off > THREE_SIGMA2 * var:
                heading = abs(float(b.heading_off))
        return off[0], off[1], rates[0], rates[1], heading, slides[0], slides[1]

    def protection(self) -> tuple[float, float]:
        """Return the protection levels of now, horizontal and vertical, m.

        NaN where the fault hypotheses do not decide, or there is no position.
        """
        find_levels(self.x, self.k, address(self.w))
        return float(self.w.protection.horizontal), float(self.w.protection.vertical)

    def evidence(self) -> np.ndarray:
        """Return what was thought of each source over time, shape (n, 3 + SOURCES).

        By each clock in order of time, once a second or less often: stamp (ns), horizontal and
        vertical protection level (m; NaN: none), and how probable it was of each source that it is
        wrong.
        """
        return np.array(self.evidence_table[: self.evidence_size])

    @property
    def reset_reason(self) -> int:
        """Why the last reset was made that was no reboot."""
        return int(self._last_reason())

    @property
    def resets(self) -> int:
        """How often the state was reset."""
        return int(self.x.resets)

    @property
    def arrivals(self) -> np.ndarray:
        """How many events of each kind (rows) met each result (columns)."""
        return np.array(self.counters)
