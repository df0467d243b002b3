"""What each autopilot does with an ODOMETRY message: would it take it, what would it fuse, why not.

Rules of the receivers and of the filters behind them, as pure functions over a message, the
autopilot's parameters and what came before: an oracle for tests, and for whoever wonders why
nothing is fused. Innovation gates are left out: they depend on the flight, not on the message.

Sources, for their behaviour: PX4 ``mavlink_receiver.cpp``, ``EKF2.cpp`` and
``EKF/aid_sources/external_vision`` (1.14 and later; ``px4-old``: 1.11 to 1.13); ArduPilot
``GCS_Common.cpp``, ``AP_VisualOdom``, ``AP_NavEKF_Source.cpp`` and ``AP_NavEKF3`` (4.5 and later).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import JUNK, Splitter
from ekf_companion.mavlink.layout import LAYOUTS


class Stack(str, Enum):
    """Whose rules apply."""

    PX4 = "px4"
    """1.14 and later: EKF2_EV_CTRL decides."""
    PX4_OLD = "px4-old"
    """1.11 to 1.13: EKF2_AID_MASK decides."""
    ARDUPILOT = "ardupilot"
    """4.5 and later."""


class Quantity(str, Enum):
    """A part of the message that a filter can fuse."""

    POSITION = "position"
    """Horizontal."""
    HEIGHT = "height"
    VELOCITY = "velocity"
    """Horizontal."""
    CLIMB = "climb"
    """Vertical velocity."""
    YAW = "yaw"


Q = Quantity
NOTHING: frozenset[Quantity] = frozenset()
DEFAULTS: Mapping[Stack, Mapping[str, float]] = MappingProxyType(
    {
        Stack.PX4: MappingProxyType(
            {"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7, "EKF2_EV_QMIN": 0, "EKF2_HGT_REF": 1}
        ),
        Stack.PX4_OLD: MappingProxyType({"EKF2_AID_MASK": 1, "EKF2_HGT_MODE": 0}),
        Stack.ARDUPILOT: MappingProxyType(
            {
                "VISO_TYPE": 0,
                "VISO_QUAL_MIN": 0,
                "VISO_POS_M_NSE": 0.2,
                "VISO_YAW_M_NSE": 0.2,
                "EK3_ENABLE": 1,
                "AHRS_EKF_TYPE": 3,
                "EK3_SRC_OPTIONS": 1,
                **{"EK3_SRC1_POSXY": 3, "EK3_SRC1_VELXY": 3, "EK3_SRC1_POSZ": 1},
                **{"EK3_SRC1_VELZ": 3, "EK3_SRC1_YAW": 1},
                **{"EK3_SRC2_POSXY": 0, "EK3_SRC2_VELXY": 0, "EK3_SRC2_POSZ": 1},
                **{"EK3_SRC2_VELZ": 0, "EK3_SRC2_YAW": 0},
                **{"EK3_SRC3_POSXY": 0, "EK3_SRC3_VELXY": 0, "EK3_SRC3_POSZ": 1},
                **{"EK3_SRC3_VELZ": 0, "EK3_SRC3_YAW": 0},
            }
        ),
    }
)
"""The parameters that count, as the firmware sets them; those given to ``judge`` go before."""


@dataclass(frozen=True, slots=True)
class History:
    """What of the messages before is remembered; the first has ``History()``."""

    time_us: int | None = None
    """Stamp of the last one whose quality sufficed (PX4), or that was written (ArduPilot)."""
    quality: int = 0
    """Of the last one whose quality sufficed."""
    reset_counter: int = 0
    fused: frozenset[Quantity] = NOTHING
    """What was being fused."""
    ignored_until_us: int = 0
    """A T265 is not believed for a second after a reset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What becomes of one message."""

    is_accepted: bool
    """Whether the receiver hands it to the filter."""
    fused: frozenset[Quantity]
    """What the filter fuses of it, if it passes the gates."""
    reason: str
    """Why nothing, or not all, of it is fused; empty: all of it is."""
    text: str = ""
    """A critical STATUSTEXT that the pilot sees; empty: none."""
    is_reset: bool = False
    """Whether the filter moves to it at once, since its reset counter changed."""
    std_position: float = math.nan
    """One sigma that ArduPilot weighs the position by, m; NaN: not written."""
    std_yaw: float = math.nan
    """Likewise of the yaw, rad."""
    history: History
    """For the next message."""


def judge(
    stack: Stack,
    message: Any,
    parameters: Mapping[str, float] | None = None,
    history: History | None = None,
    *,
    source_set: int = 1,
) -> Judgement:
    """Say what an autopilot does with a message.

    Args:
        stack: Which autopilot.
        message: Fields of an ODOMETRY, named as in the definitions.
        parameters: The autopilot's; those not named are at the firmware's default.
        history: From the judgement of the message before; None: this is the first.
        source_set: Of ArduPilot, the one that the pilot has switched to, 1 to 3.
    """
    values = {**DEFAULTS[stack], **(parameters or {})}
    before = history or History()
    if stack is Stack.ARDUPILOT:
        return _ardupilot(message, values, before, source_set)
    return _px4(message, values, before, is_old=stack is Stack.PX4_OLD)


def would_accept(
    data: bytes,
    stack: Stack | str,
    parameters: Mapping[str, float] | None = None,
    *,
    source_set: int = 1,
) -> Judgement:
    """Judge the last of the ODOMETRY frames in some bytes, with all before it as its history.

    Give two or more of a stream: PX4 fuses none before it has seen two.

    Raises:
        ValueError: There is no ODOMETRY in the bytes.
    """
    judgement: Judgement | None = None
    for frame in Splitter().feed(data):
        if frame.message_id != JUNK and LAYOUTS[frame.message_id].name == "ODOMETRY":
            before = judgement.history if judgement is not None else None
            judgement = judge(
                Stack(stack), unpack(frame), parameters, before, source_set=source_set
            )
    if judgement is None:
        raise ValueError("no ODOMETRY in these bytes; give whole frames of MAVLink 2")
    return judgement


# PX4

_TAKEN_TYPES = (0, 1, 2, 3)
_MOCAP = 6
_NED, _ENU, _FRD, _FLU = 1, 4, 20, 21
_POSE_FRAMES = (_NED, _ENU, _FRD, _FLU)
_TWIST_FRAMES = (*_POSE_FRAMES, 8, 9, 12)
_BODY_FRD = 12
_UNIT = 1e-5
"""How far from one the quaternion's norm may be."""
_EV_INTERVAL_US = 200_000
"""So close must two samples be for fusion to begin; it ends after twice that."""
_EV_BITS = {1: {Q.POSITION}, 2: {Q.HEIGHT}, 4: {Q.VELOCITY, Q.CLIMB}, 8: {Q.YAW}}
_AID_BITS = {8: {Q.POSITION}, 16: {Q.YAW}, 256: {Q.VELOCITY, Q.CLIMB}}
_VISION = 3
"""EKF2_HGT_MODE."""


def _px4(m: Any, values: Mapping[str, float], before: History, *, is_old: bool) -> Judgement:
    if (refusal := _refuse_by_px4(m, before, is_old=is_old)) is not None:
        return refusal
    wanted, has_gnss = _aided_by_vision(values, is_old=is_old)
    offered, lacks = _offered(m, _TWIST_FRAMES if not is_old else (_BODY_FRD,))
    reasons = list(lacks)
    if not wanted:
        name = "EKF2_AID_MASK" if is_old else "EKF2_EV_CTRL"
        reasons.append(f"{name} fuses nothing of it")
    # Beside GNSS a yaw counts only from a frame that is aligned with north
    if Q.YAW in wanted and has_gnss and m.frame_id not in (_NED, _ENU) and not is_old:
        offered -= {Q.YAW}
        reasons.append("beside GNSS, yaw is fused from LOCAL_NED only")

    least = 0 if is_old else values["EKF2_EV_QMIN"]
    is_good = least <= 0 or m.quality >= least
    if not is_good:
        reasons.append(f"quality {m.quality} is below EKF2_EV_QMIN {least:g}")
    is_first = before.time_us is None
    gap = _EV_INTERVAL_US if before.time_us is None else m.time_usec - before.time_us
    if not is_first and gap <= 0:
        reasons.append("its stamp is not later than the one before")
        return _judged(reasons, NOTHING, before)
    running = before.fused if gap <= 2 * _EV_INTERVAL_US else NOTHING
    may_begin = gap < _EV_INTERVAL_US and (least <= 0 or before.quality >= least)
    if not may_begin and not running:
        reasons.append(
            "it is the first"
            if is_first
            else f"{gap / 1000:.0f} ms after the one before: fusion begins below 200 ms"
        )
    usable = wanted & offered
    fused = (usable if may_begin else usable & running) if is_good else NOTHING
    history = (
        History(m.time_usec, m.quality, m.reset_counter, fused)
        if is_good
        else replace(before, fused=running)
    )
    is_reset = not is_first and m.reset_counter != before.reset_counter and bool(fused)
    return _judged(reasons, fused, history, is_reset=is_reset)


def _refuse_by_px4(m: Any, before: History, *, is_old: bool) -> Judgement | None:
    """Say what the receiver refuses, before any filter sees it."""
    kind = m.estimator_type
    if kind == _MOCAP:
        return _judged(["motion capture goes to nobody: EKF2 does not read it"], NOTHING, before)
    if kind not in _TAKEN_TYPES or (is_old and kind == 1):
        text = "" if is_old else f"ODOMETRY: estimator_type {kind} unsupported"
        return _refused(f"estimator_type {kind} is refused", before, text)
    if is_old and m.frame_id not in (_NED, _FRD):
        return _refused(f"frame_id {m.frame_id} is not LOCAL_NED or LOCAL_FRD", before)
    return None


def _aided_by_vision(
    values: Mapping[str, float], *, is_old: bool
) -> tuple[frozenset[Quantity], bool]:
    """Give what of the message the parameters ask for, and whether GNSS positions are fused."""
    if not is_old:
        bits = int(values["EKF2_EV_CTRL"])
        wanted = frozenset().union(*(q for bit, q in _EV_BITS.items() if bits & bit))
        return wanted, bool(int(values["EKF2_GPS_CTRL"]) & 1)
    bits = int(values["EKF2_AID_MASK"])
    wanted = frozenset().union(*(q for bit, q in _AID_BITS.items() if bits & bit))
    # Without one of its bits set, the old filter reads no vision at all, not for the height either
    if wanted and values["EKF2_HGT_MODE"] == _VISION:
        wanted |= {Q.HEIGHT}
    return wanted, bool(bits & 1)


def _offered(m: Any, twist_frames: tuple[int, ...]) -> tuple[frozenset[Quantity], list[str]]:
    """Give the parts that the message holds, and why the others are lacking."""
    parts: frozenset[Quantity] = NOTHING
    lacks = []
    if not all(map(math.isfinite, (m.x, m.y, m.z))):
        lacks.append("the position is not finite")
    elif m.frame_id not in _POSE_FRAMES:
        lacks.append(f"frame_id {m.frame_id} is none that it knows: no position")
    else:
        parts |= {Q.POSITION, Q.HEIGHT}
    if not all(map(math.isfinite, (m.vx, m.vy, m.vz))):
        lacks.append("the velocity is not finite")
    elif m.child_frame_id not in twist_frames:
        lacks.append(f"child_frame_id {m.child_frame_id} is none that it knows: no velocity")
    else:
        parts |= {Q.VELOCITY, Q.CLIMB}
    if not all(map(math.isfinite, m.q)):
        lacks.append("the attitude is not finite")
    elif abs(1.0 - math.sqrt(sum(v * v for v in m.q))) > _UNIT:
        lacks.append("the attitude's norm is further than 1e-5 from one")
    else:
        parts |= {Q.YAW}
    return parts, lacks


# ArduPilot

_DRIVERS = (1, 2, 3)
_T265 = 2
_INTERVAL_MS = 20
_RESET_US = 1_000_000
_EXTERNAL = 6
_ALL_VELOCITIES = 1
_SOURCES = {
    "POSXY": Q.POSITION,
    "POSZ": Q.HEIGHT,
    "VELXY": Q.VELOCITY,
    "VELZ": Q.CLIMB,
    "YAW": Q.YAW,
}
_STD_POSITION_LARGEST, _STD_YAW_LARGEST = 100.0, 1.5


def _ardupilot(m: Any, values: Mapping[str, float], before: History, source_set: int) -> Judgement:
    if (m.frame_id, m.child_frame_id) != (_FRD, _BODY_FRD):
        pair = f"{m.frame_id}/{m.child_frame_id}"
        return _refused(f"frames {pair} are not LOCAL_FRD/BODY_FRD (20/12): ignored", before)
    if values["VISO_TYPE"] not in _DRIVERS:
        return _refused(f"VISO_TYPE is {values['VISO_TYPE']:g}: nobody takes it", before)

    is_other = before.time_us is not None and m.reset_counter != before.reset_counter
    after = replace(before, reset_counter=m.reset_counter)
    if is_other and values["VISO_TYPE"] == _T265:
        after = replace(after, ignored_until_us=m.time_usec + _RESET_US)
    if m.time_usec < after.ignored_until_us:
        return _judged(["a T265 is not believed for a second after a reset"], NOTHING, after)
    if m.quality < values["VISO_QUAL_MIN"]:
        least = values["VISO_QUAL_MIN"]
        return _judged([f"quality {m.quality} is below VISO_QUAL_MIN {least:g}"], NOTHING, after)
    if not all(map(math.isfinite, (m.x, m.y, m.z))):
        return _judged(["the position is not finite"], NOTHING, after)
    now_ms = m.time_usec // 1000
    if before.time_us is not None and (now_ms - before.time_us // 1000) % 2**32 < _INTERVAL_MS:
        return _judged(["less than 20 ms after the one before: thrown away"], NOTHING, after)

    fused = _aided_by_external(values, source_set)
    reasons = []
    if not fused:
        reasons.append(f"no EK3_SRC{source_set}_* is 6 (ExternalNav)")
    if not all(map(math.isfinite, (m.vx, m.vy, m.vz, *m.q))):
        fused -= {Q.VELOCITY, Q.CLIMB}
        reasons.append("the velocity is not finite")
    if not values["EK3_ENABLE"]:
        fused, reasons = NOTHING, ["EK3_ENABLE is 0: the EKF3 does not run"]
    elif values["AHRS_EKF_TYPE"] != 3:
        reasons.append("AHRS_EKF_TYPE is not 3: it does not fly on the EKF3")
    std_position, std_yaw = standard_deviations(m, values)
    return _judged(
        reasons,
        fused,
        History(
            m.time_usec,
            m.quality,
            m.reset_counter,
            fused,
            after.ignored_until_us,
        ),
        is_reset=is_other and bool(fused),
        std_position=std_position,
        std_yaw=std_yaw,
    )


def _aided_by_external(values: Mapping[str, float], source_set: int) -> frozenset[Quantity]:
    """Give what the source set in use takes from external navigation, velocities of all if asked.

    EK3_SRC_OPTIONS bit 0, set by default, fuses the velocities of every set whichever is in use.
    """
    taken = {
        quantity
        for part, quantity in _SOURCES.items()
        if values[f"EK3_SRC{source_set}_{part}"] == _EXTERNAL
    }
    if int(values["EK3_SRC_OPTIONS"]) & _ALL_VELOCITIES:
        for k in (1, 2, 3):
            taken |= {
                _SOURCES[part]
                for part in ("VELXY", "VELZ")
                if values[f"EK3_SRC{k}_{part}"] == _EXTERNAL
            }
    return frozenset(taken)


def standard_deviations(m: Any, values: Mapping[str, float]) -> tuple[float, float]:
    """Give one sigma of position (m) and yaw (rad) as ArduPilot makes them of the covariance.

    The cube root of the sum of the squared variances: neither a variance nor a deviation, held
    within [VISO_POS_M_NSE, 100] and [VISO_YAW_M_NSE, 1.5]. A first element that is NaN gives the
    lower bounds.
    """
    c = m.pose_covariance
    position = yaw = 0.0
    if not math.isnan(c[0]):
        position = (c[0] ** 2 + c[6] ** 2 + c[11] ** 2) ** (1 / 3)
        yaw = (c[15] ** 2 + c[18] ** 2 + c[20] ** 2) ** (1 / 3)
    return (
        min(max(position, values["VISO_POS_M_NSE"]), _STD_POSITION_LARGEST),
        min(max(yaw, values["VISO_YAW_M_NSE"]), _STD_YAW_LARGEST),
    )


def _refused(reason: str, history: History, text: str = "") -> Judgement:
    return Judgement(is_accepted=False, fused=NOTHING, reason=reason, text=text, history=history)


def _judged(
    reasons: list[str], fused: frozenset[Quantity], history: History, **more: Any
) -> Judgement:
    return Judgement(
        is_accepted=True, fused=fused, reason="; ".join(reasons), history=history, **more
    )
