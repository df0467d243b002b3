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
    from cython.cimports.ekf_companion.core import correct, hindsight, kernel, tape
    from cython.cimports.ekf_companion.core import state as at
else:
    from ekf_companion.core import correct, hindsight, kernel, tape
    from ekf_companion.core import state as at

IMU = cython.declare(cython.double, 6.0)


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
            self.w = np.zeros(at.SCRATCH)  # not two tapes at a time
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
                hindsight.carry(w[first + at.T_BLOCK : first + at.T_PHI], y, w)
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
            hindsight.move(before, after, w, first + at.T_PHI, self.prior, self.gain)
        else:
            hindsight.renew(before, after, self.prior, self.gain)
            after = before

        # What is known later, as an error of what the filter had there, and its covariance less P-
        correct.difference(after, y, w)
        correct.rebase(y, w)
        hindsight.subtract(y, self.prior, self.change)

        # G' = (P-)^-1 Phi P; then the error before, and its covariance
        hindsight.factor(self.prior)
        hindsight.solve(self.prior, self.gain)
        hindsight.absorb(before, y, w, self.gain, self.change, self.half)
