"""What the daemon knows of itself: counted cheaply as it goes, put together when somebody asks.

In the loop there is one clock reading a round, one search in twelve bounds an ODOMETRY, and twice
a second a copy of the counters, from which rates over the last five seconds follow.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import accumulate

from ekf_companion.board import Board
from ekf_companion.companion import Companion
from ekf_companion.config import Config
from ekf_companion.link import Link
from ekf_companion.mavlink.layout import IDS
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.measurements import Kind
from ekf_companion.parts import (
    age,
    asked_rates,
    firmware,
    frames,
    guard_state,
    heartbeat_ns,
    part,
    refused_datagrams,
    sent_by_name,
    time_state,
)
from ekf_companion.pipeline import Health
from ekf_companion.snapshot import (
    LinkState,
    MessageState,
    OutputState,
    PeerState,
    ProcessState,
    Snapshot,
)
from ekf_companion.version import __version__

BUCKETS_MS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Bounds of the latency's histogram, ms."""
PERIOD_NS = SECOND_NS // 2
"""Between two looks at the counters."""
_LOOKS = 11
"""Kept: they span five seconds."""
_ODOMETRY = "ODOMETRY"
_NAMES = {message_id: name for name, message_id in IDS.items()}


class Latency:
    """Time from a read to the estimate sent, as a histogram."""

    def __init__(self) -> None:
        self._bounds_ns = [round(bound * 1e6) for bound in BUCKETS_MS]
        self._counts = [0] * (len(BUCKETS_MS) + 1)
        self.sum_ns = 0

    def take(self, took_ns: int, times: int = 1) -> None:
        """Count estimates that left so long after what they are of was read."""
        self._counts[bisect_left(self._bounds_ns, took_ns)] += times
        self.sum_ns += took_ns * times

    @property
    def count(self) -> int:
        """Give how many were counted."""
        return sum(self._counts)

    def cumulative(self) -> dict[float, int]:
        """Give how many took no longer than each bound, ms."""
        return dict(zip(BUCKETS_MS, accumulate(self._counts), strict=False))


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """The counters at one moment."""

    now_ns: int
    cpu_s: float
    received: Mapping[int, int]
    odometries: int
    lag_ns: int
    """The longest wait since the look before."""


class Observer:
    """Watches one companion on one link; all but ``snapshot``'s argument is the loop's own."""

    def __init__(
        self,
        config: Config,
        link: Link,
        companion: Companion,
        clock: Callable[[], int],
        recorded: Callable[[], tuple[int, int]] = lambda: (0, 0),
    ) -> None:
        """Begin to watch.

        Args:
            config: What was asked for.
            link: The bytes.
            companion: All that is made of them.
            clock: That of the link's stamps, ns: unix time that never steps.
            recorded: Gives the bytes that were recorded, and those that should have been.
        """
        self.latency = Latency()
        self._config, self._link, self._companion = config, link, companion
        self._clock, self._recorded = clock, recorded
        self._sent = sent_by_name(companion.session)
        self._odometries = 0
        self._longest_ns = 0
        self._begin_ns = self._beat_ns = clock()
        self._next_ns = 0
        self._looks: deque[_Look] = deque(maxlen=_LOOKS)
        self._bytes_in = 0
        self._heard_ns: int | None = None
        self._stamp_ns: int | None = None
        self._sampled_ns: int | None = None
        self._peer: tuple[int, int] | None = None
        self._resets: Counter[str] = Counter()
        self._resets_seen = 0

    # In the loop, all the time

    def beat(self, now_ns: int) -> None:
        """Note that the filter's task went round with what was read at a time of ours."""
        took_ns = self._clock() - now_ns
        if took_ns > self._longest_ns:
            self._longest_ns = took_ns
        odometries = self._sent.get(_ODOMETRY, 0)
        if odometries != self._odometries:
            self.latency.take(took_ns, odometries - self._odometries)
            self._odometries = odometries
        self._beat_ns = now_ns
        if now_ns >= self._next_ns:
            self._look(now_ns)

    def late(self, seconds: float) -> None:
        """Note by how much a timer of the loop was late."""
        self._longest_ns = max(self._longest_ns, round(seconds * 1e9))

    def _look(self, now_ns: int) -> None:
        self._next_ns = now_ns + PERIOD_NS
        received = dict(self._companion.session.received)
        look = _Look(now_ns, time.process_time(), received, self._odometries, self._longest_ns)
        self._looks.append(look)
        self._longest_ns = 0
        self._notice(now_ns)

    def _notice(self, now_ns: int) -> None:
        """See what has changed since the last look."""
        if self._link.bytes_in != self._bytes_in:
            self._bytes_in, self._heard_ns = self._link.bytes_in, now_ns
        self._peer = self._companion.session.peer or self._peer
        pipeline = self._companion.pipeline
        if pipeline is None:
            return
        if pipeline.stamp_ns not in (self._stamp_ns, 0):
            self._stamp_ns, self._sampled_ns = pipeline.stamp_ns, now_ns
        if pipeline.resets != self._resets_seen:
            # Two within half a second count for the second's reason; a new pipeline counts anew
            new = pipeline.resets - self._resets_seen
            self._resets[pipeline.health().reset_reason] += new if new > 0 else pipeline.resets
            self._resets_seen = pipeline.resets

    # In the loop, when somebody asks

    def snapshot(self, board: Board) -> Snapshot:
        """Give all of it at this moment; about 0.1 ms.

        Args:
            board: What was read outside of the loop, which must not wait for it.
        """
        now_ns, session = self._clock(), self._companion.session
        self._notice(now_ns)
        pipeline = self._companion.pipeline
        health = None if pipeline is None else pipeline.health()
        counters = session.counters()
        return Snapshot(
            unix_ns=now_ns,
            link=self._link_state(now_ns),
            frames=frames(counters),
            peer=self._peer_state(health, now_ns),
            messages=self._messages(now_ns),
            refused=part(counters, "refused: "),
            time=time_state(session.timesync, session.decoder, now_ns),
            estimator=health,
            output=self._output(now_ns),
            process=self._process(board, now_ns),
            sample_age_s=age(self._sampled_ns, now_ns),
            resets=dict(self._resets),
        )

    def _span(self, now_ns: int) -> tuple[_Look | None, float]:
        """Give the oldest look and the seconds since; 0: there is none to compare with."""
        if not self._looks:
            return None, 0.0
        return self._looks[0], (now_ns - self._looks[0].now_ns) * 1e-9

    def _link_state(self, now_ns: int) -> LinkState:
        link = self._link
        return LinkState(
            url=str(link.address),
            is_open=link.is_open,
            opened=link.opened,
            bytes_in=link.bytes_in,
            bytes_out=link.bytes_out,
            dropped=link.dropped,
            unsent=link.unsent,
            silent_s=age(self._heard_ns, now_ns),
            refused=refused_datagrams(link),
        )

    def _peer_state(self, health: Health | None, now_ns: int) -> PeerState | None:
        if self._peer is None:
            return None
        session = self._companion.session
        restarts = {} if health is None else health.arrivals[Kind.RESTART]
        return PeerState(
            system_id=self._peer[0],
            component_id=self._peer[1],
            family=session.decoder.family.value,
            version=firmware(session),
            is_heard=session.peer is not None,
            silent_s=age(heartbeat_ns(session), now_ns),
            is_armed=session.decoder.is_armed,
            reboots=sum(restarts.values()),
        )

    def _messages(self, now_ns: int) -> dict[str, MessageState]:
        session, (first, seconds) = self._companion.session, self._span(now_ns)
        counts = {_NAMES[number]: count for number, count in session.received.items()}
        before = {} if first is None else {_NAMES[k]: n for k, n in first.received.items()}
        asked = asked_rates(session)
        return {
            name: MessageState(
                count=counts.get(name, 0),
                rate=(counts.get(name, 0) - before.get(name, 0)) / seconds if seconds else 0.0,
                asked=asked.get(name, 0.0),
                answer=session.results.get(name, ""),
            )
            for name in sorted({*counts, *asked, *session.results})
        }

    def _output(self, now_ns: int) -> OutputState:
        first, _ = self._span(now_ns)
        before = 0 if first is None else first.odometries
        mode, guard = self._config.output.odometry.mode, guard_state(self._companion)
        return OutputState(
            mode=mode,
            is_streaming=self._sent.get(_ODOMETRY, 0) > before,
            reason=guard.reason,
            remedy=guard.remedy,
            parameters=guard.parameters,
            sent=dict(self._sent),
            withheld=guard.withheld,
        )

    def _process(self, board: Board, now_ns: int) -> ProcessState:
        first, seconds = self._span(now_ns)
        cpu_s = 0.0 if first is None else time.process_time() - first.cpu_s
        recorded, unrecorded = self._recorded()
        return ProcessState(
            version=__version__,
            uptime_s=(now_ns - self._begin_ns) * 1e-9,
            cpu_share=cpu_s / seconds if seconds else 0.0,
            rss_mb=board.rss_mb,
            loop_lag_ms=max([self._longest_ns, *(look.lag_ns for look in self._looks)]) * 1e-6,
            latency=self.latency.cumulative(),
            latency_sum_ms=self.latency.sum_ns * 1e-6,
            latency_count=self.latency.count,
            temperatures=board.temperatures,
            recorded_bytes=recorded,
            unrecorded_bytes=unrecorded,
            tick_age_s=age(self._beat_ns, now_ns),
        )
