"""A log of any format as events: the estimator does not run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import LogError
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.measurements import Events, Kind, is_reboot, merge
from ekf_companion.replay.log_source import reference, truth
from ekf_companion.replay.run import Progress, Run
from ekf_companion.replay.worker import Mode


def read(
    path: Path | str, config: Config | None = None, progress: Progress | None = None
) -> Recording:
    """Return the events of a log of any format: the longest stretch of time without a restart.

    Args:
        path: The log.
        config: Its ``link`` decides which autopilot of a .tlog is listened to; None: the first.
        progress: Called with how much is done.

    Raises:
        LogError: The log cannot be read, or holds no event at all.
    """
    path = Path(path)
    run = Run(path, config or Config(), Pipeline, Mode.NEVER)
    tables: list[Events] = []
    families: list[str] = []
    cuts: list[int] = []
    pipeline: Pipeline | None = None
    for block in run.blocks(progress):
        if block.pipeline is not pipeline:
            cuts.append(len(families))
            pipeline = block.pipeline
        tables.append(block.events)
        families += [block.pipeline.family] * len(block.events)
    if not sum(map(len, tables)):
        raise LogError(f"{path}: holds no measurement; ask the autopilot to log or stream them")
    # in the order in which they came: merge keeps it where arrivals are equal
    arrival = [np.zeros(len(part), dtype=np.int64) for part in tables]
    events = merge(*tables, arrival_ns=arrival)
    cuts += np.flatnonzero(events.kind == Kind.RESTART).tolist()
    pieces = np.split(np.arange(len(events)), sorted(set(cuts) - {0}))
    chosen = max(pieces, key=len)
    longest = events.take(chosen)
    if len(pieces) > 1:
        what = (
            "the autopilot rebooted in this log, and its clock"
            if is_reboot(events).any()
            else "another autopilot, or its clock,"
        )
        run.notes.append(f"{what} begins anew; the longest part counts")
    return Recording(
        family=families[chosen[-1]],
        events=longest.take(longest.kind != Kind.RESTART),
        reference=reference(run.log, run.autopilot),
        truth=truth(run.log, run.autopilot),
        counted=run.log.counted if isinstance(run.log, Recording) else None,
        gnss_delay=run.gnss_delay,
        notes=tuple(run.notes),
    )
