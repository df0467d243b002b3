"""A flight over a link in real time, or faster; and a recorded one."""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from ekf_companion.errors import CompanionError
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.faults.fault import Fault
from sim_autopilot.flight import Flight
from sim_autopilot.personality import Kind, Personality
from sim_autopilot.recording import TlogWriter
from sim_autopilot.rig import Rig
from sim_autopilot.score import Witness, quantiles

T = TypeVar("T")

_AFTER = 0.3
"""After the last sample, messages are still received for so long, s."""
_STEPS = 100
_NEWS = 4.0
"""Seconds between two lines of progress: less than the five after which a user wonders."""
_HEARTBEAT_PERIOD = 0.1
"""Before the first answer, s."""


class Pace:
    """A clock that shows ``first_ns`` now and runs ``speed`` times as fast as ours."""

    def __init__(self, first_ns: int, speed: float) -> None:
        self.late_ns: list[int] = []
        """Lateness of the end of each wait, ns of our clock."""
        self._first_ns = first_ns
        self._speed = speed
        self._start_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time that it shows."""
        return self.shown_ns(time.monotonic_ns())

    def shown_ns(self, monotonic_ns: int) -> int:
        """Return the time that it shows when our monotonic clock shows ``monotonic_ns``."""
        return self._first_ns + round((monotonic_ns - self._start_ns) * self._speed)

    async def until(self, t_ns: int) -> None:
        """Wait until it shows a time, counted from the start, so that no error accumulates."""
        due_ns = self._start_ns + round((t_ns - self._first_ns) / self._speed)
        # Also when late: the receiver must get to run
        await asyncio.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
        self.late_ns.append(time.monotonic_ns() - due_ns)

    def lateness(self) -> dict[str, float]:
        """Return how late the waits ended, ms of our clock."""
        return quantiles(np.array(self.late_ns or [0]) * 1e-6)


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """The result of a flight over a link."""

    autopilot: Autopilot
    witness: Witness
    pace: Pace


async def fly(
    flight: Flight,
    link: Link,
    *,
    personality: Personality | Kind = Kind.PX4,
    faults: Sequence[Fault] = (),
    speed: float = 1.0,
    log: TlogWriter | None = None,
    wait: float = 0.0,
) -> Flown:
    """Fly over an open link, ``speed`` times as fast as real time, and receive the estimate.

    The personality is the autopilot to imitate; of a kind the ideal one. The log gets every frame
    sent and received. The flight begins with an answer, waited for ``wait`` s, or at once if 0.

    Raises:
        CompanionError: Nobody answered.
    """
    rig = Rig(flight, personality=personality, faults=faults)
    witness = Witness(flight, rig.clock.true_ns)
    if wait > 0.0:
        await _wait_for_answer(rig.autopilot, link, wait)
    pace = Pace(flight.first_ns, speed)

    def exchange() -> None:
        now_ns = pace.now_ns()
        while (item := rig.pop(now_ns)) is not None:
            link.send(item[1])
            if log is not None:
                log.write(now_ns, item[1])
        for message in rig.received():
            witness.receive(message)
            if log is not None:
                log.write(message.now_ns, message.frame)

    async def listen() -> None:
        while True:
            read = await link.receive()
            rig.receive(read.data, pace.shown_ns(read.now_ns))
            exchange()

    async with _background(listen()):
        for cycle in flight.cycles():
            await pace.until(cycle.flight_ns)
            witness.sent(pace.now_ns())
            rig.cycle(cycle)
            if rig.autopilot.loop_ns > cycle.flight_ns:
                # A late iteration of the loop has a late stamp: nothing may arrive before its stamp
                await pace.until(rig.autopilot.loop_ns)
            exchange()
        # In steps: on a busy machine the time may pass while nothing was read
        for _ in range(_STEPS):
            await asyncio.sleep(_AFTER / _STEPS)
    return Flown(rig.autopilot, witness, pace)


async def _wait_for_answer(autopilot: Autopilot, link: Link, wait: float) -> None:
    """Send heartbeats until bytes come back."""
    loop = asyncio.get_running_loop()
    end = loop.time() + wait
    while loop.time() < end:
        autopilot.heartbeat()
        for frame in autopilot.data_to_send():
            link.send(frame)
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(link.receive(), _HEARTBEAT_PERIOD)
            return
    raise CompanionError(
        f"{link.address}: nobody answered within {wait:g} s; start the daemon first"
    )


async def play(frames: Iterable[tuple[int, bytes]], link: Link, speed: float = 1.0) -> int:
    """Send recorded frames at their times, and return their number."""
    count = 0
    pace: Pace | None = None

    async def listen() -> None:
        while True:
            await link.receive()

    async with _background(listen()):
        for t_ns, frame in frames:
            if pace is None:
                pace = Pace(t_ns, speed)
            if t_ns > pace.now_ns():
                await pace.until(t_ns)
            link.send(frame)
            count += 1
    return count


async def over(url: str, body: Callable[[Link], Awaitable[T]]) -> T:
    """Open a link, and run ``body`` with it once it is open.

    Raises:
        LinkError: The URL names no link.
    """
    is_open = asyncio.Event()
    link = Link(parse_url(url), on_state=lambda now_open: is_open.set() if now_open else None)
    async with _background(link.run()):
        await is_open.wait()
        return await body(link)


@contextlib.asynccontextmanager
async def telling(duration: float, on_progress: Callable[[str], None]) -> AsyncIterator[None]:
    """Say every few seconds while the body flies how far it is, of how many s."""

    async def tell() -> None:
        begin = asyncio.get_running_loop().time()
        on_progress(f"flying for {duration:g} s")
        while True:
            await asyncio.sleep(_NEWS)
            now = asyncio.get_running_loop().time() - begin
            on_progress(f"flying, {now:.0f} of {duration:g} s")

    async with _background(tell()):
        yield


@contextlib.asynccontextmanager
async def _background(work: Coroutine[None, None, None]) -> AsyncIterator[None]:
    """Run a coroutine beside the body; its error is raised at the end."""
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine on a loop that sleeps to the microsecond.

    The usual loop waits in ``epoll``, which rounds up to whole milliseconds: a quarter of a period
    at 250 Hz. ``select`` does not.
    """
    loop = asyncio.SelectorEventLoop(selectors.SelectSelector())
    try:
        asyncio.set_event_loop(loop)
        return loop.run_until_complete(main)
    finally:
        loop.run_until_complete(loop.shutdown_asyncgens())
        asyncio.set_event_loop(None)
        loop.close()
