"""What the daemon knows of itself: counted cheaply as it goes, put together when somebody asks.

In the loop there is one clock reading and one comparison a round, one call and one search in twelve
bounds an ODOMETRY, and twice a second a copy of the counters, from which rates over the last five
seconds follow. Of ODOMETRY is counted what the link took, and when: what it threw away, it says.
"""

from __future__ import annotations

import logging
import math
import os
import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import NamedTuple

from ekf_companion.engine.companion import Companion
from ekf_companion.engine.health import Aid, Health
from ekf_companion.engine.pipeline import Array, Pipeline
from ekf_companion.link.link import Link
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.status.collect import (
    age,
    asked_rates,
    frames,
    imu_state,
    link_state,
    output_state,
    part,
    peer_state,
    reload_state,
    time_state,
)
from ekf_companion.status.host import Board
from ekf_companion.status.judge import judge
from ekf_companion.status.progress import BARREN_S, Progress
from ekf_companion.status.snapshot import MessageState, OutputState, ProcessState, Snapshot
from ekf_companion.version import __version__

BUCKETS_MS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Bounds of the latency's histogram, ms."""


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


SPAN = 20
"""Seconds that the mean is over: a hundred fixes at 5 Hz, of which it has a sigma of 0.1."""
_STEP = 2


class _Sums(NamedTuple):
    now_ns: int
    nis: Array
    counts: Array


class RecentNis:
    """Mean normalised innovation squared of each aid over the last seconds."""

    def __init__(self) -> None:
        self._pipeline: Pipeline | None = None
        self._looks: deque[_Sums] = deque(maxlen=SPAN // _STEP)

    def look(self, pipeline: Pipeline, now_ns: int) -> None:
        """Keep the sums of this moment; to be called every second or two."""
        if pipeline is not self._pipeline:
            self._pipeline = pipeline
            self._looks.clear()
        if self._looks and now_ns - self._looks[-1].now_ns < _STEP * SECOND_NS:
            return
        sums = _Sums(now_ns, *pipeline.nis_sums())
        if self._looks and (sums.counts < self._looks[-1].counts).any():
            self._looks.clear()  # the filter began anew
        self._looks.append(sums)

    def mean(self) -> dict[Aid, float]:
        """Give it over its degrees of freedom: 1 if all is well; NaN: none in that time."""
        if self._pipeline is None or not self._looks:
            return dict.fromkeys(Aid, math.nan)
        nis, counts = self._pipeline.nis_sums()
        first = self._looks[0]
        new = counts - first.counts
        return {
            aid: float((nis[aid] - first.nis[aid]) / new[aid]) if new[aid] > 0.0 else math.nan
            for aid in Aid
        }


_log = logging.getLogger(__name__)

PERIOD_NS = SECOND_NS // 2
"""Between two looks at the counters."""
_LOOKS = 11
"""Kept: they span five seconds."""
_ODOMETRY = "ODOMETRY"
_NAMES = {message_id: name for name, message_id in IDS.items()}


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """The counters at one moment."""

    now_ns: int
    cpu_s: float
    received: Mapping[int, int]
    odometries: int
    """ODOMETRY messages that the link took."""
    unsent: int
    """ODOMETRY messages that it threw away."""
    lag_ns: int
    """The longest wait since the look before."""


class Observer:
    """Watches one companion on one link; all but ``snapshot``'s argument is the loop's own."""

    def __init__(
        self,
        link: Link,
        companion: Companion,
        clock: Callable[[], int],
        recorded: Callable[[], tuple[int, int, str]] = lambda: (0, 0, ""),
        unheard: Callable[[], Mapping[str, int]] = dict,
    ) -> None:
        """Begin to watch.

        Args:
            link: The bytes.
            companion: All that is made of them.
            clock: That of the link's stamps, ns: unix time that never steps.
            recorded: Gives the bytes that were recorded, those that should have been, and why they
                are not at present.
            unheard: Gives the datagrams that found no monitor, by its address.
        """
        self.latency = Latency()
        self._link, self._companion = link, companion
        self._clock, self._recorded, self._unheard = clock, recorded, unheard
        self._nis, self._progress = RecentNis(), Progress()
        self._odometries = self._new_odometries = 0
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
        self._pipeline: Pipeline | None = None
        self._has_complained = False

    # In the loop, all the time

    def beat(self, now_ns: int) -> None:
        """Note that the filter's task went round with what was read at a time of ours."""
        took_ns = self._clock() - now_ns
        if took_ns > self._longest_ns:
            self._longest_ns = took_ns
        if self._new_odometries:
            self.latency.take(took_ns, self._new_odometries)
            self._new_odometries = 0
        if self._companion.resets != self._resets_seen:
            self._book_resets()
        self._beat_ns = now_ns
        if now_ns >= self._next_ns:
            self._look(now_ns)

    def sent(self, waited_ns: int) -> None:
        """Note that the link took an ODOMETRY: at once, or after it had waited for room."""
        self._odometries += 1
        if waited_ns:
            self.latency.take(waited_ns)
        else:
            self._new_odometries += 1

    @property
    def is_barren(self) -> bool:
        """Whether the filter is given samples and gives no estimate: only a restart helps."""
        return self._progress.barren_s(self._beat_ns) > BARREN_S

    def late(self, seconds: float) -> None:
        """Note by how much a timer of the loop was late."""
        self._longest_ns = max(self._longest_ns, round(seconds * 1e9))

    def _look(self, now_ns: int) -> None:
        self._next_ns = now_ns + PERIOD_NS
        self._looks.append(
            _Look(
                now_ns=now_ns,
                cpu_s=time.process_time(),
                received=dict(self._companion.session.received),
                odometries=self._odometries,
                unsent=self._unsent(),
                lag_ns=self._longest_ns,
            )
        )
        self._longest_ns = 0
        self._notice(now_ns)
        if (pipeline := self._companion.pipeline) is not None:
            self._nis.look(pipeline, now_ns)
            self._progress.look(pipeline, now_ns)

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

    def _book_resets(self) -> None:
        """Count what is new since this run began; two that come of one read have one reason."""
        pipeline = self._companion.pipeline
        if pipeline is None:
            return
        if pipeline is not self._pipeline:
            self._pipeline, self._resets_seen = pipeline, 0
        new = pipeline.resets - max(self._resets_seen, pipeline.resets_before)
        self._resets_seen = pipeline.resets
        if new > 0:
            self._resets[pipeline.health().reset_reason] += new

    # In the loop, when somebody asks

    def words(self) -> str:
        """Say in one line how we are; empty: what is only told had a bug, and stops no flight."""
        try:
            return judge(self.snapshot(Board())).words
        except Exception:  # noqa: BLE001  # as where a page asks
            if not self._has_complained:
                _log.exception("The service manager cannot be told how we are")
            self._has_complained = True
            return ""

    def snapshot(self, board: Board) -> Snapshot:
        """Give all of it at this moment; about 0.1 ms.

        Args:
            board: What was read outside of the loop, which must not wait for it.
        """
        now_ns, session = self._clock(), self._companion.session
        self._notice(now_ns)
        pipeline = self._companion.pipeline
        health = None if pipeline is None else self._health(pipeline)
        counters, messages = session.counters(), self._messages(now_ns)
        return Snapshot(
            unix_ns=now_ns,
            link=link_state(self._link, age(self._heard_ns, now_ns)),
            frames=frames(counters),
            peer=None if self._peer is None else peer_state(self._companion, self._peer, now_ns),
            messages=messages,
            refused=part(counters, "refused: "),
            imu=imu_state(session.decoder, messages),
            time=time_state(session.timesync, session.decoder, now_ns),
            estimator=health,
            barren_s=self._progress.barren_s(now_ns),
            output=self._output(now_ns),
            process=self._process(board, now_ns),
            sample_age_s=age(self._sampled_ns, now_ns),
            resets=dict(self._resets),
            tuned=self._companion.tuning.changed,
            reload=reload_state(self._companion),
        )

    def _health(self, pipeline: Pipeline) -> Health:
        """Give the filter's account, its consistency that of the last seconds."""
        return replace(pipeline.health(), nis=self._nis.mean())

    def _unsent(self) -> int:
        """Give the ODOMETRY messages that the link has thrown away."""
        offered = self._companion.session.outbox.sent.get(_ODOMETRY, 0)
        return offered - self._odometries - self._link.replaceable_waiting

    def _span(self, now_ns: int) -> tuple[_Look | None, float]:
        """Give the oldest look and the seconds since; 0: there is none to compare with."""
        if not self._looks:
            return None, 0.0
        return self._looks[0], (now_ns - self._looks[0].now_ns) * 1e-9

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
                answer=session.requests.results.get(name, ""),
                cause=session.audit.causes.get(name, ""),
            )
            for name in sorted({*counts, *asked, *session.requests.results})
        }

    def _output(self, now_ns: int) -> OutputState:
        first, seconds = self._span(now_ns)
        unsent, session = self._unsent(), self._companion.session
        new = self._odometries - (0 if first is None else first.odometries)
        lost = unsent - (0 if first is None else first.unsent)
        rate = new / seconds if seconds else 0.0
        state = output_state(session, new, rate, self._unheard())
        sent = dict(state.sent)
        if _ODOMETRY in sent:
            sent[_ODOMETRY] = self._odometries
        return replace(
            state,
            sent=sent,
            unsent=unsent,
            unsent_rate=lost / seconds if seconds else 0.0,
        )

    def _process(self, board: Board, now_ns: int) -> ProcessState:
        first, seconds = self._span(now_ns)
        cpu_s = 0.0 if first is None else time.process_time() - first.cpu_s
        recorded, unrecorded, trouble = self._recorded()
        return ProcessState(
            version=__version__,
            pid=os.getpid(),
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
            recording_trouble=trouble,
            tick_age_s=age(self._beat_ns, now_ns),
        )
