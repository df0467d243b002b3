"""The recorded flights, and what each is compared over."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.measurements import merge
from ekf_companion.nav.state import Table
from ekf_companion.replay.log_source import READERS, open_log, reference, truth
from ekf_companion.replay.run import Run
from ekf_companion.replay.worker import Mode
from ekf_companion.review import convert
from ekf_companion.review.report import Report


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One log and the part of it that counts."""

    log: str
    """Folder and file below the recorded flights."""
    title: str
    skip: float | None = None
    """Seconds left out at the start; None: what ``compare`` leaves out by itself."""
    until: float | None = None
    """Seconds after the first estimate; None: to the end."""


MISSION = Case(log="px4-ulg-x500-mission/x500_mission_2023.ulg", title="x500 mission (.ulg)")
COPTER = "ardupilot-bin-copter-50hz/log171.bin"
AUTOPILOT = (
    MISSION,
    Case(log="px4-ulg-x500-hover/x500_hover_2023-06-21.ulg", title="x500 hover (.ulg)"),
    Case(
        log="tlog-transcoded-x500-mission/x500_mission_highres.tlog", title="x500 mission (.tlog)"
    ),
    Case(log=COPTER, title="copter, from 20 s (.bin)", until=205.0),
    Case(log=COPTER, title="copter, in flight (.bin)", skip=61.0, until=205.0),
)
"""Real flights: the only reference is the autopilot's own estimate."""

TRUTH = (
    Case(log="sitl-arducopter-square/flight.tlog", title="ArduCopter square (.tlog)"),
    Case(log="sitl-px4-square/flight.tlog", title="PX4 square (.tlog)"),
    Case(log="sitl-arducopter-bin/flight.bin", title="ArduCopter circle (.bin)"),
    Case(log="sitl-px4-ulg/flight.ulg", title="PX4 spiral (.ulg)"),
)
"""The autopilots' own code in their simulators, with the truth in the log."""

POOR = (
    "px4-ulg-damaged-fixedwing/damaged_format_not_utf8.ulg",
    "tlog-copter-canberra/flight.tlog",
    "tlog-copter-vancouver/mission2_2018-09-25.tlog",
    "ardupilot-bin-copter-netherlands/spark404_log.bin",
)
"""Damaged, slow, or without GNSS."""

Estimated = tuple[Table, Report]


@cache
def estimate(path: Path) -> Estimated:
    """Re-run the estimator over a log, once: its estimates and report."""
    return convert.estimate(path, Config())


@cache
def recorded(path: Path) -> Recording:
    """Read a log as events and what to compare them with, whatever its format."""
    suffix = path.suffix.lower()
    if suffix in READERS:
        recording = open_log(path)
        assert isinstance(recording, Recording)
        return recording
    run = Run(path, Config(), Pipeline, Mode.NEVER)  # a .tlog becomes events only by a session
    parts = [block.events for block in run.blocks()]
    return Recording(
        family=run.family,
        # in the order in which they came: merge keeps it where arrivals are equal
        events=merge(*parts, arrival_ns=[np.zeros(len(one), dtype=np.int64) for one in parts]),
        reference=reference(run.log),
        truth=truth(run.log),
        gnss_delay=run.gnss_delay,
    )
