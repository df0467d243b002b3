"""Runs a task on each of many items: in processes of this machine, or elsewhere by the same call.

Whatever becomes of one item, the others go on. An executor takes items as it has room for them, so
that what it holds does not grow with their number.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from heapq import nlargest
from itertools import islice
from typing import Any, Protocol, TypeVar

from ekf_companion.fleet.remote import hidden

Item = TypeVar("Item")
Result = TypeVar("Result")
ATTEMPTS = 2
"""How often a process may die on an item before the item counts as what kills it."""
WINDOW = 4096
"""Items among which the largest come first."""


@dataclass(frozen=True, slots=True)
class Lost:
    """The result of an item whose task did not end."""

    why: str
    """A sentence, without what the item holds."""


class Executor(Protocol):
    """Runs the task on each item."""

    def run(
        self, task: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[tuple[Item, Result | Lost]]:
        """Yield each item and its result once it is known, in any order."""


class Processes:
    """An executor of several processes on this machine."""

    def __init__(self, jobs: int) -> None:
        """Use so many processes, >= 1."""
        self._jobs = jobs

    def run(
        self, task: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[tuple[Item, Result | Lost]]:
        """Yield each item and its result once it is known.

        Each process is a pool of its own: if it dies, its item alone is lost, and begun again.
        """
        left = iter(items)
        free: list[_OneProcess] = [_OneProcess() for _ in range(self._jobs)]
        busy: dict[Future[Result], tuple[_OneProcess, Item, int]] = {}
        try:
            while True:
                for item in islice(left, len(free)):
                    process = free.pop()
                    busy[process.submit(task, item)] = (process, item, 1)
                if not busy:
                    return
                for future in wait(busy, return_when=FIRST_COMPLETED).done:
                    process, item, attempt = busy.pop(future)
                    error = future.exception()
                    if not isinstance(error, BrokenProcessPool):
                        free.append(process)
                        yield item, future.result() if error is None else bug(error)
                        continue
                    process.restart()
                    if attempt < ATTEMPTS:
                        busy[process.submit(task, item)] = (process, item, attempt + 1)
                    else:
                        free.append(process)
                        yield item, Lost(KILLED)
        finally:
            for process in [*free, *(process for process, _, _ in busy.values())]:
                process.close()


KILLED = "the process that read it was killed, perhaps for want of memory"


def bug(error: BaseException) -> Lost:
    """Return what is said of a task that raised."""
    return Lost(f"a bug: {type(error).__name__}: {hidden(str(error))}")


def largest_first(items: Iterable[Item], size: Callable[[Item], int]) -> Iterator[Item]:
    """Yield the items, of each ``WINDOW`` the largest first, so that all processes end together."""
    left = iter(items)
    while some := list(islice(left, WINDOW)):
        yield from nlargest(len(some), some, key=size)


class _OneProcess:
    """A pool of one process, begun when it is needed."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def submit(self, task: Callable[[Item], Result], item: Item) -> Future[Result]:
        """Run the task on an item."""
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_begin_worker)
        try:
            return self._pool.submit(task, item)
        except BrokenProcessPool as error:  # it died idle
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def restart(self) -> None:
        """Forget a process that has died."""
        self.close()
        self._pool = None

    def close(self) -> None:
        """End the process."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)


def _begin_worker() -> None:
    """Ignore Ctrl-C, which the parent handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
