"""The iterated update, in information form, with anchors that are considered and not corrected.

At the iterate x, with e the error state from the prior to x and A = H' R^-1 H summed over the rows,

    d = -e + P (I + A P)^-1 (H' R^-1 z + A e)

which needs no inverse of P: an anchor that was just made is the pose itself, and P is singular. The
errors of the anchors are part of P and of A; they are not corrected (Schmidt's consider states), so
that the map stays where it is, and their covariance does not shrink.

Source: Xu and Zhang 2021, "FAST-LIO", arXiv 2010.08196 (information form, iterated on manifolds);
Schmidt 1966, "Application of state-space methods to navigation problems" (consider states).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.relocation import Place
from ekf_companion.lidar.rows import Known, Sums
from ekf_companion.lidar.state import (
    ACCEL_BIAS,
    ATT,
    CALIBRATION,
    DELAY,
    DOWN,
    EXCESS,
    MOUNT_ATT,
    MOUNT_POS,
    POS,
    POSE,
    VEL,
    N,
    State,
    log,
)
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices
from ekf_companion.nav.direction import direction_jacobian
from ekf_companion.nav.so3 import skew

SETTLED = 0.02
"""Share of one sigma in every state below which a step is the last."""
SEEN = np.arange(12)
SEEN_WITH_MOUNTING = np.concatenate([np.arange(12), np.arange(17, 24)])
RATE = np.arange(9, 12)
"""Columns of a row for the error of the rate: the bias, and what is beyond the gyro's range."""


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A part of the map, put in over one interval of time.

    Its error is the mean of those of the poses by which its points were put in: the shift of the
    map at ``about_w``, m, and its rotation, rad, both in w.
    """

    number: int
    stamp: float
    """At its beginning, s, lidar clock."""
    about_w: Array
    scans: int = 0
    """That were put in."""
    time: float = 0.0
    """Mean of theirs, s since the first scan of the map."""


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """The state of least cost."""

    state: State
    P: Array
    sums: Sums | None
    """At the last evaluation; None: no point was matched."""
    evaluations: int


def correct(
    prior: State,
    P: Array,
    rows: Callable[[State, Array, dict[int, Known]], Sums | None],
    anchors: Sequence[Anchor],
    iterations: int,
    *,
    is_mounting_held: bool = False,
) -> Update:
    """Find the state of least cost from a prior and the covariance of its error state.

    A mounting and a delay that are held are considered, as anchors are, and not corrected.
    """
    x, sums = prior, None
    known = _known(prior, P, anchors)
    has_excess = bool(P[EXCESS, EXCESS].any())
    L = np.sqrt(np.maximum(np.diagonal(P)[:N], 1e-24))
    held = np.arange(N)[CALIBRATION if is_mounting_held else slice(0)]
    kept = np.concatenate([held, np.arange(N, len(P))])
    for iteration in range(1, iterations + 1):
        sums = rows(x, P[:N, :N], known)
        if sums is None:
            return Update(prior, P, None, iteration)
        e = x.minus(prior)
        G = reset_matrix(x, prior)
        P_here = P if G is None else _reset(P, G)
        if G is not None:
            e = G @ e
        seen, A, b = assemble(sums, anchors, x, has_excess=has_excess)
        full = np.zeros(len(P))
        full[:N] = e
        S = np.eye(len(seen)) + A @ P_here[np.ix_(seen, seen)]
        gained = P_here[:N, seen] @ np.linalg.solve(S, b + A @ full[seen])
        open_w = sums.match.open_w
        if open_w.shape[1]:
            gained = _without(open_w, gained)
        dx = gained - e
        dx[held] = 0.0
        after = x.plus(dx)
        is_last = iteration == iterations or bool((np.abs(dx) <= SETTLED * L).all())
        if is_last:
            K = np.linalg.solve(S, A @ P_here[seen])
            less = P_here[:, seen] @ K
            if open_w.shape[1]:
                less[:N] = _without(open_w, less[:N])
                part = less[:N].copy()
                part[held] = 0.0
                P_after = P_here.copy()
                P_after[:N] -= part
                P_after[:, :N] -= part.T
                square = _without(open_w, part[:, :N].T)
                square[held] = 0.0
                P_after[:N, :N] += square.T
            else:
                P_after = P_here - less
            P_after[np.ix_(kept, kept)] = P_here[np.ix_(kept, kept)]
            G = reset_matrix(after, x)
            if G is not None:
                P_after = _reset(P_after, G)
            return Update(after, 0.5 * (P_after + P_after.T), sums, iteration)
        x = after
    raise AssertionError("no iterations")


def _known(x: State, P: Array, anchors: Sequence[Anchor]) -> dict[int, Known]:
    """Return what is known of each anchor."""
    count = len(anchors)
    if not count:
        return {}
    T = -moved_to(x.pos_w - np.array([one.about_w for one in anchors]))[:, :3]
    across = P[POS, first(0) :].reshape(3, count, POSE).transpose(1, 0, 2)
    blocks = P[first(0) :, first(0) :].reshape(count, POSE, count, POSE)
    own = blocks[np.arange(count), :, np.arange(count)]
    mixed = across @ T.transpose(0, 2, 1)
    made = P[POS, POS] + mixed + mixed.transpose(0, 2, 1) + T @ own @ T.transpose(0, 2, 1)
    return {one.number: Known(made[k], one.time) for k, one in enumerate(anchors)}


def at_place(x: State, P: Array, anchors: Sequence[Anchor], place: Place) -> Array:
    """Return the covariance of a state that was put to a place in the map, which is as it was."""
    H = np.zeros((POSE, len(P)))
    H[:, :POSE] = np.eye(POSE)
    for k, one in enumerate(anchors):
        if one.number == place.owner:
            T = -moved_to((x.pos_w - one.about_w)[None])[0]
            H[ATT, first(k) : first(k + 1)] = x.C_wb.T @ T[3:]
            H[POS, first(k) : first(k + 1)] = T[:3]
    PH = P @ H.T
    after = P - PH @ np.linalg.solve(H @ PH + place.P, PH.T)
    after[N:, N:] = P[N:, N:]
    return np.asarray(0.5 * (after + after.T))


def assemble(
    sums: Sums, anchors: Sequence[Anchor], x: State, *, has_excess: bool
) -> tuple[Indices, Array, Array]:
    """Return the error states that the rows depend on, and the normal equations in them."""
    m = sums.columns
    place = {anchor.number: k for k, anchor in enumerate(anchors)}
    tied = [g for g, owner in enumerate(sums.owners.tolist()) if owner in place]
    which = [place[owner] for owner in sums.owners[tied].tolist()]
    size, its, scan = m + POSE * len(tied), slice(m, m + POSE), slice(m + POSE, None)
    seen = np.empty(size, dtype=np.int64)
    seen[:m] = SEEN if m == len(SEEN) else SEEN_WITH_MOUNTING
    A, b = np.zeros((size, size)), np.zeros(size)
    A[:m, :m], b[:m] = sums.A[:, :m, :m].sum(axis=0), sums.b[:, :m].sum(axis=0)
    # What all rows of a scan share: K' of the sums that move it as a whole
    K = np.zeros((size, POSE))
    K[:m] = sums.A[:, :m, scan].sum(axis=0)
    D, d = sums.A[:, scan, scan].sum(axis=0), sums.b[:, scan].sum(axis=0)
    if tied:
        T = -moved_to(x.pos_w - np.array([anchors[k].about_w for k in which]))
        back = T.transpose(0, 2, 1)
        across = sums.A[tied, :m, its] @ T
        own = back @ sums.A[tied, its, its] @ T
        A[:m, m:] = across.transpose(1, 0, 2).reshape(m, -1)
        A[m:, :m] = A[:m, m:].T
        b[m:] = np.einsum("gij,gi->gj", T, sums.b[tied, its]).ravel()
        K[m:] = (back @ sums.A[tied, its, scan]).reshape(-1, POSE)
        at = np.arange(len(which))
        A[m:, m:].reshape(len(which), POSE, len(which), POSE)[at, :, at] = own
        seen[m:] = (first(0) + POSE * np.array(which)[:, None] + np.arange(POSE)).ravel()
    # That error is unknown and taken out (Woodbury)
    L = np.linalg.solve(np.diag(1.0 / sums.common) + D, np.column_stack([K.T, d]))
    A, b = np.asarray(A - K @ L[:, :-1]), np.asarray(b - K @ L[:, -1])
    if not has_excess:
        return seen, A, b
    again = np.concatenate([np.arange(size), RATE])
    return np.concatenate([seen, np.arange(N)[EXCESS]]), A[np.ix_(again, again)], b[again]


def _without(open_w: Array, dx: Array) -> Array:
    """Return corrections without those of what has no hold, shape (27, ...).

    These are position and velocity along the open directions; and gravity and accelerometer bias,
    which show in motion along them, and otherwise only by what the planes' errors feign.
    """
    kept = dx.copy()
    for block in (POS, VEL):
        kept[block] -= open_w @ (open_w.T @ dx[block])
    kept[ACCEL_BIAS] = kept[DOWN] = 0.0
    return np.asarray(kept)


def first(k: int) -> int:
    """Return the first error state of an anchor: before it are the state and one past pose."""
    return N + POSE * (k + 1)


def moved_to(lever_w: Array) -> Array:
    """Return the derivative of shift and rotation at the end of levers by those at their start.

    Levers have the shape (g, 3); returned are (g, 6, 6).
    """
    T = np.tile(np.eye(POSE), (len(lever_w), 1, 1))
    # Rows lever x e: minus the matrix of the cross product
    T[:, :3, 3:] = np.cross(lever_w[:, None], np.eye(3))
    return T


def shift_by_state(x: State, about_w: Array, rate_b: Array) -> Array:
    """Return the derivative of shift and rotation of a scan at a point, in w, (6, 27).

    A scan that is put into the map by a wrong pose is moved as a rigid body; so is one that is put
    in by a wrong mounting, or by a late pose.
    """
    T = np.zeros((POSE, N))
    lidar_w = x.pos_w + x.C_wb @ x.pos_b
    T[:3, POS] = np.eye(3)
    T[:3, MOUNT_POS] = x.C_wb
    for block, C, pivot in (
        (ATT, x.C_wb, x.pos_w),
        (MOUNT_ATT, x.C_wb @ x.C_bl, lidar_w),
    ):
        T[:3, block] = -skew(about_w - pivot) @ C
        T[3:, block] = C
    T[3:, DELAY] = x.C_wb @ rate_b
    T[:3, DELAY] = x.vel_w + so3.cross(T[3:, DELAY], about_w - x.pos_w)
    return T


def _reset(P: Array, G: Array) -> Array:
    """Return the covariance of an error state whose first part is about another state."""
    made = P.copy()
    made[:N] = G @ made[:N]
    made[:, :N] = made[:, :N] @ G.T
    return np.asarray(made)


def reset_matrix(x: State, prior: State) -> Array | None:
    """Return the derivative of the error state about x by that about the prior, (27, 27).

    None: identity.
    """
    turn = x.C_wb - prior.C_wb
    if not turn.any() and not (x.down_w - prior.down_w).any():
        return None
    G = np.eye(N)
    J = so3.right_jacobian_inverse(log(prior.C_wb.T @ x.C_wb))
    G[ATT, ATT] = np.linalg.inv(J)
    J = so3.right_jacobian_inverse(log(prior.C_bl.T @ x.C_bl))
    G[MOUNT_ATT, MOUNT_ATT] = np.linalg.inv(J)
    G[DOWN, DOWN] = np.linalg.inv(direction_jacobian(x.down_w, prior.down_w))
    return G
