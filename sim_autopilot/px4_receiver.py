"""What PX4 does with an ODOMETRY message.

Sources, for their behaviour: ``mavlink_receiver.cpp``, ``EKF2.cpp`` and
``EKF/aid_sources/external_vision``, 1.14 and later; 1.11 to 1.13 if ``is_old``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sim_autopilot.judgement import NOTHING, History, Judgement, Quantity, judged, refused

_TAKEN_TYPES = (0, 1, 2, 3)
_MOCAP = 6
_NED, _ENU, _FRD, _FLU = 1, 4, 20, 21
_POSE_FRAMES = (_NED, _ENU, _FRD, _FLU)
_TWIST_FRAMES = (*_POSE_FRAMES, 8, 9, 12)
_BODY_FRD = 12
_UNIT = 1e-5
"""Largest difference of the quaternion's norm from one."""
_EV_INTERVAL_US = 200_000
"""Largest interval of two samples for fusion to begin."""
ENDS_US = 2 * _EV_INTERVAL_US
"""Fusion ends so long after the last message."""
_EV_BITS = {
    1: {Quantity.POSITION},
    2: {Quantity.HEIGHT},
    4: {Quantity.VELOCITY, Quantity.CLIMB},
    8: {Quantity.YAW},
}
_AID_BITS = {8: {Quantity.POSITION}, 16: {Quantity.YAW}, 256: {Quantity.VELOCITY, Quantity.CLIMB}}
_VISION = 3
"""EKF2_HGT_MODE."""


def judge(m: Any, values: Mapping[str, float], before: History, *, is_old: bool) -> Judgement:
    """Return what it does with a message; ``values`` has all parameters."""
    if (refusal := _refusal(m, before, is_old=is_old)) is not None:
        return refusal
    wanted, has_gnss = _aided_by_vision(values, is_old=is_old)
    offered, lacks = _offered(m, _TWIST_FRAMES if not is_old else (_BODY_FRD,))
    reasons = list(lacks)
    if not wanted:
        name = "EKF2_AID_MASK" if is_old else "EKF2_EV_CTRL"
        reasons.append(f"{name} fuses nothing of it")
    # Beside GNSS a yaw counts only from a frame that is aligned with north
    if Quantity.YAW in wanted and has_gnss and m.frame_id not in (_NED, _ENU) and not is_old:
        offered -= {Quantity.YAW}
        reasons.append("beside GNSS, yaw is fused from LOCAL_NED only")

    least = 0 if is_old else values["EKF2_EV_QMIN"]
    return _in_time(m, wanted & offered, reasons, before, least)


def judge_position(m: Any, values: Mapping[str, float]) -> str:
    """Return what PX4 1.18 does with a GLOBAL_POSITION_SENSOR: why it is not fused; empty: it is.

    A slot is bound to the sensor's id (EKF2_AGPn_ID, 0: to none), and fuses latitude and longitude.

    Source: ``mavlink_receiver.cpp``, ``aux_global_position.cpp``,
    ``aux_global_position_control.cpp``.
    """
    for slot in range(4):
        bound = values.get(f"EKF2_AGP{slot}_ID", 0)
        if bound and bound == m.id:
            control = f"EKF2_AGP{slot}_CTRL"
            return "" if values.get(control, 0) else f"{control} is 0"
    return f"no EKF2_AGPn_ID is {m.id}"


def _in_time(
    m: Any, usable: frozenset[Quantity], reasons: list[str], before: History, least: float
) -> Judgement:
    """Return what is fused of the usable parts, by quality and the time since the last message."""
    is_good = least <= 0 or m.quality >= least
    if not is_good:
        reasons.append(f"quality {m.quality} is below EKF2_EV_QMIN {least:g}")
    if before.time_us is None:
        reasons.append("it is the first: fusion begins with the second")
        return judged(reasons, NOTHING, _remember(m, before, NOTHING, is_good=is_good))
    gap = m.time_usec - before.time_us
    if gap <= 0:
        reasons.append("its stamp is not later than the one before")
        return judged(reasons, NOTHING, before)
    running = before.fused if gap <= ENDS_US else NOTHING
    may_begin = gap < _EV_INTERVAL_US and (least <= 0 or before.quality >= least)
    if not may_begin and not running:
        reasons.append(f"{gap / 1000:.0f} ms after the one before: fusion begins below 200 ms")
    continued = usable if may_begin else usable & running
    fused = continued if is_good else NOTHING
    is_reset = m.reset_counter != before.reset_counter and bool(fused)
    history = _remember(m, before, fused if is_good else running, is_good=is_good)
    return judged(reasons, fused, history, is_reset=is_reset)


def _remember(m: Any, before: History, fused: frozenset[Quantity], *, is_good: bool) -> History:
    """Return the history after a message; a poor one only updates what is fused."""
    if is_good:
        return History(m.time_usec, m.quality, m.reset_counter, fused)
    return replace(before, fused=fused)


def _refusal(m: Any, before: History, *, is_old: bool) -> Judgement | None:
    """Return the refusal of the receiver, before any filter; None: it is passed on."""
    kind = m.estimator_type
    if kind == _MOCAP:
        return judged(["motion capture goes to nobody: EKF2 does not read it"], NOTHING, before)
    if kind not in _TAKEN_TYPES or (is_old and kind == 1):
        text = "" if is_old else f"ODOMETRY: estimator_type {kind} unsupported"
        return refused(f"estimator_type {kind} is refused", before, text)
    if is_old and m.frame_id not in (_NED, _FRD):
        return refused(f"frame_id {m.frame_id} is not LOCAL_NED or LOCAL_FRD", before)
    return None


def _aided_by_vision(
    values: Mapping[str, float], *, is_old: bool
) -> tuple[frozenset[Quantity], bool]:
    """Return the parts that the parameters enable, and whether GNSS positions are fused."""
    bits = int(values["EKF2_AID_MASK" if is_old else "EKF2_EV_CTRL"])
    parts = _AID_BITS if is_old else _EV_BITS
    wanted = frozenset().union(*(part for bit, part in parts.items() if bits & bit))
    if not is_old:
        return wanted, bool(int(values["EKF2_GPS_CTRL"]) & 1)
    # Without one of its bits set, the old filter reads no vision at all, not for the height either
    if wanted and values["EKF2_HGT_MODE"] == _VISION:
        wanted |= {Quantity.HEIGHT}
    return wanted, bool(bits & 1)


def _offered(m: Any, twist_frames: tuple[int, ...]) -> tuple[frozenset[Quantity], list[str]]:
    """Return the parts that the message holds, and why the others are missing."""
    parts: frozenset[Quantity] = NOTHING
    lacks = []
    if not all(map(math.isfinite, (m.x, m.y, m.z))):
        lacks.append("the position is not finite")
    elif m.frame_id not in _POSE_FRAMES:
        lacks.append(f"frame_id {m.frame_id} is none that it knows: no position")
    else:
        parts |= {Quantity.POSITION, Quantity.HEIGHT}
    if not all(map(math.isfinite, (m.vx, m.vy, m.vz))):
        lacks.append("the velocity is not finite")
    elif m.child_frame_id not in twist_frames:
        lacks.append(f"child_frame_id {m.child_frame_id} is none that it knows: no velocity")
    else:
        parts |= {Quantity.VELOCITY, Quantity.CLIMB}
    if not all(map(math.isfinite, m.q)):
        lacks.append("the attitude is not finite")
    elif abs(1.0 - math.sqrt(sum(v * v for v in m.q))) > _UNIT:
        lacks.append("the attitude's norm is further than 1e-5 from one")
    else:
        parts |= {Quantity.YAW}
    return parts, lacks
