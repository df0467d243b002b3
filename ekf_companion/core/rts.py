"""Fixed-interval (RTS) smoother over the tape of a forward run.

The filter runs forward over a stretch of rows with a tape, then goes back over it, record by
record: with ``G = P Phi' (P-)^-1``, from the state before an interval, its Phi, and the state
after it, both as the filter had them (P, P-),

``e = G (later - after)``; ``P_s = P + G (P_later - P-) G'``.

The states are compared on the manifold: an error is that between two nominal states
(``correct.difference``), and a covariance is of the error about the nominal state that it belongs
to; where that changes, it is re-based, as the filter does when it injects. The gain needs no
optimal update in between: the recursion holds for any that is linear, consider states included.

Source: Rauch, Tung, Striebel 1965, "Maximum likelihood estimates of linear dynamic systems";
Sarkka 2013, sections 8.2 and 9.1; re-basing: Sola 2017, section 6.3.
"""

from __future__ import annotations

import cython
import numpy as np
from cython import address
from cython.cimports.ekf_companion.core.filter import tape
from cython.cimports.ekf_companion.core.filter.slow_error import carried
from cython.cimports.ekf_companion.core.filter.update import difference, inject, rebase
from cython.cimports.ekf_companion.core.memory.bank import BANK
from cython.cimports.ekf_companion.core.memory.enums import (
    KIND_IMU,
    LINK_CUT,
    LINK_MOVED,
    LINK_SAME,
    MODE_ATTITUDE,
    WEIGH_ACT,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import (
    Numbers,
    Square,
    as_banks,
    as_estimate,
    as_events,
    as_parameters,
    as_records,
    as_state,
    as_states,
    copy_state,
)
from cython.cimports.ekf_companion.core.memory.scratch import (
    OUT,
    RECORD,
    Hindsight,
    Observation,
    Scratch,
    TapeRecord,
)
from cython.cimports.ekf_companion.core.memory.state import BLOCK, State
from cython.cimports.ekf_companion.core.order import step
from cython.cimports.ekf_companion.core.output.estimate import write_estimate
from cython.cimports.libc.math import sqrt

from ekf_companion.core.memory.packing import pack, unpack
from ekf_companion.nav.arrays import Table

KNOWN = cython.declare(cython.double, 1e-12)
"""A state of whose variance the others leave no more than this share is known by them."""


class Smoother:
    """Runs the filter over rows, forward and back."""

    def __init__(self, parameters: np.ndarray) -> None:
        """Begin without a tape: one is made as long as the longest stretch needs.

        Args:
            parameters: :class:`~.parameters.Parameters` as numbers, shape (PARAMETERS,).
        """
        if not cython.compiled:
            self.w, self.h = Scratch(), Hindsight()
        self.numbers: Numbers = np.ascontiguousarray(parameters, dtype=np.float64).copy()
        self.blocks = np.zeros((3, BLOCK))
        self.tape = np.zeros((0, RECORD))
        self.k = as_parameters(self.numbers)
        self.x = as_state(self.blocks[0])
        self.y = as_state(self.blocks[1])
        self.z = as_state(self.blocks[2])
        has_bank = cython.declare(cython.bint, self.k.weighs_faults == WEIGH_ACT)
        self.bank_table = np.zeros((1, BANK if has_bank else 1))
        self.w.observation.has_bank = has_bank
        self.w.observation.bank = as_banks(self.bank_table)

    def bank(self) -> np.ndarray:
        """Return a copy of the fault hypotheses after what was run last; empty: there are none."""
        if not self.w.observation.has_bank:
            return np.zeros(0)
        return pack(np.asarray(self.bank_table[0]))

    def set_bank(self, bank: Numbers) -> None:
        """Run on from other fault hypotheses, as :meth:`bank` returned them."""
        if self.w.observation.has_bank:
            np.asarray(self.bank_table)[0] = unpack(np.asarray(bank))

    def advance(self, block: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Run the filter over rows in order of time, without a tape.

        The fault hypotheses, where they decide, run on from those of before.

        Args:
            block: The state before them, shape (BLOCK,).
            rows: Sorted as the timeline sorts them, shape (n, ROW); the last is an inertial sample.

        Returns:
            The state after them, shape (BLOCK,).
        """
        copy_state(self.x, as_state(block))
        self.w.tape.is_on = 0
        self._forward(rows)
        return np.array(self.blocks[0])

    def smooth(self, block: np.ndarray, rows: np.ndarray, later: np.ndarray | None) -> np.ndarray:
        """Run the filter over rows and go back over them.

        Args:
            block: The filter's state before them, shape (BLOCK,).
            rows: As for :meth:`advance`; a tape for so many is kept, RECORD numbers a row.
            later: The smoothed state after them, shape (BLOCK,); None: nothing comes later.

        Returns:
            The smoothed states, shape (inertial samples + 1, BLOCK): first that of the start, which
            is ``later`` for the rows before these, then that of each sample. They are the filter's
            states with nominal state and covariance replaced.
        """
        samples = np.count_nonzero(np.asarray(rows)[:, 1] == KIND_IMU)
        blocks = np.empty((samples + 1, BLOCK))
        # a row may move the state and change it, a sample may also let it grow doubtful
        size = 3 * len(rows) + 1
        if len(self.tape) < size:
            self.tape = np.zeros((0, RECORD))  # not two tapes at a time
            self.tape = np.zeros((size, RECORD))
        self.w.tape.record = as_records(self.tape)
        self.w.tape.is_on = 1
        self.w.tape.length = 0
        copy_state(self.x, as_state(block))
        tape.record_sample(self.x, address(self.w))
        self._forward(rows)
        copy_state(self.y, self.x)
        if later is not None:
            copy_state(self.y, as_state(later))
        self._back(blocks)
        return blocks

    def describe(self, blocks: np.ndarray) -> np.ndarray:
        """Return the estimates of states, shape (n, OUT): :class:`~.scratch.Estimate`.

        Fault hypotheses are mixed in nowhere: what was beyond doubt later is known before too.
        """
        self.w.observation.has_bank = False
        out = np.empty((len(blocks), OUT))
        for i in range(len(blocks)):
            write_estimate(
                as_state(blocks[i]), self.k, self.z, address(self.w), as_estimate(out[i])
            )
        self.w.observation.has_bank = self.k.weighs_faults == WEIGH_ACT
        return out

    def _forward(self, table: Table[np.float64]) -> None:
        """Step through the rows; the tape, if it is on, gets a record at the end of each sample."""
        rows = as_events(table)
        first = 0
        for i in range(table.shape[0]):
            if rows[i].kind == KIND_IMU:
                step.step(self.x, self.k, address(self.w), rows, first, i)
                first = i + 1
                if self.w.tape.is_on:
                    tape.record_sample(self.x, address(self.w))

    def _back(self, table: Table[np.float64]) -> None:
        """Go back over the tape from the smoothed state y."""
        blocks = as_states(table)
        o = address(self.w.observation)
        records = self.w.tape.record
        sample = table.shape[0] - 1
        for i in range(self.w.tape.length - 1, -1, -1):
            if records[i].is_sample != 0.0:
                keep_accounts(address(records[i].state), self.y, o, address(self.h))
                copy_state(address(blocks[sample]), self.y)
                sample -= 1
            if i == 0:
                return
            if records[i].link == LINK_CUT:
                copy_state(self.y, address(records[i - 1].state))
            elif records[i].link != LINK_SAME:
                undo(address(records[i - 1]), address(records[i]), self.y, o, address(self.h))


def keep_accounts(x: State, y: State, o: Observation, h: Hindsight) -> None:
    """Copy to the smoothed y all of x, the filter's state then, but what is estimated."""
    if x.mode < MODE_ATTITUDE:
        copy_state(y, x)
        return
    difference(x, y, o)
    rebase(y, o)
    copy_covariance(y.P, h.half)
    copy_state(y, x)
    copy_covariance(h.half, y.P)
    inject(y, o)


def copy_covariance(source: Square, to: Square) -> None:
    """Copy a matrix of shape (N, N)."""
    for i in range(N):
        for j in range(N):
            to[i][j] = source[i][j]


def undo(before: TapeRecord, after: TapeRecord, y: State, o: Observation, h: Hindsight) -> None:
    """Bring y from after what a record tells of to before it."""
    x = address(before.state)
    n = carried(x)
    n = carried(address(after.state)) if carried(address(after.state)) > n else n
    n = carried(y) if carried(y) > n else n
    # The covariance that the filter had there, and its product with the state before: Phi P
    if after.link == LINK_MOVED:
        multiply_transition(x, after, h, n)
        difference(address(after.state), y, o)
    else:
        multiply_redrawn(x, address(after.state), h, n)
        difference(x, y, o)

    # What is known later, as an error of what the filter had there, and its covariance less P-
    rebase(y, o)
    for i in range(n):
        for j in range(n):
            h.change[i][j] = y.P[i][j] - h.prior[i][j]

    # G' = (P-)^-1 Phi P; then the error before, and its covariance
    factor(h.prior, n)
    solve(h.prior, h.gain, n)
    apply_gain(x, y, o, h, n)


def multiply_transition(x: State, after: TapeRecord, h: Hindsight, n: int) -> None:
    """Write the covariance after an interval, and Phi times that before it."""
    for i in range(n):
        for j in range(n):
            h.prior[i][j] = after.state.P[i][j]
            h.gain[i][j] = 0.0
        for m in range(n):
            s = after.Phi[i][m]
            if s != 0.0:
                for j in range(n):
                    h.gain[i][j] += s * x.P[m][j]


def multiply_redrawn(x: State, after: State, h: Hindsight, n: int) -> None:
    """Do the same where some states were drawn anew: what follows says nothing of those.

    Their rows of Phi are zero and, since they tell nothing, their variance may be any. Of what was
    measured in the same event before the drawing, the states that stayed keep all, those drawn
    anew what the others know of it.
    """
    for i in range(n):
        for j in range(n):
            h.gain[i][j] = x.P[i][j]
            h.prior[i][j] = x.P[i][j]
    for i in range(n):
        if after.redrawn[i] != x.redrawn[i]:
            for j in range(n):
                h.gain[i][j] = 0.0
                h.prior[i][j] = 0.0
                h.prior[j][i] = 0.0
            h.prior[i][i] = 1.0


def factor(a: Square, n: int) -> None:
    """Replace the upper triangle of a covariance by U with U' U = it.

    A state that is known, or known by those before it, gets a row of zeros: it is left out.
    """
    # the lower triangle is free: its first column, and the corner, remember the variances
    for i in range(1, n):
        a[i][0] = a[i][i]
    least = KNOWN * a[0][0]
    for i in range(n):
        if i > 0:
            least = KNOWN * a[i][0]
        s = 1.0 / sqrt(a[i][i]) if a[i][i] > least else 0.0
        for j in range(i, n):
            a[i][j] *= s
        for m in range(i + 1, n):
            s = a[i][m]
            for j in range(m, n):
                a[m][j] -= s * a[i][j]


def solve(root: Square, g: Square, n: int) -> None:
    """Solve U' U X = g in place; what :func:`factor` left out stays zero."""
    for i in range(n):
        s = 1.0 / root[i][i] if root[i][i] > 0.0 else 0.0
        for j in range(n):
            g[i][j] *= s
        for m in range(i + 1, n):
            s = root[i][m]
            for j in range(n):
                g[m][j] -= s * g[i][j]
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, n):
            s = root[i][m]
            for j in range(n):
                g[i][j] -= s * g[m][j]
        s = 1.0 / root[i][i] if root[i][i] > 0.0 else 0.0
        for j in range(n):
            g[i][j] *= s


def apply_gain(x: State, y: State, o: Observation, h: Hindsight, n: int) -> None:
    """Make y the state before, x, moved by G dx; its P is P + G change G'. Reads G'."""
    copy_state(y, x)
    for i in range(N):
        o.gain[i] = o.dx[i]
        o.dx[i] = 0.0
    for m in range(n):
        s = o.gain[m]
        for i in range(n):
            o.dx[i] += h.gain[m][i] * s
    for i in range(n):
        for j in range(n):
            h.half[i][j] = 0.0
        for m in range(n):
            s = h.change[i][m]
            for j in range(n):
                h.half[i][j] += s * h.gain[m][j]
    for m in range(n):
        for i in range(n):
            s = h.gain[m][i]
            for j in range(i, n):
                y.P[i][j] += s * h.half[m][j]
    for i in range(n):
        if y.P[i][i] < 0.0:
            y.P[i][i] = 0.0
        for j in range(i):
            y.P[i][j] = y.P[j][i]
    inject(y, o)
