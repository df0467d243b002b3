"""The daemon's ODOMETRY, by its recordings: sent and withheld messages separated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sitl.place import Places, latest
from ekf_companion.errors import LogError
from ekf_companion.logs import tlog
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask

COMPONENT_ID = 194
"""The daemon's."""
_LOCAL_NED = 1
_STX_2 = 0xFD

Projection = Callable[[Array, Places], Places]
"""Makes places of metres about an origin."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Odometry:
    """The ODOMETRY of one flight, of all runs of the daemon, shape (n, ...)."""

    t: Array
    """Time of validity, s of the vehicle's clock."""
    pos_n: Array
    """As stated: m about the origin of the next field."""
    origin: Places | None
    """Last GPS_GLOBAL_ORIGIN of the same component; None: it never came."""
    vel_n: Array
    """m/s."""
    euler: Array
    """Roll, pitch, yaw, rad, unwrapped."""
    resets: Array
    """reset_counter."""
    quality: Array
    is_sent: Mask
    """False: it was only recorded."""

    def only(self, rows: Any) -> Odometry:
        """Return some of them."""
        origin = self.origin and Places(*(one[rows] for one in self.origin))
        return Odometry(
            t=self.t[rows],
            pos_n=self.pos_n[rows],
            origin=origin,
            vel_n=self.vel_n[rows],
            euler=self.euler[rows],
            resets=self.resets[rows],
            quality=self.quality[rows],
            is_sent=self.is_sent[rows],
        )


def is_sent(sequences: Array) -> Mask:
    """Return which frames of one component were sent, by their sequence numbers in their order.

    A withheld frame is recorded with the number of the next one that is sent, which follows.
    """
    if not len(sequences):
        return np.zeros(0, dtype=bool)
    return np.append(np.diff(sequences) != 0, True)


def read_odometry(recordings: Sequence[Path]) -> Odometry | None:
    """Read the ODOMETRY of all runs of the daemon; None: there is none."""
    parts = [part for one in recordings if (part := _read(one)) is not None]
    if not parts:
        return None
    stated = [part.origin for part in parts if part.origin is not None]
    origin = None
    if len(stated) == len(parts):
        origin = Places(*(np.concatenate(values) for values in zip(*stated, strict=True)))
    names = ("t", "pos_n", "vel_n", "euler", "resets", "quality", "is_sent")
    return Odometry(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
        origin=origin,
    )


def read_origins(recordings: Sequence[Path]) -> Places:
    """Return each GPS_GLOBAL_ORIGIN that the daemon sent."""
    found = [_origins(log)[1] for one in recordings if (log := _open(one)) is not None]
    nothing = np.zeros(0)
    return Places(*(np.concatenate([nothing, *(one[k] for one in found)]) for k in range(3)))


def _open(recording: Path) -> tlog.Tlog | None:
    try:
        return tlog.read(recording)
    except (LogError, OSError):
        return None  # It was killed before it had recorded anything


def _read(recording: Path) -> Odometry | None:
    log = _open(recording)
    rows = None if log is None else log.columns(("ODOMETRY",), 1, COMPONENT_ID).get("ODOMETRY")
    if log is None or rows is None:
        return None
    q_nb = np.asarray(rows["q"], dtype=float)
    q_nb /= np.linalg.norm(q_nb, axis=1, keepdims=True)
    velocity = np.stack([rows[name] for name in ("vx", "vy", "vz")], axis=1).astype(float)
    is_local = rows["child_frame_id"] == _LOCAL_NED
    order, origins = _origins(log)
    return Odometry(
        t=rows["time_usec"] * 1e-6,
        pos_n=np.stack([rows[name] for name in ("x", "y", "z")], axis=1).astype(float),
        origin=latest(rows[tlog.ORDER], order, origins) if len(order) else None,
        vel_n=np.where(is_local[:, None], velocity, so3.rotate(q_nb, velocity)),
        euler=np.unwrap(so3.to_euler(q_nb), axis=0),
        resets=rows["reset_counter"].astype(int),
        quality=rows["quality"].astype(int),
        is_sent=_sent_rows(log)[rows[tlog.ORDER]],
    )


def _sent_rows(log: tlog.Tlog) -> Mask:
    """Return for each record whether it is a frame that the daemon sent."""
    ours, numbers = [], []
    for i, (_, raw) in enumerate(log.frames()):
        if raw[0] == _STX_2 and raw[6] == COMPONENT_ID:
            ours.append(i)
            numbers.append(raw[4])
    found = np.zeros(len(log), dtype=bool)
    found[ours] = is_sent(np.array(numbers))
    return found


def _origins(log: tlog.Tlog) -> tuple[Array, Places]:
    """Return the records of our GPS_GLOBAL_ORIGIN, and their content."""
    rows = log.columns(("GPS_GLOBAL_ORIGIN",), 1, COMPONENT_ID).get("GPS_GLOBAL_ORIGIN")
    if rows is None:
        return np.zeros(0), Places(np.zeros(0), np.zeros(0), np.zeros(0))
    places = (rows["latitude"] * 1e-7, rows["longitude"] * 1e-7, rows["altitude"] * 1e-3)
    return rows[tlog.ORDER], Places(*places)


def resumed_after(recording: Path) -> float:
    """Return the time from the autopilot's restart to the next ODOMETRY, s; infinite: none came."""
    log = tlog.read(recording)
    ours = log.columns(("ODOMETRY",), 1, COMPONENT_ID).get("ODOMETRY")
    theirs = log.columns(("SYSTEM_TIME",), 1, 1).get("SYSTEM_TIME")
    if ours is None or theirs is None:
        return float("inf")
    ours = ours[_sent_rows(log)[ours[tlog.ORDER]]]
    backwards = np.flatnonzero(np.diff(theirs["time_boot_ms"].astype(np.int64)) < 0)
    if not len(backwards):
        return float("inf")
    begun = theirs[tlog.STAMP][backwards[-1] + 1]
    later = ours[tlog.STAMP][ours[tlog.STAMP] > begun]
    return float((later[0] - begun) * 1e-6) if len(later) else float("inf")
