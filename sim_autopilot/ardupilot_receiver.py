"""What ArduPilot, 4.5 and later, does with an ODOMETRY message.

Sources, for their behaviour: ``GCS_Common.cpp``, ``AP_VisualOdom``, ``AP_NavEKF_Source.cpp``,
``AP_NavEKF3``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sim_autopilot.judgement import NOTHING, History, Judgement, Quantity, judged, refused

_FRD, _BODY_FRD = 20, 12
_DRIVERS = (1, 2, 3)
_T265 = 2
_INTERVAL_MS = 20
_RESET_US = 1_000_000
_EXTERNAL = 6
_ALL_VELOCITIES = 1
_SOURCES = {
    "POSXY": Quantity.POSITION,
    "POSZ": Quantity.HEIGHT,
    "VELXY": Quantity.VELOCITY,
    "VELZ": Quantity.CLIMB,
    "YAW": Quantity.YAW,
}
_STD_POSITION_LARGEST, _STD_YAW_LARGEST = 100.0, 1.5


def judge(m: Any, values: Mapping[str, float], before: History, source_set: int) -> Judgement:
    """Return what it does with a message; ``values`` has all parameters."""
    if (m.frame_id, m.child_frame_id) != (_FRD, _BODY_FRD):
        pair = f"{m.frame_id}/{m.child_frame_id}"
        return refused(f"frames {pair} are not LOCAL_FRD/BODY_FRD (20/12): ignored", before)
    if values["VISO_TYPE"] not in _DRIVERS:
        return refused(f"VISO_TYPE is {values['VISO_TYPE']:g}: nobody takes it", before)

    is_other = before.time_us is not None and m.reset_counter != before.reset_counter
    after = replace(before, reset_counter=m.reset_counter)
    if is_other and values["VISO_TYPE"] == _T265:
        after = replace(after, ignored_until_us=m.time_usec + _RESET_US)
    if m.time_usec < after.ignored_until_us:
        return judged(["a T265 is ignored for a second after a reset"], NOTHING, after)
    if m.quality < values["VISO_QUAL_MIN"]:
        least = values["VISO_QUAL_MIN"]
        return judged([f"quality {m.quality} is below VISO_QUAL_MIN {least:g}"], NOTHING, after)
    if not all(map(math.isfinite, (m.x, m.y, m.z))):
        return judged(["the position is not finite"], NOTHING, after)
    now_ms = m.time_usec // 1000
    if before.time_us is not None and (now_ms - before.time_us // 1000) % 2**32 < _INTERVAL_MS:
        return judged(["less than 20 ms after the one before: thrown away"], NOTHING, after)

    return _written(m, values, before, after, source_set)


def _written(
    m: Any, values: Mapping[str, float], before: History, after: History, source_set: int
) -> Judgement:
    """Return what the filter fuses of a message that is written to it."""
    is_other = before.time_us is not None and m.reset_counter != before.reset_counter
    fused = _aided_by_external(values, source_set)
    reasons = []
    if not fused:
        reasons.append(f"no EK3_SRC{source_set}_* is 6 (ExternalNav)")
    if not all(map(math.isfinite, (m.vx, m.vy, m.vz, *m.q))):
        fused -= {Quantity.VELOCITY, Quantity.CLIMB}
        reasons.append("the velocity is not finite")
    if not values["EK3_ENABLE"]:
        fused, reasons = NOTHING, ["EK3_ENABLE is 0: the EKF3 does not run"]
    elif values["AHRS_EKF_TYPE"] != 3:
        reasons.append("AHRS_EKF_TYPE is not 3: it does not fly on the EKF3")
    std_position, std_yaw = standard_deviations(m, values)
    return judged(
        reasons,
        fused,
        replace(after, time_us=m.time_usec, quality=m.quality, fused=fused),
        is_reset=is_other and bool(fused),
        std_position=std_position,
        std_yaw=std_yaw,
    )


def _aided_by_external(values: Mapping[str, float], source_set: int) -> frozenset[Quantity]:
    """Return what the source set in use takes from external navigation.

    EK3_SRC_OPTIONS bit 0, set by default, fuses the velocities of every set whichever is in use.
    """
    parts = [(source_set, part) for part in _SOURCES]
    if int(values["EK3_SRC_OPTIONS"]) & _ALL_VELOCITIES:
        parts += [(number, part) for number in (1, 2, 3) for part in ("VELXY", "VELZ")]
    return frozenset(
        _SOURCES[part] for number, part in parts if values[f"EK3_SRC{number}_{part}"] == _EXTERNAL
    )


def standard_deviations(m: Any, values: Mapping[str, float]) -> tuple[float, float]:
    """Return one sigma of position (m) and yaw (rad) as ArduPilot computes them.

    The cube root of the sum of the squared variances: neither a variance nor a deviation, clipped
    to [VISO_POS_M_NSE, 100] and [VISO_YAW_M_NSE, 1.5]. A first element that is NaN means the
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
