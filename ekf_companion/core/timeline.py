# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The order of time: events take the place where they were true, whenever they arrive.

A window of the last seconds is kept as sorted rows, with snapshots of the state block between them.
A late event goes back to the snapshot before it and all that came after is run again; so the state
depends on what was measured, never on the order in which it arrived.

An event between two inertial samples waits for the second one, whose interval it splits: no guess
about the rate is ever made and corrected later.
"""

from __future__ import annotations

from collections.abc import Sequence

import cython
import numpy as np

if cython.compiled:
    from cython.cimports.ekf_companion.core import kernel, odometry
    from cython.cimports.ekf_companion.core import state as at
    from cython.cimports.libc.math import fabs, isfinite, isnan
else:
    from math import fabs, isfinite, isnan

    from ekf_companion.core import kernel, odometry
    from ekf_companion.core import state as at

IMU = cython.declare(cython.double, 6.0)
RESTART = cython.declare(cython.int, 0)

# What became of an event on its arrival, as in nav.state.Arrival
TAKEN = cython.declare(cython.int, 0)
STALE = cython.declare(cython.int, 1)
DUPLICATE = cython.declare(cython.int, 2)
MALFORMED = cython.declare(cython.int, 3)
RESTARTED = cython.declare(cython.int, 4)
ESTIMATED = cython.declare(cython.int, 5)

EPOCH_STEP = cython.declare(cython.longlong, 1 << 52)
"""Epochs are whole multiples of 52 days: times since one are exact in a double."""
SNAPSHOT_EVERY = cython.declare(cython.Py_ssize_t, 16)
"""Inertial samples between two snapshots: at 250 Hz a late event re-runs 32 ms more at the most."""
LOST_AFTER = cython.declare(cython.Py_ssize_t, 250)
"""So many inertial samples in a row too old for the window mean that the clock itself went back."""
REBOOT_TIME = cython.declare(cython.double, 100.0)
"""So long a bias is taken to have walked over a reboot, s: ten times what one lasts."""
LARGEST_RATE = cython.declare(cython.double, 200.0)
"""rad/s; no gyro of a vehicle reaches it."""
LARGEST_FORCE = cython.declare(cython.double, 2000.0)
"""m/s^2."""


COMPILED_BLOCK = at.BLOCK
"""Size of the state block that this module was compiled for."""


@cython.cclass
class Timeline:
    """The estimator over time: put events in, as they come, and read the state of now."""

    rows: cython.double[:, ::1]
    snapshots: cython.double[:, ::1]
    snapshot_row: cython.Py_ssize_t[::1]
    x: cython.double[::1]
    y: cython.double[::1]
    k: cython.double[::1]
    w: cython.double[::1]
    out: cython.double[::1]
    told: cython.double[::1]
    said: cython.float[::1]
    given: cython.double[::1]
    delay: cython.longlong[::1]
    counters: cython.longlong[:, ::1]
    size: cython.Py_ssize_t
    capacity: cython.Py_ssize_t
    cursor: cython.Py_ssize_t
    snaps: cython.Py_ssize_t
    window: cython.double
    epoch: cython.longlong
    has_epoch: cython.bint
    is_restored: cython.bint
    is_set: cython.bint
    newest: cython.double
    oldest: cython.double
    stamp: cython.longlong
    lost: cython.Py_ssize_t
    reruns: cython.longlong
    start: cython.double[::1]
    stretch: cython.Py_ssize_t
    keeps: cython.bint
    gone: list[tuple[int, int, np.ndarray, np.ndarray]]

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
            parameters: The filter's numbers, shape (PARAMETERS,), as layout.K_* says.
            delay_ns: How late the stamps of each kind are, ns, shape (kinds,).
            window_ns: How far back a late event is still taken, ns.
            capacity: Rows to hold, at least 64; with fewer than come in twice the window, the
                window shrinks.
            keeps_history: Rows that leave the window are kept for :meth:`history`.
        """
        self.k = np.ascontiguousarray(parameters, dtype=np.float64).copy()
        self.delay = np.ascontiguousarray(delay_ns, dtype=np.int64).copy()
        self.window = float(window_ns)
        self.capacity = capacity
        self.rows = np.zeros((capacity, at.ROW))
        # between two snapshots there are always so many inertial rows
        self.snapshots = np.zeros((capacity // SNAPSHOT_EVERY + 2, at.BLOCK))
        self.snapshot_row = np.zeros(capacity // SNAPSHOT_EVERY + 2, dtype=np.intp)
        self.x = np.zeros(at.BLOCK)
        self.y = np.zeros(at.BLOCK)
        self.w = np.zeros(at.SCRATCH)
        self.out = np.zeros(at.OUT)
        self.told = np.zeros(at.TOLD)
        self.said = np.zeros(at.TOLD, dtype=np.float32)
        self.given = np.zeros(at.ROW - at.ROW_V)
        self.counters = np.zeros((len(self.delay), 6), dtype=np.int64)
        self.has_epoch = False
        self.is_restored = False
        self.is_set = False
        self.epoch = 0
        self.lost = 0
        self.reruns = 0
        self.start = np.zeros(at.BLOCK)
        self.stretch = 0
        self.keeps = keeps_history
        self.gone = []
        self.clear()

    @cython.cfunc
    def clear(self) -> cython.void:
        """Forget all events; the state that remains is the one to begin from."""
        self.size = 0
        self.cursor = 0
        self.snaps = 1
        self.snapshot_row[0] = -1
        self.snapshots[0, :] = self.x
        self.newest = -1.0
        self.oldest = -1.0
        self.stamp = 0

    def restart(self) -> None:
        """Begin anew on a clock that began anew.

        Beside the count of resets lives on what was learnt of what did not begin anew.
        """
        resets: cython.double = self.x[at.X_RESETS]
        i: cython.Py_ssize_t
        started: cython.bint = self.x[at.X_MODE] != at.MODE_INIT
        self.hand_over(self.cursor)
        self.y[:] = self.x
        for i in range(at.BLOCK):
            self.x[i] = 0.0
        if self.y[at.X_MODE] == at.MODE_NAVIGATE:
            keep(self.x, self.y, self.k)
        self.x[at.X_RESETS] = resets + 1.0 if started else resets
        self.x[at.X_RESET_REASON] = at.RESET_CLOCK
        self.has_epoch = False
        self.is_restored = False
        self.is_set = False
        self.lost = 0
        self.start[:] = self.x
        self.stretch += 1
        self.clear()

    @cython.cfunc
    def set_clock(self, t_ns: cython.longlong) -> cython.void:
        """Go on by a clock that was set: its first inertial sample follows the newest of the old.

        How long there was between the two nobody knows; it is taken for the usual interval. What
        was heard by the old clock stays as it is, and no event goes behind it.
        """
        self.is_set = False
        self.hand_over(self.cursor)
        self.epoch = (
            t_ns
            - self.delay[6]
            - cython.cast(cython.longlong, self.x[at.X_T] + 1e9 * self.x[at.X_DT])
        )
        self.start[:] = self.x
        self.stretch += 1
        self.begin_from(self.x[at.X_T], t_ns)

    def restore(
        self,
        block: cython.double[::1],
        waiting: cython.double[:, ::1],
        epoch_ns: cython.longlong,
        stamp_ns: cython.longlong,
    ) -> None:
        """Go on from a state that another timeline was in; that counts as a reset.

        The next inertial sample decides: within the gap that is bridged (layout.K_GAP) nothing was
        lost, and it runs on to the bit. Later, what was true meanwhile was not all heard, so none
        of it is used: the sample ends a gap, and the window begins with it.

        Args:
            block: The state, shape (BLOCK,).
            waiting: Rows that waited for a sample, in order of time, shape (n, ROW).
            epoch_ns: What the times in both count from, ns.
            stamp_ns: Stamp of the newest inertial sample, ns.
        """
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = min(waiting.shape[0], self.capacity // 2)
        self.x[:] = block
        self.x[at.X_RESETS] += 1.0
        self.x[at.X_RESET_REASON] = at.RESET_RESTART
        self.epoch = epoch_ns
        self.has_epoch = True
        self.is_restored = True
        self.is_set = False
        self.lost = 0
        self.begin_from(self.x[at.X_T], stamp_ns)
        for i in range(count):
            self.rows[i, :] = waiting[i, :]
        self.size = count

    @cython.cfunc
    def begin_from(self, t: cython.double, t_ns: cython.longlong) -> cython.void:
        """Forget all events up to the newest sample, which was at t: none may go behind it."""
        self.clear()
        self.newest = t
        self.oldest = t
        self.stamp = t_ns

    def insert(self, t_ns: cython.longlong, kind: cython.int, values: Sequence[float]) -> int:
        """Take one event on its arrival and run the filter as far as it now can.

        Args:
            t_ns: Its stamp.
            kind: nav.measurements.Kind.
            values: As many as a row of nav.measurements holds.

        Returns:
            What became of it: TAKEN, STALE, DUPLICATE, MALFORMED, RESTARTED, or ESTIMATED for an
            inertial sample that is the newest, so that there is an estimate for its stamp.
        """
        i: cython.Py_ssize_t
        for i in range(at.ROW - at.ROW_V):
            self.given[i] = values[i]
        return self.put(t_ns, kind, self.given)

    @cython.cfunc
    def put(
        self, t_ns: cython.longlong, kind: cython.int, values: cython.double[::1]
    ) -> cython.int:
        """Do the work of insert, and count the result by kind."""
        result: cython.int = MALFORMED
        if kind == RESTART:
            if values[0] != 0.0 and self.newest >= 0.0:
                self.is_set = True
            else:
                self.restart()
            result = RESTARTED
        elif kind < self.delay.shape[0] and is_sane(kind, values):
            result = self.place(t_ns, kind, values)
        if 0 <= kind < self.delay.shape[0]:
            self.counters[kind, result] += 1
        return result

    @cython.cfunc
    def place(
        self, t_ns: cython.longlong, kind: cython.int, values: cython.double[::1]
    ) -> cython.int:
        """Put a sane event in its place in time, and redo what came after it."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        order: cython.int
        t: cython.double
        is_bridge: cython.bint = False
        if not self.has_epoch:
            # the same whichever event comes first, and near enough for exact doubles
            self.epoch = t_ns // EPOCH_STEP * EPOCH_STEP
            self.has_epoch = True
        if self.is_set:
            # which time it is now, the next inertial sample says
            if kind != IMU:
                return STALE
            self.set_clock(t_ns)
        t = cython.cast(cython.double, t_ns - self.delay[kind] - self.epoch)

        # Too old to go back to?
        if self.size == self.capacity:
            self.trim()
        if self.newest >= 0.0 and (t < self.newest - self.window or t <= self.oldest):
            if kind == IMU:
                self.lost += 1
                if self.lost >= LOST_AFTER:
                    self.restart()
            return STALE

        # The first sample after a restart: what waits for it was true while nobody listened?
        if kind == IMU and self.is_restored:
            self.is_restored = False
            is_bridge = (t - self.x[at.X_T]) * 1e-9 > self.k[at.K_GAP]
            if is_bridge:
                self.size = 0

        # Find the place: after all that is earlier, in an order that arrival has no part in
        i = self.size
        while i > 0:
            order = compare(self.rows, i - 1, t, kind, values)
            if order == 0:
                return DUPLICATE
            if order < 0:
                break
            i -= 1
        for j in range(self.size, i, -1):
            self.rows[j, :] = self.rows[j - 1, :]
        self.rows[i, at.ROW_T] = t
        self.rows[i, at.ROW_KIND] = kind
        for j in range(at.ROW - at.ROW_V):
            self.rows[i, at.ROW_V + j] = values[j]
        self.size += 1

        # Late: back to the last snapshot before it
        if i < self.cursor:
            while self.snapshot_row[self.snaps - 1] >= i:
                self.snaps -= 1
            self.x[:] = self.snapshots[self.snaps - 1, :]
            self.cursor = self.snapshot_row[self.snaps - 1] + 1
            self.reruns += 1
            self.run()
            return TAKEN
        if kind != IMU:
            return TAKEN
        self.run()
        self.lost = 0
        self.newest = t
        self.stamp = t_ns
        if is_bridge:
            self.begin_from(t, t_ns)
        return ESTIMATED

    @cython.cfunc
    def run(self) -> cython.void:
        """Step through all rows up to the last inertial sample, leaving snapshots behind."""
        i: cython.Py_ssize_t
        first: cython.Py_ssize_t = self.cursor
        for i in range(self.cursor, self.size):
            if self.rows[i, at.ROW_KIND] != IMU:
                continue
            kernel.step(self.x, self.k, self.w, self.rows, first, i)
            first = i + 1
            self.cursor = first
            if not kernel.is_sound(self.x):
                self.recover(i)
            if self.x[at.X_SAMPLES] % SNAPSHOT_EVERY == 0.0:
                self.snapshots[self.snaps, :] = self.x
                self.snapshot_row[self.snaps] = i
                self.snaps += 1

    @cython.cfunc
    def recover(self, i: cython.Py_ssize_t) -> cython.void:
        """Put the last good state in the place of one that cannot be, at the sample of row i.

        Snapshots lie at samples of round number, so that whatever order the events came in it is
        the same one. What cannot be a second time so soon is not kept: the filter starts over.
        """
        kernel.recover(self.x, self.k, self.snapshots[self.snaps - 1], self.rows[i, at.ROW_T])

    @cython.cfunc
    def trim(self) -> cython.void:
        """Drop the rows that no event in the window can go behind, or else what hurts least."""
        i: cython.Py_ssize_t
        base: cython.Py_ssize_t = 0
        first: cython.Py_ssize_t = 0
        gone: cython.Py_ssize_t
        for i in range(1, self.snaps):
            if self.rows[self.snapshot_row[i], at.ROW_T] < self.newest - self.window:
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
                self.snapshots[1, :] = self.x
                self.snapshot_row[1] = self.cursor - 1
                self.snaps = 2
            gone = self.snapshot_row[base] + 1
            self.hand_over(gone)
            self.oldest = self.snapshots[base, at.X_T]
            for i in range(base, self.snaps):
                self.snapshots[i - base, :] = self.snapshots[i, :]
                self.snapshot_row[i - base] = self.snapshot_row[i] - gone
            self.snaps -= base
            self.snapshot_row[0] = -1
            self.cursor -= gone
        for i in range(first + gone, self.size):
            self.rows[i - gone, :] = self.rows[i, :]
        self.size -= gone

    def run_log(
        self,
        t_ns: cython.longlong[::1],
        kind: cython.longlong[::1],
        values: cython.double[:, ::1],
        stamps: cython.longlong[::1],
        out: cython.double[:, ::1],
    ) -> int:
        """Take a table of events in the order of arrival, and write an estimate per newest sample.

        Args:
            t_ns: Stamps, shape (n,).
            kind: Kinds, shape (n,).
            values: Values, shape (n, WIDTH).
            stamps: Receives the stamps of the estimates, shape at least (inertial samples,).
            out: Receives the estimates, shape as stamps, by OUT.

        Returns:
            The number of estimates written.
        """
        i: cython.Py_ssize_t
        n: cython.Py_ssize_t = 0
        for i in range(t_ns.shape[0]):
            if self.put(t_ns[i], cython.cast(cython.int, kind[i]), values[i]) == ESTIMATED:
                kernel.describe(self.x, self.k, self.y, self.w, out[n])
                stamps[n] = t_ns[i]
                n += 1
        return n

    @cython.cfunc
    def hand_over(self, count: cython.Py_ssize_t) -> cython.void:
        """Keep the first rows for the history: they were stepped through and stay as they are."""
        if self.keeps and count > 0:
            self.gone.append(
                (self.stretch, self.epoch, np.array(self.start), np.array(self.rows[:count]))
            )

    def history(self, is_over: bool = False) -> list[tuple[int, int, np.ndarray, np.ndarray]]:
        """Give the rows that have left the window since this was asked last, in order of time.

        Args:
            is_over: No event comes any more: with what is in the window, up to the newest sample.

        Returns:
            Parts, each ending with an inertial sample: the number of the stretch (a restart of the
            clock begins another), its epoch (ns), the state block that it began from, shape
            (BLOCK,), and the rows, shape (n, ROW).
        """
        if is_over:
            self.hand_over(self.cursor)
        parts = self.gone
        self.gone = []
        return parts

    def describe(self) -> np.ndarray:
        """Give the estimate at the newest sample's stamp, shape (OUT,), as layout.OUT_* says."""
        kernel.describe(self.x, self.k, self.y, self.w, self.out)
        return np.array(self.out)

    def tell(self) -> tuple[int, int, bytes]:
        """Give status, resets and, of the estimate of now, ODOMETRY's numbers: layout.TOLD floats.

        The numbers are of no use before there is a position.
        """
        i: cython.Py_ssize_t
        status: cython.int = kernel.describe(self.x, self.k, self.y, self.w, self.out)
        odometry.tell(self.x, self.out, self.w, self.told)
        for i in range(at.TOLD):
            self.said[i] = self.told[i]
        return status, int(self.x[at.X_RESETS]), bytes(self.said)

    def retune(self, parameters: np.ndarray) -> None:
        """Go on with other numbers of the filter's, shape (PARAMETERS,), as layout.K_* says.

        What a late event makes run again from now on is run by these too.
        """
        self.k = np.ascontiguousarray(parameters, dtype=np.float64).copy()

    def block(self) -> np.ndarray:
        """Give a copy of the state block, shape (BLOCK,)."""
        return np.array(self.x)

    def waiting(self) -> np.ndarray:
        """Give a copy of the rows that wait for the next inertial sample, shape (n, ROW)."""
        return np.array(self.rows[self.cursor : self.size])

    @property
    def epoch_ns(self) -> int:
        """What the times in the block count from, ns."""
        return self.epoch

    @property
    def resets(self) -> int:
        """How often the state has jumped on purpose."""
        return int(self.x[at.X_RESETS])

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest inertial sample, ns."""
        return self.stamp

    @property
    def rerun_count(self) -> int:
        """How often a late event made the filter go back."""
        return self.reruns

    @property
    def arrivals(self) -> np.ndarray:
        """How many events of each kind (rows) met each result (columns)."""
        return np.array(self.counters)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def keep(x: cython.double[::1], y: cython.double[::1], k: cython.double[::1]) -> cython.void:
    """Give an empty block x what a block y knows that outlives a reboot of the autopilot.

    The receiver does not reboot, nor does the vehicle's own field change: its delay, how white its
    errors are, and hard iron are as they were. The biases are where they are the sensors' own
    (layout.K_KEEPS_BIAS), give or take what they have walked meanwhile; but a gyro is calibrated by
    an autopilot that starts on the ground. Of an autopilot that takes its own estimate of the
    biases off, the accelerometer's is a guess, no surer than at any start.
    """
    i: cython.Py_ssize_t
    e: cython.Py_ssize_t = at.X_COV + at.E_DELAY * (at.N + 1)
    is_flown: cython.bint = y[at.X_ARMED] == 1.0 and y[at.X_LANDED] != 1.0
    x[at.X_DELAY] = within(y[at.X_DELAY], k[at.K_DELAY_STD])
    x[e] = y[e]
    for i in range(3):
        x[at.X_WHITE + i] = y[at.X_WHITE + i]
        x[at.X_NIS_SUM + i] = y[at.X_NIS_SUM + i]
        x[at.X_NIS_N + i] = y[at.X_NIS_N + i]
        x[at.X_IRON + i] = within(y[at.X_IRON + i], k[at.K_IRON_STD])
        e = at.X_COV + (at.E_IRON + i) * (at.N + 1)
        x[e] = y[e]
        x[at.X_BA + i] = within(y[at.X_BA + i], k[at.K_ACCEL_BIAS])
        if k[at.K_KEEPS_BIAS] == 0.0:
            continue
        e = at.X_COV + (at.E_BA + i) * (at.N + 1)
        x[e] = y[e] + k[at.K_ACCEL_WALK] * k[at.K_ACCEL_WALK] * REBOOT_TIME
        if is_flown:
            x[at.X_BG + i] = within(y[at.X_BG + i], k[at.K_GYRO_BIAS])
            e = at.X_COV + (at.E_BG + i) * (at.N + 1)
            x[e] = y[e] + k[at.K_GYRO_WALK] * k[at.K_GYRO_WALK] * REBOOT_TIME


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def within(value: cython.double, sigma: cython.double) -> cython.double:
    """Bring what was learnt to within two sigmas of what is expected where nothing is known."""
    largest: cython.double = 2.0 * sigma
    value = value if value < largest else largest
    return value if value > -largest else -largest


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def compare(
    rows: cython.double[:, ::1],
    i: cython.Py_ssize_t,
    t: cython.double,
    kind: cython.int,
    values: cython.double[::1],
) -> cython.int:
    """Give -1, 0, 1 as row i is before, the same as, or after the event: by time, kind, values."""
    j: cython.Py_ssize_t
    a: cython.double
    b: cython.double
    if rows[i, at.ROW_T] != t:
        return -1 if rows[i, at.ROW_T] < t else 1
    if rows[i, at.ROW_KIND] != kind:
        return -1 if rows[i, at.ROW_KIND] < kind else 1
    for j in range(at.ROW - at.ROW_V):
        a = rows[i, at.ROW_V + j]
        b = values[j]
        if isnan(a) or isnan(b):
            if isnan(a) and isnan(b):
                continue
            return -1 if isnan(a) else 1
        if a != b:
            return -1 if a < b else 1
    return 0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def is_sane(kind: cython.int, values: cython.double[::1]) -> cython.bint:
    """Refuse what no sensor can say: not finite where a number must be, or beyond all bounds."""
    j: cython.Py_ssize_t
    if kind == 6:
        for j in range(3):
            if not isfinite(values[j]) or fabs(values[j]) > LARGEST_RATE:
                return False
            if not isfinite(values[3 + j]) or fabs(values[3 + j]) > LARGEST_FORCE:
                return False
        return True
    if kind == 1:
        for j in range(3, 9):
            if not (isfinite(values[j]) or isnan(values[j])) or fabs(values[j]) > 1e5:
                return False
        if isnan(values[3]) != isnan(values[4]) or isnan(values[6]) or isnan(values[7]):
            return False
        if not (values[6] > 0.0 and values[7] > 0.0) or values[8] <= 0.0:
            return False
        if not (isnan(values[9]) or fabs(values[9]) <= 3.2) or not 0.0 <= values[10] < 256.0:
            return False
        if not (isnan(values[11]) or fabs(values[11]) <= 1.6):
            return False
        if not (isnan(values[12]) or 0.0 <= values[12] < 10.0):
            return False
        return fabs(values[0]) < 1.57 and fabs(values[1]) < 3.15 and fabs(values[2]) < 1e5
    if kind == 2:
        return fabs(values[0]) < 7.0 and 0.0 < values[1] < 10.0 and values[2] in (0.0, 1.0, 2.0)
    if kind == 3:
        return (
            fabs(values[0]) < 10.0
            and fabs(values[1]) < 10.0
            and fabs(values[2]) < 10.0
            and values[0] * values[0] + values[1] * values[1] + values[2] * values[2] > 1e-6
        )
    if kind == 4:
        return fabs(values[0]) < 1e5
    return kind == 5 and not isnan(values[0])
