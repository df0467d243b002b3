"""Poses of another estimator that a file holds, as an aid of a log.

Both say how the vehicle turns and which way is up: by that the file's clock and body axes become
the log's. Where its world lies and how it is turned the filter finds itself.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.logs.poses import Drift, Poses, read
from ekf_companion.logs.recording import Recording, longest_clock_run
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.direction import levelled
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.relative_pose import FLU_TO_FRD, drift_by_tilt
from ekf_companion.replay.log_source import open_log
from ekf_companion.replay.pose_match import (
    DECISIVE,
    LEAST_COMMON,
    Axes,
    Inertial,
    find_axes,
    find_offset,
)
from ekf_companion.replay.read import read as read_log

MATCHED = 0.01
"""One sigma of a delay that was found so, s."""
TURNS = 0.05
"""Rates beyond those of a hover, rad/s, root mean square: turns that must agree."""
AGREES = 0.25
"""Least share of them that the poses explain where they are of the same flight: a correlation of
a half."""
_SAY = "say by --aid-offset how many seconds to add to its times"

Settings = TypeVar("Settings", bound=FilterSettings)


class PoseFile(NamedTuple):
    """A file of poses that is given for a log."""

    path: Path
    offset: float | None = None
    """What is added to its times for those of the log, s; None: found."""


def open_with(path: Path, config: Config, aid: PoseFile) -> tuple[Recording, Config]:
    """Open a log of any kind with the poses of a file, as :func:`with_poses` does.

    Raises:
        LogError: The log cannot be read, or as :func:`with_poses`.
    """
    log = open_log(path)
    columns = log if isinstance(log, Recording) else read_log(path, config)
    return with_poses(columns, aid.path, config, aid.offset)


def with_poses(
    log: Recording, path: Path | str, settings: Settings, offset: float | None = None
) -> tuple[Recording, Settings]:
    """Return a log with the poses of a file as visual odometry, and the settings to use them by.

    Where the file states how far it may drift, that replaces the settings' walks, and its metres
    are taken as metres.

    Args:
        log: What else was measured; poses of its own are left out.
        path: The file, of a form that :mod:`ekf_companion.logs.poses` reads.
        settings: The estimator's.
        offset: What is added to its times for those of the log, s; None: found.

    Raises:
        LogError: The file cannot be read, or shares no time with the log.
    """
    path = Path(path)
    poses = read(path)
    events, notes = longest_clock_run(log.events)
    notes += poses.notes
    own = events.kind == Kind.POSE
    if own.any():
        notes += (f"{own.sum()} poses of the log itself: left out beside {poses.name}",)
        events = events.take(~own)
    inertial = Inertial(events)
    if len(inertial.t_ns) < 2:
        raise LogError(f"{path}: the log has no inertial samples to compare its turns with")
    offset_ns, is_found, words = _offset(poses, inertial, offset, log.utc_zero_ns)
    poses = replace(poses, t_ns=poses.t_ns + offset_ns)
    begin, end = inertial.t_ns[0], inertial.t_ns[-1]
    within = (poses.t_ns >= begin) & (poses.t_ns <= end)
    if within.sum() < 2:
        raise LogError(
            f"{path}: its poses and the log share no time: {_span(poses.t_ns)} and "
            f"{_span(inertial.t_ns)} on the log's clock; {_SAY}"
        )
    axes = find_axes(poses, inertial)
    _check(path, axes, words)
    rows = to_events(poses, axes, settings.imu.accel_bias / STANDARD_GRAVITY)
    rows = rows.take(within)
    share = f"{len(rows)} of its {len(poses.t_ns)} poses lie within the log"
    notes += (f"{poses.name}: {words}; {share}",)
    merged = merge(
        events, rows, arrival_ns=[np.maximum.accumulate(events.t_ns), np.asarray(rows.t_ns)]
    )
    found = replace(log, events=merged, notes=(*log.notes, *notes))
    return found, _used(settings, poses, is_found=is_found)


def _check(path: Path, axes: Axes, words: str) -> None:
    """Refuse poses that move otherwise than the log does."""
    if axes.turns > TURNS and axes.share < AGREES:
        raise LogError(
            f"{path}: where {words}, it turns otherwise than the log does, and no other delay fits "
            f"decisively: it is of another flight or time, or shares less than {LEAST_COMMON:g} s "
            f"with it; {_SAY}"
        )
    if axes.motion < -DECISIVE:
        raise LogError(
            f"{path}: its places move against its attitudes and the log's accelerations: an axis "
            "is mirrored; write it with right-handed axes"
        )


def _used(settings: Settings, poses: Poses, *, is_found: bool) -> Settings:
    """Return settings by which poses count that were shifted to where their turns agree, or not."""
    used = replace(settings.visual_odometry, use=True)
    if poses.drift is not None:
        used = replace(used, walk=0.0, speed_walk=0.0, yaw_walk=0.0, scale_std=0.0, scale_walk=0.0)
    if is_found:  # the delay is in it
        used = replace(used, delay=0.0, delay_std=min(MATCHED, used.delay_std))
    return replace(settings, visual_odometry=used)


def _span(t_ns: Stamps) -> str:
    return f"{t_ns[0] * 1e-9:.3f} to {t_ns[-1] * 1e-9:.3f} s"


def _offset(
    poses: Poses, inertial: Inertial, given: float | None, utc_zero_ns: int | None
) -> tuple[int, bool, str]:
    """Return what to add to its stamps, ns, whether turns have shown it, and words on that."""
    begin = int(inertial.t_ns[0] - poses.t_ns[0])
    if given is not None:
        offset_ns, words = round(given * 1e9), f"{given:+.3f} s were added to its times"
    elif (shift := find_offset(poses, inertial)) is not None:
        offset_ns = begin + round(shift * 1e9)
        return offset_ns, True, f"{offset_ns * 1e-9:+.3f} s were added to its times, by the turns"
    elif poses.t_ns[-1] >= inertial.t_ns[0] and poses.t_ns[0] <= inertial.t_ns[-1]:
        offset_ns, words = 0, "its times were taken for the log's"
    elif utc_zero_ns is not None:
        offset_ns, words = -utc_zero_ns, "its times were taken for UTC"
    else:
        raise LogError(
            f"{poses.name}: its clock and the log's share no time ({_span(poses.t_ns)} and "
            f"{_span(inertial.t_ns)}), and the turns do not show how far they are apart; {_SAY}"
        )
    return offset_ns, False, words


def to_events(poses: Poses, axes: Axes, level: float) -> Events:
    """Return poses as rows of the filter: down is down, yaw is of the log's forward axis.

    ``level`` is one sigma of the direction up where it is that of the log's samples, rad.
    """
    to_n = FLU_TO_FRD @ levelled(-axes.up_w)
    C_nb = to_n @ so3.to_matrix(poses.q_wp) @ axes.C_bp.T
    yaw = np.arctan2(C_nb[:, 1, 0], C_nb[:, 0, 0])
    place = poses.pos_w @ to_n.T
    unknown = np.full(len(yaw), np.nan)
    columns = [*place.T, yaw, unknown]
    if poses.drift is None:
        return Events.from_columns(poses.t_ns, Kind.POSE, *columns, unknown, unknown)
    tilt = poses.drift.level if poses.is_level else float(np.hypot(poses.drift.level, level))
    way, turn = _in_n(poses, poses.drift, to_n, place, tilt)
    lower = np.tril_indices(3)
    factor = way[:, lower[0], lower[1]]
    return Events.from_columns(poses.t_ns, Kind.POSE, *columns, turn, unknown, *factor.T)


def _in_n(
    poses: Poses, drift: Drift, to_n: Array, place: Array, tilt: float
) -> tuple[Array, Array]:
    """Return the drift since the pose before: factor of that of the way, and sigma of yaw."""
    seconds = np.diff(poses.t_ns, prepend=poses.t_ns[0]) * 1e-9
    way = to_n @ drift.way @ to_n.T * seconds[:, None, None]
    level = np.linalg.norm(np.diff(place[:, :2], axis=0, prepend=place[:1, :2]), axis=1)
    way[:, 2, 2] += drift_by_tilt(tilt, level, seconds)
    values, vectors = np.linalg.eigh(way)
    root = np.sqrt(np.maximum(values, 0.0))[:, None, :] * vectors
    upper = np.asarray(np.linalg.qr(root.transpose(0, 2, 1), mode="r"))
    turn = np.einsum("i,nij,j->n", to_n[2], drift.turn, to_n[2])
    return upper.transpose(0, 2, 1), np.sqrt(np.maximum(turn, 0.0) * seconds)
