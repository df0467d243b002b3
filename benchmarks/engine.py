"""Who runs the jobs of a campaign: processes of this machine, or Dask.

By the environment variable ENGINE, as in ``make truth ENGINE=dask``: ``processes`` (default),
``dask`` for a Dask cluster on this machine, or the address of a scheduler, ``tcp://HOST:8786``,
whose workers have the same checkout.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TypeVar

from ekf_companion.fleet.dask_executor import LOCAL, Dask
from ekf_companion.fleet.executor import Executor, Lost, Processes

Job = TypeVar("Job")
Result = TypeVar("Result")


def executor(processes: int) -> Executor:
    """Return what the environment asks for.

    Raises:
        SystemExit: It asks for nothing that there is.
    """
    name = os.environ.get("ENGINE") or "processes"
    if name == "processes":
        return Processes(processes)
    if name == "dask" or "://" in name:
        return Dask(LOCAL if name == "dask" else name, processes)
    raise SystemExit(f"ENGINE={name}: is none of processes, dask, tcp://HOST:PORT")


def in_order(
    function: Callable[[Job], Result], jobs: Iterable[Job], processes: int
) -> Iterator[Result]:
    """Yield the results in the order of the jobs, each as soon as those before it are there.

    Args:
        function: Of a module, so that another process finds it.
        jobs: One argument each.
        processes: Their number; 1 with processes: this one.

    Raises:
        RuntimeError: A job failed, or those who ran it were killed.
    """
    runs = executor(processes)
    if processes == 1 and isinstance(runs, Processes):
        yield from map(function, jobs)
        return
    early: dict[int, Result] = {}
    due = 0
    for (number, job), result in runs.run(partial(_run, function), enumerate(jobs)):
        if isinstance(result, Lost):
            raise RuntimeError(f"{job}: {result.why}")
        early[number] = result
        while due in early:
            yield early.pop(due)
            due += 1


def _run(function: Callable[[Job], Result], numbered: tuple[int, Job]) -> Result:
    return function(numbered[1])
