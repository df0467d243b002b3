"""What each autopilot does with an ODOMETRY message: does it accept it, what does it fuse, why not.

The rules of the receivers and of the filters behind them, as pure functions of a message, the
autopilot's parameters and the messages before: an oracle for tests, and an answer to why nothing
is fused. Innovation gates are left out: they depend on the flight, not on the message.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import JUNK, Splitter
from ekf_companion.mavlink.messages import LAYOUTS
from sim_autopilot import ardupilot_receiver, px4_receiver
from sim_autopilot.judgement import History, Judgement, Quantity, Stack

__all__ = ["DEFAULTS", "History", "Judgement", "Quantity", "Stack", "judge", "would_accept"]

_PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
_SOURCES = ((3, 3, 1, 3, 1), (0, 0, 1, 0, 0), (0, 0, 1, 0, 0))
"""Of each of ArduPilot's three sets: 3 GNSS, 1 barometer or compass, 0 none."""
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
                **{
                    f"EK3_SRC{number}_{part}": source
                    for number, sources in enumerate(_SOURCES, 1)
                    for part, source in zip(_PARTS, sources, strict=True)
                },
            }
        ),
    }
)
"""The parameters that matter, with the firmware's defaults; ``judge`` may override them."""


def judge(
    stack: Stack,
    message: Any,
    parameters: Mapping[str, float] | None = None,
    history: History | None = None,
    *,
    source_set: int = 1,
) -> Judgement:
    """Return what an autopilot does with a message.

    Args:
        stack: Which autopilot.
        message: Fields of an ODOMETRY, named as in the definitions.
        parameters: The autopilot's; the others have the firmware's defaults.
        history: From the judgement of the message before; None: this is the first.
        source_set: Of ArduPilot, the one that the pilot has switched to, 1 to 3.
    """
    values = {**DEFAULTS[stack], **(parameters or {})}
    before = history or History()
    if stack is Stack.ARDUPILOT:
        return ardupilot_receiver.judge(message, values, before, source_set)
    return px4_receiver.judge(message, values, before, is_old=stack is Stack.PX4_OLD)


def would_accept(
    data: bytes,
    stack: Stack | str,
    parameters: Mapping[str, float] | None = None,
    *,
    source_set: int = 1,
) -> Judgement:
    """Judge the last of the ODOMETRY frames in some bytes, with all before it as its history.

    Pass two or more of a stream: PX4 fuses none before it has seen two.

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
