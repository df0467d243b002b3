# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Hindsight: what the samples that came later say of the state then.

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

if cython.compiled:
    from cython.cimports.ekf_companion.core import correct, kernel, tape
    from cython.cimports.ekf_companion.core import layout as at
    from cython.cimports.libc.math import sqrt
else:
    from math import sqrt

    from ekf_companion.core import correct, kernel, tape
    from ekf_companion.core import layout as at

IMU = cython.declare(cython.double, 6.0)
KNOWN = cython.declare(cython.double, 1e-12)
"""A state of whose variance the others leave no more than this share is known by them."""


@cython.cclass
class Smoother:
    """Runs the filter over rows, forward and back."""

    k: cython.double[::1]
    w: cython.double[::1]
    x: cython.double[::1]
    y: cython.double[::1]
    z: cython.double[::1]
    prior: cython.double[:, ::1]
    gain: cython.double[:, ::1]
    change: cython.double[:, ::1]
    half: cython.double[:, ::1]

    def __init__(self, parameters: np.ndarray) -> None:
        """Begin without a tape: one is made as long as the longest stretch needs.

        Args:
            parameters: The filter's numbers, shape (PARAMETERS,), as layout.K_* says.
        """
        self.k = np.ascontiguousarray(parameters, dtype=np.float64).copy()
        self.w = np.zeros(at.SCRATCH)
        self.x = np.zeros(at.BLOCK)
        self.y = np.zeros(at.BLOCK)
        self.z = np.zeros(at.BLOCK)
        self.prior = np.zeros((at.N, at.N))
        self.gain = np.zeros((at.N, at.N))
        self.change = np.zeros((at.N, at.N))
        self.half = np.zeros((at.N, at.N))

    def advance(self, block: cython.double[::1], rows: cython.double[:, ::1]) -> np.ndarray:
        """Run the filter over rows in order of time, without a tape.

        Args:
            block: The state before them, shape (BLOCK,).
            rows: Sorted as the timeline sorts them, shape (n, ROW); the last is an inertial sample.

        Returns:
            The state after them, shape (BLOCK,).
        """
        self.x[:] = block
        self.forward(self.w[: at.SCRATCH], rows)
        return np.array(self.x)

    def smooth(
        self,
        block: cython.double[::1],
        rows: cython.double[:, ::1],
        later: cython.double[::1] | None,
    ) -> np.ndarray:
        """Run the filter over rows and go back over them.

        Args:
            block: The filter's state before them, shape (BLOCK,).
            rows: As for :meth:`advance`; a tape for so many is kept, about 20 kB a row.
            later: The smoothed state after them, shape (BLOCK,); None: nothing comes later.

        Returns:
            The smoothed states, shape (inertial samples + 1, BLOCK): first that of the start, which
            is ``later`` for the rows before these, then that of each sample. They are the filter's
            blocks with nominal state and covariance replaced.
        """
        samples = np.count_nonzero(np.asarray(rows)[:, at.ROW_KIND] == IMU)
        blocks = np.empty((samples + 1, at.BLOCK))
        # a row may move the state and change it, a sample may also let it grow doubtful
        size = at.TAPE + (3 * rows.shape[0] + 1) * at.RECORD
        if self.w.shape[0] < size:
            self.w = np.zeros(size)
        self.x[:] = block
        self.w[at.TAPE_COUNT] = 0.0
        tape.noted(self.x, self.w, True)
        self.forward(self.w, rows)
        self.y[:] = self.x
        if later is not None:
            self.y[:] = later
        self.back(blocks)
        return blocks

    def describe(self, blocks: cython.double[:, ::1]) -> np.ndarray:
        """Give the estimates that states stand for, shape (n, OUT), as layout.OUT_* says."""
        i: cython.Py_ssize_t
        out = np.empty((blocks.shape[0], at.OUT))
        rows: cython.double[:, ::1] = out
        for i in range(blocks.shape[0]):
            kernel.describe(blocks[i], self.k, self.z, self.w, rows[i])
        return out

    @cython.cfunc
    def forward(self, w: cython.double[::1], rows: cython.double[:, ::1]) -> cython.void:
        """Step through the rows; a tape, if w has one, gets a record at the end of each sample."""
        i: cython.Py_ssize_t
        first: cython.Py_ssize_t = 0
        for i in range(rows.shape[0]):
            if rows[i, at.ROW_KIND] == IMU:
                kernel.step(self.x, self.k, w, rows, first, i)
                first = i + 1
                if w.shape[0] > at.SCRATCH:
                    tape.noted(self.x, w, True)

    @cython.cfunc
    def back(self, blocks: cython.double[:, ::1]) -> cython.void:
        """Go back over the tape from the smoothed state y."""
        w: cython.double[::1] = self.w
        y: cython.double[::1] = self.y
        i: cython.Py_ssize_t
        first: cython.Py_ssize_t
        sample: cython.Py_ssize_t = blocks.shape[0] - 1
        for i in range(cython.cast(cython.Py_ssize_t, w[at.TAPE_COUNT]) - 1, -1, -1):
            first = at.TAPE + i * at.RECORD
            if w[first + at.T_IS_SAMPLE] != 0.0:
                carry(w[first + at.T_BLOCK : first + at.T_BLOCK + at.BLOCK], y, w)
                blocks[sample, :] = y
                sample -= 1
            if i == 0:
                return
            if w[first + at.T_LINK] == at.LINK_CUT:
                y[:] = w[first - at.RECORD + at.T_BLOCK : first - at.RECORD + at.T_PHI]
            elif w[first + at.T_LINK] != at.LINK_SAME:
                self.undo(first)

    @cython.cfunc
    def undo(self, first: cython.Py_ssize_t) -> cython.void:
        """Bring y from after what the record at w[first] tells of to before it."""
        w: cython.double[::1] = self.w
        y: cython.double[::1] = self.y
        before: cython.double[::1] = w[
            first - at.RECORD + at.T_BLOCK : first - at.RECORD + at.T_PHI
        ]
        after: cython.double[::1] = w[first + at.T_BLOCK : first + at.T_PHI]

        # The covariance that the filter had there, and its product with the state before: Phi P
        if w[first + at.T_LINK] == at.LINK_MOVED:
            move(before, after, w, first + at.T_PHI, self.prior, self.gain)
        else:
            renew(before, after, self.prior, self.gain)
            after = before

        # What is known later, as an error of what the filter had there, and its covariance less P-
        correct.difference(after, y, w)
        correct.rebase(y, w)
        subtract(y, self.prior, self.change)

        # G' = (P-)^-1 Phi P; then the error before, and its covariance
        factor(self.prior)
        solve(self.prior, self.gain)
        absorb(before, y, w, self.gain, self.change, self.half)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def carry(x: cython.double[::1], y: cython.double[::1], w: cython.double[::1]) -> cython.void:
    """Put the smoothed state y into another block of the same time: accounts of x, state of y."""
    correct.difference(x, y, w)
    correct.rebase(y, w)
    y[: at.X_COV] = x[: at.X_COV]
    correct.inject(y, w)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def move(
    before: cython.double[::1],
    after: cython.double[::1],
    w: cython.double[::1],
    Phi: cython.Py_ssize_t,
    prior: cython.double[:, ::1],
    gain: cython.double[:, ::1],
) -> cython.void:
    """Write the covariance after an interval, and Phi (at w[Phi]) times that before it."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    for i in range(at.N):
        for j in range(at.N):
            prior[i, j] = after[at.X_COV + i * at.N + j]
            gain[i, j] = 0.0
        for m in range(at.N):
            s = w[Phi + i * at.N + m]
            if s != 0.0:
                for j in range(at.N):
                    gain[i, j] += s * before[at.X_COV + m * at.N + j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def renew(
    before: cython.double[::1],
    after: cython.double[::1],
    prior: cython.double[:, ::1],
    gain: cython.double[:, ::1],
) -> cython.void:
    """Do the same where some states were drawn anew: what follows says nothing of those.

    Their rows of Phi are zero and, since they tell nothing, their variance may be any. Of what was
    measured in the same event before the drawing, the states that stayed keep all, those drawn
    anew what the others know of it.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(at.N):
        for j in range(at.N):
            gain[i, j] = before[at.X_COV + i * at.N + j]
            prior[i, j] = gain[i, j]
    for i in range(at.N):
        if after[at.X_FRESH + i] != before[at.X_FRESH + i]:
            for j in range(at.N):
                gain[i, j] = 0.0
                prior[i, j] = 0.0
                prior[j, i] = 0.0
            prior[i, i] = 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def subtract(
    y: cython.double[::1], prior: cython.double[:, ::1], change: cython.double[:, ::1]
) -> cython.void:
    """Write P of y less the prior."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(at.N):
        for j in range(at.N):
            change[i, j] = y[at.X_COV + i * at.N + j] - prior[i, j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def factor(a: cython.double[:, ::1]) -> cython.void:
    """Replace the upper triangle of a covariance by U with U' U = it.

    A state that is known, or known by those before it, gets a row of zeros: it is left out.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    # the lower triangle is free: its first column, and the corner, remember the variances
    for i in range(1, at.N):
        a[i, 0] = a[i, i]
    least: cython.double = KNOWN * a[0, 0]
    for i in range(at.N):
        if i > 0:
            least = KNOWN * a[i, 0]
        s = 1.0 / sqrt(a[i, i]) if a[i, i] > least else 0.0
        for j in range(i, at.N):
            a[i, j] *= s
        for m in range(i + 1, at.N):
            s = a[i, m]
            for j in range(m, at.N):
                a[m, j] -= s * a[i, j]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def solve(root: cython.double[:, ::1], g: cython.double[:, ::1]) -> cython.void:
    """Solve U' U X = g in place; what :func:`factor` left out stays zero."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    for i in range(at.N):
        s = 1.0 / root[i, i] if root[i, i] > 0.0 else 0.0
        for j in range(at.N):
            g[i, j] *= s
        for m in range(i + 1, at.N):
            s = root[i, m]
            for j in range(at.N):
                g[m, j] -= s * g[i, j]
    for i in range(at.N - 1, -1, -1):
        for m in range(i + 1, at.N):
            s = root[i, m]
            for j in range(at.N):
                g[i, j] -= s * g[m, j]
        s = 1.0 / root[i, i] if root[i, i] > 0.0 else 0.0
        for j in range(at.N):
            g[i, j] *= s


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def absorb(
    before: cython.double[::1],
    y: cython.double[::1],
    w: cython.double[::1],
    gain: cython.double[:, ::1],
    change: cython.double[:, ::1],
    half: cython.double[:, ::1],
) -> cython.void:
    """Make y the state before, moved by G times w[W_DX]; its P is P + G change G'. Reads G'."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t
    s: cython.double
    y[:] = before
    for i in range(at.N):
        w[at.W_ROW + i] = w[at.W_DX + i]
        w[at.W_DX + i] = 0.0
    for m in range(at.N):
        s = w[at.W_ROW + m]
        for i in range(at.N):
            w[at.W_DX + i] += gain[m, i] * s
    for i in range(at.N):
        for j in range(at.N):
            half[i, j] = 0.0
        for m in range(at.N):
            s = change[i, m]
            for j in range(at.N):
                half[i, j] += s * gain[m, j]
    for m in range(at.N):
        for i in range(at.N):
            s = gain[m, i]
            for j in range(i, at.N):
                y[at.X_COV + i * at.N + j] += s * half[m, j]
    for i in range(at.N):
        if y[at.X_COV + i * (at.N + 1)] < 0.0:
            y[at.X_COV + i * (at.N + 1)] = 0.0
        for j in range(i):
            y[at.X_COV + i * at.N + j] = y[at.X_COV + j * at.N + i]
    correct.inject(y, w)
