"""Rules by which each autopilot accepts an ODOMETRY message, and which parts of it are fused.

The rules of the receivers and of the filters behind them, as pure functions of a message, the
autopilot's parameters and the messages before: an oracle for tests, and an answer to why nothing is
fused. Innovation gates are left out: they depend on the flight, not on the message.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from sim_autopilot import ardupilot_receiver, px4_receiver
from sim_autopilot.judgement import History, Judgement, Quantity, Stack

_PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
_SOURCES = ((3, 3, 1, 3, 1), (0, 0, 1, 0, 0), (0, 0, 1, 0, 0))
"""Of each of ArduPilot's three sets: 3 GNSS, 1 barometer or compass, 0 none."""
_NO_GPS = 3
"""Of EK2_GPS_TYPE: then external navigation is fused."""
_LOCAL_FRD = 20
_REASONS = 32
"""Most reasons that are counted separately."""
DEFAULTS: Mapping[Stack, Mapping[str, float]] = {
    Stack.PX4: {"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7, "EKF2_EV_QMIN": 0, "EKF2_HGT_REF": 1},
    Stack.PX4_OLD: {"EKF2_AID_MASK": 1, "EKF2_HGT_MODE": 0},
    Stack.ARDUPILOT: {
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
    },
}
"""The parameters that matter, with the firmware's defaults; ``judge`` may override them."""


def judge(
    stack: Stack,
    message: Any,
    parameters: Mapping[str, float] | None = None,
    history: History | None = None,
    *,
    source_set: int = 1,
) -> Judgement:
    """Return what an autopilot does with an ODOMETRY, its fields named as in the definitions.

    Parameters that are not given have the firmware's defaults. The history is from the judgement of
    the message before. ``source_set`` is the one of ArduPilot that the pilot has switched to.
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
        if frame.message_id == IDS["ODOMETRY"]:
            before = judgement.history if judgement is not None else None
            judgement = judge(
                Stack(stack), unpack(frame), parameters, before, source_set=source_set
            )
    if judgement is None:
        raise ValueError("no ODOMETRY in these bytes; give whole frames of MAVLink 2")
    return judgement


class Vision:
    """A VISION_POSITION_ESTIMATE as both receivers hand it on: local, without a velocity."""

    def __init__(self, vision: Any) -> None:
        self._vision = vision
        self.time_usec, self.pose_covariance = vision.usec, vision.covariance
        self.q = tuple(so3.from_euler(vision.roll, vision.pitch, vision.yaw).tolist())
        self.vx = self.vy = self.vz = math.nan
        self.frame_id, self.child_frame_id, self.estimator_type, self.quality = _LOCAL_FRD, 12, 2, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._vision, name)


class Reception:
    """Judges the ODOMETRY that an autopilot receives by its own rules, and counts the verdicts."""

    def __init__(
        self, rules: str, parameters: Mapping[str, float], *, knows_odometry: bool = True
    ) -> None:
        """Judge by a ``Stack``'s rules; empty: accept all. Parameters are read for each message.

        Old firmware does not know ODOMETRY.
        """
        self.accepted = 0
        """Messages that were passed to the filter."""
        self.fused = 0
        """Messages of which the filter fuses something, before its gates."""
        self.refused: Counter[str] = Counter()
        """Messages that were not, by reason."""
        self.unfused: Counter[str] = Counter()
        """Messages that were accepted, and not or not wholly fused, by reason."""
        self.misplaced = 0
        """Origins that came while it fused a position: PX4 1.18 is then 5300 km off."""
        self.positions: Counter[str] = Counter()
        """GLOBAL_POSITION_SENSORs by what PX4 does with them."""
        self.is_taken = True
        """Whether the last message was passed to the filter."""
        self._stack, self._knows_odometry = Stack(rules) if rules else None, knows_odometry
        self._parameters = parameters
        self._history = History()

    def take_origin(self, now_us: int) -> None:
        """Take an origin of the local frame; PX4 ends the fusion 0.4 s after the last message.

        Source: PX4 1.18, ``Ekf::setLatLonOrigin``, and the offset that
        ``resetHorizontalPositionTo`` then gives to positions of external vision.
        """
        last = self._history
        if Quantity.POSITION in last.fused and last.time_us is not None:
            self.misplaced += now_us - last.time_us <= px4_receiver.ENDS_US

    def take_position(self, position: Any) -> bool:
        """Judge a GLOBAL_POSITION_SENSOR by PX4's rules; return whether it is fused."""
        reason = px4_receiver.judge_position(position, self._parameters)
        _count(self.positions, reason or "fused")
        return not reason

    def take(self, odometry: Any) -> str:
        """Judge a message; return the critical text that the pilot sees, empty: none."""
        if self._stack is None:
            self.accepted += 1
            return ""
        if not self._knows_odometry:
            self.is_taken = False
            _count(self.refused, "this firmware does not know ODOMETRY")
            return ""
        return self._note(judge(self._stack, odometry, self._parameters, self._history))

    def take_vision(self, vision: Any) -> None:
        """Judge a VISION_POSITION_ESTIMATE as an ODOMETRY without velocity and quality."""
        if self._stack is None:
            self.accepted += 1
        elif self._stack is Stack.ARDUPILOT and not self._knows_odometry:
            # Before 4.1 one parameter decides on the receiver and on vision together
            self.accepted += 1
            self.fused += self._parameters.get("EK2_GPS_TYPE", 0) == _NO_GPS
        else:
            self._note(judge(self._stack, Vision(vision), self._parameters, self._history))

    def _note(self, judgement: Judgement) -> str:
        self._history = judgement.history
        self.is_taken = judgement.is_accepted
        if not judgement.is_accepted:
            _count(self.refused, judgement.reason)
            return judgement.text
        self.accepted += 1
        self.fused += bool(judgement.fused)
        if judgement.reason:
            _count(self.unfused, judgement.reason)
        return judgement.text

    def summary(self) -> dict[str, Any]:
        """Return the counts, for JSON."""
        return {
            "accepted": self.accepted,
            "fused": self.fused,
            "refused": dict(self.refused),
            "not_fused": dict(self.unfused),
            "misplaced": self.misplaced,
            "positions": dict(self.positions),
        }


def _count(counter: Counter[str], reason: str) -> None:
    """Count under a bounded number of reasons, as some contain a number."""
    counter[reason if reason in counter or len(counter) < _REASONS else "another"] += 1
