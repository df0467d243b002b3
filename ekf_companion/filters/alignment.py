"""Initial alignment: each filter starts from the state of the main estimator at its start.

So the filters differ in how they filter, not in how they start. What counts as rest, how old a
heading may be and the initial covariance are decided in :mod:`ekf_companion.core` alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.core.memory.enums import E_ATT, E_BA, E_BG, E_POS, E_VEL, Arrival, Mode
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.order.timeline import Timeline
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.strapdown import ATT, BA, BG, POS, VEL, N, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind

_BLOCKS = {E_ATT: ATT, E_VEL: VEL, E_POS: POS, E_BG: BG, E_BA: BA}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InitialEstimate:
    """The first estimate."""

    t_ns: int
    """Stamp of an inertial sample."""
    state: Nominal
    P: Array
    """Covariance of the error state, shape (15, 15)."""


def align(
    events: Events, frame: LocalFrame, settings: FilterSettings, family: str = "unknown"
) -> InitialEstimate:
    """Return the main estimator's state at the first sample after it has begun to navigate.

    Events are complete, in order of their time of validity; positions are metres of the frame.

    Raises:
        LogError: The recording ends before that, or right there.
    """
    in_time = np.zeros(len(Kind), dtype=np.int64)
    timeline = Timeline(parameters(settings, family), in_time, round(settings.window * 1e9))
    last_ns = int(events.t_ns[events.kind == Kind.IMU][-1])
    for t_ns, kind, values in zip(
        events.t_ns.tolist(), events.kind.tolist(), events.values, strict=True
    ):
        if t_ns >= last_ns:
            break
        if timeline.insert(t_ns, kind, values) == Arrival.ESTIMATED:
            x = as_state(timeline.block())
            if x.mode == Mode.NAVIGATE and x.needs_reset == 0.0:
                return _initial(t_ns, x, frame)
    raise LogError(
        "the recording ends before level, north and position are known: a fix and a heading at "
        f"rest, or {settings.align.time:g} s (align.time) of both in motion, are needed, and more "
        "samples after them"
    )


def _initial(t_ns: int, x: Any, frame: LocalFrame) -> InitialEstimate:
    """Return the estimator's state as that of the filters."""
    here = LocalFrame(x.origin.lat, x.origin.lon, x.origin.alt)
    state = Nominal(
        q_nb=so3.normalise(np.array(x.q_nb)),
        vel_n=np.array(x.vel_n),
        pos_n=frame.to_ned(*here.to_geodetic(np.array(x.pos_n))),
        gyro_bias=np.array(x.gyro_bias),
        accel_bias=np.array(x.accel_bias),
    )
    # Its attitude error is in n, theirs in b
    T = np.zeros((N, len(x.P)))
    for first, block in _BLOCKS.items():
        T[block, first : first + 3] = np.eye(3)
    T[ATT, E_ATT : E_ATT + 3] = so3.to_matrix(state.q_nb).T
    return InitialEstimate(t_ns=t_ns, state=state, P=T @ np.array(x.P) @ T.T)
