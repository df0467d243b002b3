"""Reading of poses that another estimator has written, with what it states of their errors.

World axes have z up or down; the body's axes are the source's own. What a source states is how far
it may have drifted from one pose to the next: that is honest for an odometry, whose sigma since its
start says nothing of the last second.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs.source import read_bytes
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps
from ekf_companion.nav.relative_pose import COVARIANCE, LEVEL, SINCE, square

KIND = "file of poses"
FORMS = (
    "the .csv of `ekf-companion lidar`, its --rel, TUM (t x y z qx qy qz qw), and EuRoC's .csv "
    "(ns, x, y, z, qw, qx, qy, qz)"
)
NANOSECONDS = 1e14
"""Stamps beyond it are ns: as s they were three million years."""
TUM, RELATIVE, EUROC = 8, 30, 8
"""Columns of each form; EuRoC's may have more."""
SAME_NS = 1_000_000
"""Between two stamps that are one: files have them to microseconds, or less."""
UNKNOWN = np.iinfo(np.int64).min
"""Stamp of a row that has none."""
_POSE = ("t_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Drift:
    """How fast the source may drift, for the time from the pose before to each."""

    way: Array
    """Covariance of the position in the world, m^2/s, shape (n, 3, 3)."""
    turn: Array
    """Covariance of the rotation in the world, rad^2/s, shape (n, 3, 3)."""
    level: float
    """One sigma of how the world is tilted, rad."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Poses:
    """Poses in ascending order of their stamps."""

    name: str
    t_ns: Stamps
    """The source's clock, shape (n,)."""
    pos_w: Array
    """m, shape (n, 3)."""
    q_wp: Array
    """From the source's body to its world, shape (n, 4)."""
    drift: Drift | None = None
    """None: the source states none."""
    is_level: bool = True
    """Whether the world's z is vertical; else the world is the first body."""
    notes: tuple[str, ...] = field(default=())


def read(path: Path) -> Poses:
    """Read poses of one of :data:`FORMS`.

    Raises:
        LogError: The file cannot be read, is of another form, or holds fewer than two poses.
    """
    text = read_bytes(path, KIND).decode("utf-8", errors="replace")
    head, _, body = text.removeprefix("\ufeff").partition("\n")
    names = [name.strip() for name in head.split(",")]
    if {*_POSE} <= {*names}:
        return _own(path, names, _numbers(path, body, ","))
    lines = [line for line in text.splitlines() if line[:1].isdecimal() or line[:1] in "-. "]
    plain = "\n".join(lines)
    if "," not in plain:
        rows = _numbers(path, plain, None)
        if rows.shape[1] != TUM:
            raise _unknown(path)
        return _checked(path, _stamps(rows[:, 0]), rows[:, 1:4], rows[:, [7, 4, 5, 6]])
    rows = _numbers(path, plain, ",")
    if rows.shape[1] == RELATIVE:
        return _composed(path, rows)
    if rows.shape[1] < EUROC or not rows[0, 0] > NANOSECONDS:
        raise _unknown(path)
    return _checked(path, _stamps(rows[:, 0]), rows[:, 1:4], rows[:, 4:8])


def _unknown(path: Path) -> LogError:
    return LogError(f"{path}: poses of an unknown form; known are {FORMS}")


def _numbers(path: Path, text: str, delimiter: str | None) -> Array:
    """Return rows of numbers, by the first of each; an empty cell is NaN."""
    if not text.strip():
        raise _unknown(path)
    try:
        rows: Array = np.genfromtxt(io.StringIO(text), delimiter=delimiter, comments="#", ndmin=2)
    except ValueError as error:
        raise LogError(f"{path}: rows of different lengths ({error}); mend it") from None
    if not rows.size or not np.isfinite(rows[:, 0]).any():
        raise _unknown(path)
    return rows[np.argsort(rows[:, 0], kind="stable")]


def _stamps(seconds: Array) -> Stamps:
    size = 1.0 if np.nanmedian(seconds) > NANOSECONDS else 1e9
    known = np.isfinite(seconds) & (np.abs(seconds) * size < 2.0**62)
    t_ns = np.rint(np.where(known, seconds, 0.0) * size).astype(np.int64)
    return np.where(known, t_ns, UNKNOWN)


def _is_pose(t_ns: Stamps, pos: Array, q: Array) -> Mask:
    """Return which rows are finite, a rotation, and later than all before."""
    good: Mask = np.isfinite(pos).all(axis=1) & (np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.05)
    good &= t_ns > UNKNOWN
    latest = np.maximum.accumulate(np.where(good, t_ns, UNKNOWN))
    good[1:] &= t_ns[1:] > latest[:-1]
    return good


def _checked(
    path: Path,
    t_ns: Stamps,
    pos: Array,
    q: Array,
    drift: Drift | None = None,
    *,
    is_level: bool = True,
    notes: tuple[str, ...] = (),
) -> Poses:
    """Return the rows that are poses."""
    good = _is_pose(t_ns, pos, q)
    if (count := int(good.sum())) < 2:
        raise LogError(f"{path}: holds {count} poses of {len(good)} rows; at least two are needed")
    lost = len(good) - count
    why = f"{lost} of {len(good)} rows of {path.name} are no pose, or not later than those before"
    if drift is not None:
        drift = Drift(way=drift.way[good], turn=drift.turn[good], level=drift.level)
    return Poses(
        name=path.name,
        t_ns=t_ns[good],
        pos_w=pos[good],
        q_wp=so3.normalise(q[good]),
        drift=drift,
        is_level=is_level,
        notes=(*notes, f"{why}: left out") if lost else notes,
    )


def _own(path: Path, names: list[str], rows: Array) -> Poses:
    """Return the poses of `ekf-companion lidar`, with the relative ones that end at some rows."""
    at = {name: names.index(name) for name in names}
    if rows.shape[1] != len(names):
        raise LogError(f"{path}: a row has {rows.shape[1]} cells below {len(names)} names; mend it")
    pose = rows[:, [at[name] for name in _POSE]]
    t_ns, q = _stamps(pose[:, 0]), pose[:, 4:]
    drift = None
    if {SINCE, LEVEL, *COVARIANCE} <= {*names}:
        since = rows[:, at[SINCE]]
        ends = np.flatnonzero(np.isfinite(since))
        P = square(rows[ends][:, [at[name] for name in COVARIANCE]])
        begins = np.searchsorted(t_ns, _stamps(since[ends]))
        if len(ends) and (begins < ends).all():
            level = float(rows[-1, at[LEVEL]])
            drift = _drift(t_ns, so3.to_matrix(q), begins, ends, P, level)
    return _checked(path, t_ns, pose[:, 1:4], q, drift=drift)


def _drift(t_ns: Stamps, C: Array, begins: Indices, ends: Indices, P: Array, level: float) -> Drift:
    """Return relative covariances as rates of the rows between their ends.

    Before the first and behind the last one the nearest holds.
    """
    span = ((t_ns[ends] - t_ns[begins]) * 1e-9)[:, None, None]
    before, after = C[begins], C[ends]
    way = before @ P[:, :3, :3] @ before.transpose(0, 2, 1) / span
    turn = after @ P[:, 3:, 3:] @ after.transpose(0, 2, 1) / span
    which = np.minimum(np.searchsorted(ends, np.arange(len(t_ns))), len(ends) - 1)
    return Drift(way=way[which], turn=turn[which], level=level)


def _composed(path: Path, rows: Array) -> Poses:
    """Return relative poses one after the other: of those that follow one another the longest run.

    Their world is the first body, and how it tilts from there on is not known any better than the
    attitudes are.
    """
    rows = rows[np.isfinite(rows).all(axis=1)]
    first, last = _stamps(rows[:, 0]), _stamps(rows[:, 1])
    if not len(rows) or (last <= first).any():
        raise _unknown(path)
    apart = first[1:] - last[:-1]
    if (apart < -SAME_NS).any():
        raise LogError(
            f"{path}: relative poses overlap, and would count twice; give those that follow one "
            "another"
        )
    runs = np.split(np.arange(len(rows)), 1 + np.flatnonzero(apart > SAME_NS))
    kept = max(runs, key=len)
    notes = (
        (f"{path.name}: {len(runs) - 1} gaps between relative poses; the longest run counts",)
        if len(runs) > 1
        else ()
    )
    pos, q = [np.zeros(3)], [np.array([1.0, 0.0, 0.0, 0.0])]
    for step in rows[kept]:
        pos.append(pos[-1] + so3.rotate(q[-1], step[2:5]))
        q.append(so3.normalise(so3.multiply(q[-1], step[[8, 5, 6, 7]])))
    t_ns, C = np.append(first[kept[0]], last[kept]), so3.to_matrix(np.array(q))
    ends = np.arange(1, len(t_ns))
    P = square(rows[kept, 9:])
    drift = _drift(t_ns, C, ends - 1, ends, P, 0.0)
    level = float(np.sqrt(np.trace(P[:, 3:, 3:].sum(axis=0))))
    drift = Drift(way=drift.way, turn=drift.turn, level=level)
    return _checked(path, t_ns, np.array(pos), np.array(q), drift, is_level=False, notes=notes)
