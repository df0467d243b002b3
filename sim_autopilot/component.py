"""Another computer on the link, which knows the truth and says something of it with faults."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ekf_companion.mavlink.codec import Sender
from sim_autopilot.flight import Motion

_HEARTBEAT_NS = 1_000_000_000
_ONBOARD, _NO_AUTOPILOT, _ACTIVE = 18, 8, 4
_LONGEST_NS = 2_000_000_000
"""Longest delay."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentFaults:
    """What is wrong with any; each as by default is nothing."""

    delay: float = 0.0
    """What it says was true so long before its stamp, s."""
    jitter: float = 0.0
    """One sigma of its stamps, s."""
    burst: int = 1
    """So many messages come together, with their own stamps."""
    frozen: tuple[float, float] = (math.inf, math.inf)
    """From when until when it repeats itself, s after its begin."""


class Component(ABC):
    """One such computer, as a peer of a link."""

    def __init__(
        self,
        motion: Callable[[], Motion],
        rate: float,
        component_id: int,
        faults: ComponentFaults,
        seed: int,
    ) -> None:
        """Speak so many times a second.

        Args:
            motion: The truth of now.
            rate: Hz.
            component_id: Its own.
            faults: What is wrong with it.
            seed: Of what is random in that.
        """
        self._motion, self._common = motion, faults
        self._period_ns = round(1e9 / rate)
        self._rng = np.random.default_rng(seed)
        self._past: deque[tuple[int, Motion]] = deque()
        self._held: list[bytes] = []
        self._frozen: Motion | None = None
        self._sender = Sender(1, component_id)
        self._out: list[bytes] = []
        self._begin_ns: int | None = None
        self._heartbeat_ns = self._next_ns = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        """Speak in time with the autopilot."""
        self.tick(now_ns)

    def tick(self, now_ns: int) -> None:
        """Send what is due."""
        self._begin_ns = now_ns if self._begin_ns is None else self._begin_ns
        if now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + _HEARTBEAT_NS
            fields = {"type": _ONBOARD, "autopilot": _NO_AUTOPILOT, "system_status": _ACTIVE}
            self._out.append(self._sender.message("HEARTBEAT", **fields, mavlink_version=3))
        if now_ns >= self._next_ns:
            self._next_ns = max(self._next_ns + self._period_ns, now_ns)
            since = (now_ns - self._begin_ns) * 1e-9
            jitter = round(self._common.jitter * 1e6 * self._rng.standard_normal())
            true = self._true(now_ns, since)
            said = self._say(true, since, now_ns // 1000 + jitter)
            self._held += [] if said is None else [said]
            if len(self._held) >= self._common.burst:
                self._out += self._held
                self._held = []

    def data_to_send(self) -> list[bytes]:
        """Return what it says, once."""
        out, self._out = self._out, []
        return out

    @abstractmethod
    def _say(self, true: Motion, since: float, stamp_us: int) -> bytes | None:
        """Return its message on a motion, so long after its begin, s, and with a stamp; or none."""

    def _true(self, now_ns: int, since: float) -> Motion:
        """Return the motion that it sees: that of some time ago, or of when it froze."""
        self._past.append((now_ns, self._motion()))
        while self._past[0][0] < now_ns - _LONGEST_NS:
            self._past.popleft()
        at_ns = now_ns - round(self._common.delay * 1e9)
        true = min(self._past, key=lambda one: abs(one[0] - at_ns))[1]
        if self._common.frozen[0] <= since < self._common.frozen[1]:
            self._frozen = self._frozen or true
            return self._frozen
        return true
