"""One inertial unit of several: its mean readings over blocks of time, its noise, how it fails.

Compiled.
"""

from __future__ import annotations

import math

import cython

from ekf_companion.nav.repetition import MEASURED, Repetition

BLOCK_NS = 40_000_000
"""ns. Two whole blocks and a part of one are over within 0.12 s, and a unit of 50 Hz has two
samples in each."""
BLOCK = 0.04
"""The same, s."""
KEPT = 8
"""Blocks that are kept."""
MEMORY = 750
"""Blocks over which what is usual is learnt: 30 s, in which a bias hardly drifts."""
STEADY = 20
"""Samples without a gap before a unit is one to go to."""
_GAP_NS = 250_000_000
"""ns: longer without a sample, a block is not whole."""
_SILENT_NS = 100_000_000
"""Silence, beside four intervals, after which a unit is left: 0.2 s at 40 Hz."""
_WHITE = 0.1
"""Time in which the white noise is learnt as it rises, s; it falls five times as slowly."""
LASTING_NS = 10_000_000_000
"""A unit that failed is not gone to for so long; a difference that lasted for it is the usual one
from then on."""
_BRIEF_NS = 1_000_000_000
"""The same of one whose difference is over."""
SUSPECT = math.log(1e-3)
"""Logarithm of the probability below which a run of equal readings speaks against a unit: it is
neither compared nor gone to until a new one comes."""
NEVER = -(2**62)
STEP = "off from the others by a step"
"""Why a unit is left that contradicts the others."""

Waiting = tuple[int, float, float, float, float, float, float]
"""Stamp (ns) and numbers of a sample that was not used yet."""


class Unit:
    """One inertial unit: its blocks, its white noise, and how it fails."""

    def __init__(self, number: int) -> None:
        if not cython.compiled:
            self._last, self._before, self._now = [0.0] * 6, [0.0] * 6, [0.0] * 6
            self._sum, self.white, self.usual = [0.0] * 6, [0.0] * 6, [0.0] * 6
            self.mean, self.whole = [[0.0] * 6 for _ in range(8)], [0] * 8
        self.number = number
        self.failed_ns: int = NEVER
        self.why = ""
        """Why it failed last."""
        self.faults = 0
        """How often it has failed."""
        self.fault_ns: int = NEVER
        """When it did first."""
        self.waiting: list[Waiting] = []
        self.begin()

    def begin(self) -> None:
        """Forget all samples."""
        self.repetition = Repetition()
        self.t_ns: int = NEVER
        self.dt = 0.0
        self.run = 0
        self.chance = 0.0
        """Logarithm of how likely it is that each axis still measures."""
        self.blocks = 0
        self.done: int = NEVER
        self._block: int = NEVER
        self._covered: int = 0
        self.waiting.clear()
        for n in range(8):
            self.whole[n] = NEVER
        for axis in range(6):
            self.white[axis] = self.usual[axis] = self._sum[axis] = 0.0

    def take(
        self, t_ns: int, gx: float, gy: float, gz: float, ax: float, ay: float, az: float
    ) -> str | None:
        """Take a sample, later than all before; return why it was not measured, if so."""
        why = self.repetition.judge_axes(t_ns // 1000, gx, gy, gz, ax, ay, az)
        self.chance = self.repetition.chance()
        if why is not None and why not in MEASURED:
            return why
        self._now[0], self._now[1], self._now[2] = gx, gy, gz
        self._now[3], self._now[4], self._now[5] = ax, ay, az
        step = t_ns - self.t_ns
        if self.t_ns == NEVER or step > _GAP_NS:
            self.run = 0
            self._block = t_ns // BLOCK_NS
            self._begin_block()
        else:
            self._integrate(t_ns)
            dt = 1e-9 * step
            self.dt += (dt - self.dt) / min(self.run + 1, 64)
            if self.run > 1:
                self._learn_white(dt)
            self.run += 1
        for axis in range(6):
            self._before[axis] = self._last[axis]
            self._last[axis] = self._now[axis]
        self.t_ns = t_ns
        return why

    def _learn_white(self, dt: float) -> None:
        """Learn the white noise by the second difference, whose variance is six times as large."""
        rising = dt / (dt + _WHITE)
        for axis in range(6):
            second = self._now[axis] - 2.0 * self._last[axis] + self._before[axis]
            new = second * second / 6.0 - self.white[axis]
            self.white[axis] += (rising if new > 0.0 else 0.2 * rising) * new

    def _begin_block(self) -> None:
        self._covered = 0
        for axis in range(6):
            self._sum[axis] = 0.0

    def _integrate(self, t_ns: int) -> None:
        """Add the straight line from the sample before to this one to the blocks that it crosses.

        What two units measure at other times is thus compared over the same.
        """
        begin = self.t_ns
        whole = t_ns - self.t_ns
        while begin < t_ns:
            end = (self._block + 1) * BLOCK_NS
            end = t_ns if end > t_ns else end
            share = (0.5 * ((begin - self.t_ns) + (end - self.t_ns))) / whole
            length = 1e-9 * (end - begin)
            for axis in range(6):
                value = self._last[axis] + share * (self._now[axis] - self._last[axis])
                self._sum[axis] += length * value
            self._covered += end - begin
            begin = end
            if end == (self._block + 1) * BLOCK_NS:
                self._finish_block()

    def _finish_block(self) -> None:
        if self._covered == BLOCK_NS:
            place = self._block % 8
            self.whole[place] = self._block
            self.done = self._block
            self.blocks += 1
            share = 1.0 / min(self.blocks, MEMORY)
            for axis in range(6):
                self.mean[place][axis] = self._sum[axis] / BLOCK
                self.usual[axis] += share * (self.mean[place][axis] - self.usual[axis])
        self._block += 1
        self._begin_block()

    def has(self, first: int, last: int) -> bool:
        """Return whether these blocks are whole."""
        count = 0
        for block in range(first, last + 1):
            count += self.whole[block % 8] == block
        return count == last - first + 1

    def over(self, axis: int, first: int, last: int) -> float:
        """Return the mean of an axis over some blocks."""
        total = 0.0
        for block in range(first, last + 1):
            total += self.mean[block % 8][axis]
        return total / (last - first + 1)

    def change(self, axis: int, block: int, n: int) -> float:
        """Return the mean of the last n blocks less that of the n before."""
        first = block - n + 1
        return self.over(axis, first, block) - self.over(axis, first - n, first - 1)

    def is_steady(self) -> bool:
        """Return whether it has measured without a gap for a while."""
        return self.run >= STEADY

    def is_silent(self, now_ns: int) -> bool:
        """Return whether it has no sample for longer than is usual."""
        return now_ns - self.t_ns > _SILENT_NS + 4e9 * self.dt

    def has_failed(self, now_ns: int) -> bool:
        """Return whether it has failed lately."""
        return now_ns - self.failed_ns < (_BRIEF_NS if self.why == STEP else LASTING_NS)
