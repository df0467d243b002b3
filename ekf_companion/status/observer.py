"""Counts what the daemon does as it runs, cheaply, and makes a Snapshot on request.

The loop pays for one clock reading and one comparison per round, one call and one search in twelve
bounds per ODOMETRY, and twice a second a copy of the counters, which give the rates over the last
five seconds. An ODOMETRY counts as sent when the link has taken it.
"""

from __future__ import annotations

import logging
import math
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from ekf_companion.engine.companion import Companion
from ekf_companion.engine.health import Aid
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.link.link import Link
from ekf_companion.mavlink.encode import POSES
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.mavlink.stamp import SECOND_NS, seconds_since
from ekf_companion.nav.arrays import Array
from ekf_companion.status.aids import AidWatch
from ekf_companion.status.collect import (
    frame_state,
    imu_state,
    link_state,
    output_state,
    peer_state,
    requested_rates,
    time_state,
    vehicle_estimate,
)
from ekf_companion.status.host import Host
from ekf_companion.status.judge import BARREN_S, judge
from ekf_companion.status.latency import Latency
from ekf_companion.status.live import live
from ekf_companion.status.losses import Mark, apportion
from ekf_companion.status.past import Past
from ekf_companion.status.preflight import UNJUDGED, check
from ekf_companion.status.snapshot import (
    MessageState,
    OutputState,
    ProcessState,
    ReloadState,
    Snapshot,
)
from ekf_companion.status.status_time import StatusTime
from ekf_companion.version import __version__

SPAN = 20
"""Seconds of the mean: a hundred fixes at 5 Hz give it a sigma of 0.1."""
_STEP = 2


class RecentNis:
    """Mean normalised innovation squared of each aid over the last ``SPAN`` seconds."""

    def __init__(self) -> None:
        self._pipeline: Pipeline | None = None
        self._history: deque[tuple[int, Array, Array]] = deque(maxlen=SPAN // _STEP)
        """When, ns, and by aid the sums of the squared innovations, and how many they are of."""

    def update(self, pipeline: Pipeline, now_ns: int) -> None:
        """Store the sums of this moment; call it every second or two."""
        if pipeline is not self._pipeline:
            self._pipeline = pipeline
            self._history.clear()
        if self._history and now_ns - self._history[-1][0] < _STEP * SECOND_NS:
            return
        nis, counts = pipeline.nis_sums()
        if self._history and (counts < self._history[-1][2]).any():
            self._history.clear()  # the filter began anew
        self._history.append((now_ns, nis, counts))

    def mean(self) -> dict[Aid, float]:
        """Return the mean over its degrees of freedom: 1 if all is well, NaN if there was none."""
        if self._pipeline is None or not self._history:
            return dict.fromkeys(Aid, math.nan)
        nis, counts = self._pipeline.nis_sums()
        _, first_nis, first_counts = self._history[0]
        new = counts - first_counts
        return {
            aid: float((nis[aid] - first_nis[aid]) / new[aid]) if new[aid] > 0.0 else math.nan
            for aid in Aid
        }


_PAUSE_NS = 2 * SECOND_NS
"""Without a sample for so long no estimate is expected: the link is silent."""


class Progress:
    """Compares samples taken with estimates made, every half second."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._given = 0
        self._given_ns = 0
        self._since_ns: int | None = None

    def update(self, pipeline: Pipeline, now_ns: int) -> None:
        """Note the samples and estimates since the last call."""
        stamp_ns, given = pipeline.stamp_ns, pipeline.given
        if stamp_ns != self._stamp_ns:
            self._since_ns = None
        if given != self._given:
            is_first = self._since_ns is None or now_ns - self._given_ns > _PAUSE_NS
            if stamp_ns == self._stamp_ns and is_first:
                self._since_ns = now_ns
            self._given_ns = now_ns
        self._stamp_ns, self._given = stamp_ns, given

    def barren_s(self, now_ns: int) -> float:
        """Return for how long samples have come without an estimate, s; 0: not the case."""
        if self._since_ns is None or now_ns - self._given_ns > _PAUSE_NS:
            return 0.0
        return (self._given_ns - self._since_ns) * 1e-9


_log = logging.getLogger(__name__)

PERIOD_NS = SECOND_NS // 2
"""Time between two copies of the counters."""
_COPIES = 11
"""Copies kept: they span five seconds."""
_ODOMETRY, _VISION = POSES[:2]


@dataclass(frozen=True, slots=True, eq=False)
class _Counters:
    """The counters at one moment."""

    now_ns: int
    cpu_s: float
    received: Mapping[str, int]
    odometries: int
    """ODOMETRY messages that the link took."""
    losses: Mark
    """ODOMETRY that was not sent, and the longest delay of the loop since the copy before."""

    def rate(self, count: float, first: _Counters) -> float:
        """Return a count since then as a rate, Hz; 0 if no time has passed."""
        seconds = (self.now_ns - first.now_ns) * 1e-9
        return count / seconds if seconds else 0.0


class Observer:
    """Watches one companion on one link; called in the loop only."""

    def __init__(
        self,
        link: Link,
        companion: Companion,
        clock: Callable[[], int],
        recorded: Callable[[], tuple[int, int, str]] = lambda: (0, 0, ""),
        unheard: Callable[[], Mapping[str, int]] = dict,
    ) -> None:
        """Start to watch.

        Args:
            link: The link to the autopilot.
            companion: That is fed from it.
            clock: The clock of the link's stamps, ns: unix time that never steps.
            recorded: Returns the bytes that were recorded, those that should have been, and why
                they are not at present.
            unheard: Returns the datagrams that found no monitor, by its address.
        """
        self.latency = Latency()
        self._link, self._companion = link, companion
        self._clock, self._recorded, self._unheard = clock, recorded, unheard
        self._nis, self._progress, self._aids = RecentNis(), Progress(), AidWatch()
        self._status_time = StatusTime()
        self._odometries = self._new_odometries = self._stale = 0
        self._longest_ns = 0
        self._begin_ns = self._tick_ns = clock()
        self._next_ns = 0
        self._history: deque[_Counters] = deque(maxlen=_COPIES)
        self._past = Past()
        self._bytes_in = 0
        self._heard_ns: int | None = None
        self._stamp_ns: int | None = None
        self._sampled_ns: int | None = None
        self._peer: tuple[int, int] | None = None
        self._resets: Counter[str] = Counter()
        self._resets_seen = 0
        self._pipeline: Pipeline | None = None
        self._has_complained = False

    # All the time

    def tick(self, now_ns: int) -> None:
        """Note that the filter's task has handled what was read at ``now_ns``."""
        took_ns = self._clock() - now_ns
        if took_ns > self._longest_ns:
            self._longest_ns = took_ns
        if self._new_odometries:
            self.latency.add(took_ns, self._new_odometries)
            self._new_odometries = 0
        if self._companion.resets != self._resets_seen:
            self._count_resets()
        self._tick_ns = now_ns
        if now_ns >= self._next_ns:
            self._keep_counters(now_ns)

    def on_sent(self, waited_ns: int) -> None:
        """Note that the link has taken an ODOMETRY, at once or after it waited for room."""
        self._odometries += 1
        if waited_ns:
            self.latency.add(waited_ns)
        else:
            self._new_odometries += 1

    def on_stale(self) -> None:
        """Note that an ODOMETRY was too old when it could be sent."""
        self._stale += 1

    @property
    def is_barren(self) -> bool:
        """Whether the filter takes samples and makes no estimates: only a restart helps."""
        return self._progress.barren_s(self._tick_ns) > BARREN_S

    def on_late_timer(self, seconds: float) -> None:
        """Note by how much a timer of the loop was late."""
        self._longest_ns = max(self._longest_ns, round(seconds * 1e9))

    @property
    def loop_lag_ns(self) -> int:
        """Longest delay of the loop in the last second, or a little more."""
        recent = [self._history[-k].losses.lag_ns for k in (1, 2) if k <= len(self._history)]
        return max([self._longest_ns, *recent])

    def _counters(self, now_ns: int) -> _Counters:
        """Return the counters as they are now."""
        session = self._companion.session
        return _Counters(
            now_ns=now_ns,
            cpu_s=time.process_time(),
            received={LAYOUTS[number].name: count for number, count in session.received.items()},
            odometries=self._odometries,
            losses=Mark(
                sum(session.outbox.sent.get(name, 0) for name in (_ODOMETRY, _VISION))
                - self._odometries
                - self._link.backlog.replaceable,
                self._stale,
                self._longest_ns,
            ),
        )

    def _keep_counters(self, now_ns: int) -> None:
        self._next_ns = now_ns + PERIOD_NS
        self._history.append(self._counters(now_ns))
        self._longest_ns = 0
        self._note_changes(now_ns)
        self._past.keep(now_ns, self.live)
        if (pipeline := self._companion.pipeline) is not None:
            self._nis.update(pipeline, now_ns)
            self._progress.update(pipeline, now_ns)
            self._status_time.update(pipeline)
            self._aids.update(pipeline, self._companion.session, now_ns)

    def _note_changes(self, now_ns: int) -> None:
        """Note when bytes, an autopilot and samples were last seen."""
        if self._link.bytes_in != self._bytes_in:
            self._bytes_in, self._heard_ns = self._link.bytes_in, now_ns
        self._peer = self._companion.session.peer or self._peer
        pipeline = self._companion.pipeline
        if pipeline is not None and pipeline.stamp_ns not in (self._stamp_ns, 0):
            self._stamp_ns, self._sampled_ns = pipeline.stamp_ns, now_ns

    def _count_resets(self) -> None:
        """Count the resets of this run; two that follow from one read share their reason."""
        pipeline = self._companion.pipeline
        if pipeline is None:
            return
        if pipeline is not self._pipeline:
            self._pipeline, self._resets_seen = pipeline, 0
        new = pipeline.resets - max(self._resets_seen, pipeline.resets_before)
        self._resets_seen = pipeline.resets
        if new > 0:
            self._resets[pipeline.health().reset_reason] += new

    # On request

    def health_line(self) -> str:
        """Return the line of ``/healthz``; empty after a bug here, which must not stop a flight."""
        try:
            return judge(self.snapshot(Host())).line
        except Exception:  # noqa: BLE001  # as for a page
            if not self._has_complained:
                _log.exception("The state cannot be sent to the service manager")
            self._has_complained = True
            return ""

    def live(self) -> bytes:
        """Return the newest estimate as JSON, for a page that is watched."""
        now_ns = self._clock()
        self._note_changes(now_ns)
        age_s = seconds_since(self._sampled_ns, now_ns)
        return live(self._companion, age_s, self._nis.mean(), now_ns)

    def past(self) -> bytes:
        """Return the estimates of the last two minutes as JSON, for a page that opens."""
        return self._past.to_json(self._clock())

    def snapshot(self, host: Host) -> Snapshot:
        """Return the state at this moment; takes about 0.1 ms.

        ``host`` is read outside of the loop, which must not wait for it.
        """
        now_ns, session = self._clock(), self._companion.session
        self._note_changes(now_ns)
        now = self._counters(now_ns)
        first = self._history[0] if self._history else now
        pipeline = self._companion.pipeline
        messages = self._messages(now, first)
        if pipeline is not None:
            self._aids.update(pipeline, session, now_ns)
        snapshot = Snapshot(
            unix_ns=now_ns,
            link=link_state(self._link, seconds_since(self._heard_ns, now_ns)),
            frames=frame_state(session),
            peer=None if self._peer is None else peer_state(self._companion, self._peer, now_ns),
            messages=messages,
            refused=session.refused,
            imu=imu_state(session, messages),
            time=time_state(session, now_ns),
            estimator=None
            if pipeline is None
            else replace(pipeline.health(), nis=self._nis.mean()),
            vehicle=vehicle_estimate(self._companion, self._aids, now_ns),
            preflight=UNJUDGED,
            barren_s=self._progress.barren_s(now_ns),
            output=self._output(now, first),
            process=self._process(host, now, first),
            sample_age_s=seconds_since(self._sampled_ns, now_ns),
            resets=dict(self._resets),
            seconds=self._status_time.by_name(),
            tuned=self._companion.tuning.changed,
            reload=ReloadState(count=self._companion.reloads, words=self._companion.last_reload),
        )
        return replace(snapshot, preflight=check(snapshot))

    def _messages(self, now: _Counters, first: _Counters) -> dict[str, MessageState]:
        session = self._companion.session
        asked = requested_rates(session)
        return {
            name: MessageState(
                count=now.received.get(name, 0),
                rate=now.rate(now.received.get(name, 0) - first.received.get(name, 0), first),
                asked=asked.get(name, 0.0),
                answer=session.requests.results.get(name, ""),
                cause=session.audit.causes.get(name, ""),
            )
            for name in sorted({*now.received, *asked, *session.requests.results})
        }

    def _output(self, now: _Counters, first: _Counters) -> OutputState:
        new = now.odometries - first.odometries
        rate = now.rate(new, first)
        companion = self._companion
        session, unheard = companion.session, self._unheard()
        state = output_state(session, new, rate, unheard, companion.silence, now.now_ns)
        is_alone = _ODOMETRY in state.sent and _VISION not in state.sent
        taken = {_ODOMETRY: now.odometries} if is_alone else {}
        lost = apportion([one.losses for one in (*self._history, now)])
        return replace(
            state,
            sent={**state.sent, **taken},
            unsent=now.losses.unsent,
            unsent_rate=now.rate(lost.link, first),
            held_rate=now.rate(lost.board, first),
            late_rate=now.rate(lost.late, first),
        )

    def _process(self, host: Host, now: _Counters, first: _Counters) -> ProcessState:
        recorded, unrecorded, trouble = self._recorded()
        return ProcessState(
            version=__version__,
            pid=os.getpid(),
            uptime_s=(now.now_ns - self._begin_ns) * 1e-9,
            cpu_share=now.rate(now.cpu_s - first.cpu_s, first),
            rss_mb=host.rss_mb,
            loop_lag_ms=max(one.losses.lag_ns for one in (now, *self._history)) * 1e-6,
            latency=self.latency.cumulative(),
            latency_sum_ms=self.latency.sum_ns * 1e-6,
            latency_count=self.latency.count,
            temperatures=host.temperatures,
            recorded_bytes=recorded,
            unrecorded_bytes=unrecorded,
            recording_trouble=trouble,
            tick_age_s=seconds_since(self._tick_ns, now.now_ns),
        )
