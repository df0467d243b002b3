"""Faults of the link: frames in at their times, frames out at theirs."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np

from sim_autopilot.faults.fault import Fault, Layer

_DIRECTIONS = ("out", "in")


class Wire:
    """One direction of a link."""

    def __init__(
        self,
        faults: Sequence[Fault],
        seed: int,
        zero_ns: int,
        way: str = "out",
        latency: float = 0.0,
    ) -> None:
        """Begin a flight at ``zero_ns`` on the clock of ``push``; every frame takes ``latency`` s.

        Of the flight's faults those of the wire in this direction act: ``out``, from the autopilot
        to the companion, or ``in``. Each draws from a generator of its own.
        """
        self._zero_ns = zero_ns
        self._latency_ns = round(latency * 1e9)
        self._faults = [
            (fault, np.random.default_rng(_sequence(seed, place, way)))
            for place, fault in enumerate(faults)
            if fault.kind.layer is Layer.WIRE and fault.values["way"] in ("both", way)
        ]
        self._heap: list[tuple[int, int, bytes]] = []
        self._count = 0
        self._latest_ns = 0
        """Arrival of the last frame that was not held back."""

    def push(self, now_ns: int, frame: bytes) -> None:
        """Send a frame at a time."""
        t = (now_ns - self._zero_ns) * 1e-9
        copies, delay, is_held = [frame], 0.0, False
        for fault, rng in self._faults:
            if not fault.start <= t < fault.end:
                continue
            name = fault.kind.name
            if name == "cut":
                return
            if name == "jitter":
                delay += fault.number("delay") * float(rng.random())
                continue
            if rng.random() >= fault.number("share"):
                continue
            if name == "loss":
                return
            if name == "duplicate":
                copies = copies * 2
            elif name == "reorder":
                delay += fault.number("delay")
                is_held = True
            elif name == "corrupt":
                copies = [_flipped(one, int(fault.number("bits")), rng) for one in copies]
        at_ns = now_ns + self._latency_ns + round(delay * 1e9)
        if not is_held:
            at_ns = self._latest_ns = max(at_ns, self._latest_ns)
        for one in copies:
            heapq.heappush(self._heap, (at_ns, self._count, one))
            self._count += 1

    def pop(self, now_ns: int) -> tuple[int, bytes] | None:
        """Return the next frame that has arrived by a time, and its arrival; None: no frame has."""
        if not self._heap or self._heap[0][0] > now_ns:
            return None
        at_ns, _, frame = heapq.heappop(self._heap)
        return at_ns, frame


def _flipped(frame: bytes, bits: int, rng: np.random.Generator) -> bytes:
    damaged = bytearray(frame)
    for place in rng.choice(8 * len(frame), size=min(bits, 8 * len(frame)), replace=False).tolist():
        damaged[place // 8] ^= 1 << place % 8
    return bytes(damaged)


def _sequence(seed: int, place: int, way: str) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(300, place, _DIRECTIONS.index(way)))
