"""What the samples at both ends of a gap show of the motion in it, in recorded flights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.document import is_there, table
from benchmarks.recorded import recorded
from ekf_companion.filters.gap import lost_motion, seen_share
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Kind

FLIGHTS = {
    "hexacopter, flown hard": "px4-ulg-tropic-aggressive/ekf_failure.ulg",
    "quadcopter at 50 Hz": "ardupilot-bin-copter-50hz/log171.bin",
    "quadcopter at 25 Hz": "ardupilot-bin-copter-netherlands/spark404_log.bin",
    "mission": "px4-ulg-x500-mission/x500_mission_2023.ulg",
    "hover": "px4-ulg-x500-hover/x500_hover_2023-06-21.ulg",
    "PX4, simulated": "sitl-px4-square/flight.tlog",
    "ArduCopter, simulated": "sitl-arducopter-bin/flight.bin",
}
SPANS = (0.3, 0.5, 1.0, 1.5, 2.0)
HEAD = "flight | " + " | ".join(f"{span:g} s" for span in SPANS) + " | sigma at 1 s | at 2 s"
EVEN = 0.05
"""Stretches whose length differs by a larger share from what is asked have lost samples."""


def gaps(data: Path) -> Iterator[str]:
    """Yield by flight the share of the mean rate of both ends that is best for the turn in a gap.

    After it the sigmas, rad per axis, of the turn that is left: without a turn, by the mean of both
    ends, by the share that is used.
    """
    return table(HEAD, _rows(data))


def _rows(data: Path) -> Iterator[str]:
    sigmas = [lost for span in (1.0, 2.0) if (lost := lost_motion(span)) is not None]
    used = [f"{seen_share(span):.2f}" for span in SPANS]
    yield " | ".join(["as used", *used, *(f"{lost.yaw:.2f}" for lost in sigmas)])
    for title, log in FLIGHTS.items():
        if not is_there(data, log):
            continue
        events = recorded(data / log).events
        is_imu = events.kind == Kind.IMU
        t = (events.t_ns[is_imu] - events.t_ns[is_imu][0]) * 1e-9
        gyro = np.asarray(events.values)[is_imu, :3]
        found = {span: _stretches(t, gyro, span) for span in SPANS}
        shares = [
            f"{(mean * turn).sum() / (mean * mean).sum():.2f}" for turn, mean in found.values()
        ]
        left = [
            ", ".join(f"{np.sqrt(np.mean(one**2)):.2f}" for one in (turn, turn - mean, turn - used))
            for span in (1.0, 2.0)
            for turn, mean in (found[span],)
            for used in (seen_share(span) * mean,)
        ]
        yield " | ".join([title, *shares, *left])


def _stretches(t: Array, gyro: Array, span: float) -> tuple[Array, Array]:
    """Return the turn over each stretch of a length, rad, and that of the mean of both ends."""
    count = round(span / float(np.median(np.diff(t))))
    steps = 0.5 * (gyro[1:] + gyro[:-1]) * np.diff(t)[:, None]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    lengths = t[count:] - t[:-count]
    is_whole = np.abs(lengths - span) < EVEN * span
    turn = (angle[count:] - angle[:-count])[is_whole]
    mean = (0.5 * (gyro[count:] + gyro[:-count]) * lengths[:, None])[is_whole]
    return turn, mean
