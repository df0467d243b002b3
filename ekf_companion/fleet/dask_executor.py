"""An executor of a Dask cluster: a scheduler that runs somewhere, or workers on this machine."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Iterable, Iterator
from itertools import count, islice
from typing import TYPE_CHECKING, Any

from ekf_companion.errors import ConfigError, UnreachableError, part_of
from ekf_companion.fleet.build import build_name
from ekf_companion.fleet.executor import ATTEMPTS, KILLED, Item, Lost, Result, bug
from ekf_companion.fleet.remote import shown

if TYPE_CHECKING:
    from distributed import LocalCluster

LOCAL = "local"
"""The address that means workers on this machine."""
AHEAD = 4
"""Tasks at the scheduler for each thread of its workers: it always has one to hand out."""
LEAST_AHEAD = 64
PATIENCE_S = 30
"""Time to wait for a scheduler, and for its first worker, s."""
MALLOC = {"MALLOC_MMAP_THRESHOLD_": 32 << 20, "MALLOC_TRIM_THRESHOLD_": 64 << 20}
"""Free memory that a worker keeps, bytes: what glibc itself comes to. With Dask's 64 KiB each log
takes and returns the same pages again and again, 15 % more of a core."""


class Dask:
    """An executor of a Dask cluster."""

    def __init__(self, address: str, jobs: int) -> None:
        """Use the scheduler at an address such as ``tcp://host:8786``, or ``local``.

        Args:
            address: Of the scheduler.
            jobs: Worker processes of ``local``, >= 1.

        Raises:
            MissingPackageError: Dask is not installed.
        """
        self._option = f"--dask {shown(address)}"
        with part_of("fleet", self._option):
            import distributed  # noqa: F401
        self._address, self._jobs = address, jobs

    def run(
        self, task: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[tuple[Item, Result | Lost]]:
        """Yield each item and its result once it is known.

        Dask begins the tasks of a lost worker again; one on which several die has no result.

        Raises:
            ConfigError: No scheduler answers, it has no workers, or they run another version.
            UnreachableError: The scheduler ended, or was restarted.
        """
        from distributed import CancelledError, as_completed

        with self._client() as client:
            ahead = max(AHEAD * self._check_workers(client), LEAST_AHEAD)
            left, name = iter(items), uuid.uuid4().hex
            pending: dict[str, tuple[Item, int]] = {}
            numbers, completed = count(), as_completed()

            def submit(item: Item, attempt: int) -> None:
                if client.status == "closed":  # it was longer without its scheduler than it waits
                    raise self._lost()
                key = f"ekf-companion-{name}-{next(numbers)}"
                pending[key] = item, attempt
                completed.add(client.submit(task, item, key=key, pure=False))

            for item in islice(left, ahead):
                submit(item, 1)
            for future in completed:
                item, attempt = pending.pop(future.key)
                try:
                    outcome = _outcome(future)
                except CancelledError:  # by nobody here
                    raise self._lost() from None
                future.release()
                # Dask gives up a task that was on four lost workers, though it killed none of them
                is_killed = isinstance(outcome, Lost) and outcome.why == KILLED
                if is_killed and attempt < ATTEMPTS:
                    submit(item, attempt + 1)
                    continue
                for another in islice(left, 1):
                    submit(another, 1)
                yield item, outcome

    def _lost(self) -> UnreachableError:
        return UnreachableError(
            f"{self._option}: the scheduler was lost; once it runs again, run the same command: it "
            "goes on where this one ended"
        )

    def _client(self) -> Any:
        from distributed import Client

        if self._address == LOCAL:
            cluster = local_cluster(self._jobs)
            return _Closing(Client(cluster), cluster)
        try:
            return _Closing(Client(self._address, timeout=PATIENCE_S))
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{self._option}: no Dask scheduler answers there "
                f"({type(error).__name__}); start one with `dask scheduler`, or use --dask local"
            ) from None

    def _check_workers(self, client: Any) -> int:
        """Return the number of threads of the workers; refuse workers of another version."""
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except OSError:
            raise ConfigError(
                f"{self._option}: the scheduler has no worker; start some with "
                f"`dask worker {shown(self._address)}`"
            ) from None
        ours = build_name()
        try:
            others = set(client.run(build_name).values()) - {ours}
        except ImportError:
            others = {"no ekf-companion, or an older one"}
        if others:
            raise ConfigError(
                f"{self._option}: its workers have {', '.join(sorted(others))}, and this "
                f"is {ours}; install the same on all"
            )
        return sum(client.nthreads().values())


def local_cluster(jobs: int) -> LocalCluster:
    """Begin a Dask cluster on this machine, of so many worker processes, >= 1."""
    import dask
    from distributed import LocalCluster

    environ = {f"distributed.nanny.pre-spawn-environ.{name}": MALLOC[name] for name in MALLOC}
    with dask.config.set({**environ, "distributed.worker.profile.enabled": False}):
        return LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )


class _Closing:
    """Closes the client, and the cluster behind it."""

    def __init__(self, *parts: Any) -> None:
        self._parts = parts

    def __enter__(self) -> Any:
        return self._parts[0]

    def __exit__(self, *_: object) -> None:
        for part in self._parts:
            part.close()


def _outcome(future: Any) -> Any:
    """Return what became of a task.

    Raises:
        CancelledError: It was cancelled, as all are when the scheduler is lost.
    """
    from distributed import KilledWorker

    error = future.exception()
    if error is None:
        return future.result()
    return Lost(KILLED) if isinstance(error, KilledWorker) else bug(error)
