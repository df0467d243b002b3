"""Estimates to payloads, in wire units, as the two autopilots accept them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from struct import Struct
from typing import Literal

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.nav.state import Odometry, Status


class Frame(IntEnum):
    """MAV_FRAME: frames of the pose, and of the velocity."""

    LOCAL_NED = 1
    """North, east, down: for listeners that are no autopilot."""
    BODY_FRD = 12
    """Forward, right, down: the one frame of the velocity that every listener accepts."""
    LOCAL_FRD = 20
    """Here with forward to the north: the one frame of the pose that both autopilots accept."""


class EstimatorType(IntEnum):
    """MAV_ESTIMATOR_TYPE."""

    VIO = 3
    GPS_INS = 5


class SystemStatus(IntEnum):
    """MAV_STATE: our state, in our heartbeat."""

    BOOT = 1
    CALIBRATING = 2
    ACTIVE = 4
    CRITICAL = 5
    POWEROFF = 7


SYSTEM_STATUS = {
    Status.INIT: SystemStatus.BOOT,
    Status.ALIGNING: SystemStatus.CALIBRATING,
    Status.ATTITUDE: SystemStatus.CALIBRATING,
    Status.OK: SystemStatus.ACTIVE,
    Status.DEGRADED: SystemStatus.ACTIVE,
    Status.DEAD_RECKONING: SystemStatus.CRITICAL,
    Status.INVALID: SystemStatus.CRITICAL,
}
"""Our state by the status of the estimate."""


def estimator_type(family: Family) -> EstimatorType:
    """Return the true type, or the nearest for PX4, which refuses that with a critical text."""
    return EstimatorType.VIO if family is Family.PX4 else EstimatorType.GPS_INS


def reset_counter(count: int) -> int:
    """Return a count of resets as 1 to 255, from 1 on: 0 would mean that none are counted."""
    return count % 255 + 1


_ODOMETRY = Struct("<Q220s4Bb")


def odometry(
    estimate: Odometry,
    *,
    frame: Frame = Frame.LOCAL_FRD,
    estimator: EstimatorType = EstimatorType.GPS_INS,
) -> bytes:
    """Return the payload of ODOMETRY."""
    return _ODOMETRY.pack(
        estimate.t_ns // 1000,
        estimate.numbers,
        frame,
        Frame.BODY_FRD,
        reset_counter(estimate.reset_count),
        estimator,
        max(-1, min(100, estimate.quality)),
    )


class StatusFlag(IntFlag):
    """ESTIMATOR_STATUS_FLAGS."""

    NONE = 0
    ATTITUDE = 1
    VELOCITY_HORIZ = 2
    VELOCITY_VERT = 4
    POS_HORIZ_REL = 8
    POS_HORIZ_ABS = 16
    POS_VERT_ABS = 32
    CONST_POS_MODE = 128
    PRED_POS_HORIZ_REL = 256
    PRED_POS_HORIZ_ABS = 512
    GPS_GLITCH = 1024
    ACCEL_ERROR = 2048


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorHealth:
    """The filter's own health; a ratio is innovation over gate, above 1 refused."""

    t_ns: int
    flags: StatusFlag
    vel_ratio: float
    pos_horiz_ratio: float
    pos_vert_ratio: float
    heading_ratio: float
    std_horiz: float
    """One sigma of the horizontal position, m."""
    std_vert: float
    """One sigma of the height, m."""


def estimator_status(health: EstimatorHealth) -> bytes:
    """Return the payload of ESTIMATOR_STATUS; a ratio that is not known (NaN) stays NaN."""
    return pack(
        "ESTIMATOR_STATUS",
        time_usec=health.t_ns // 1000,
        flags=int(health.flags),
        vel_ratio=health.vel_ratio,
        pos_horiz_ratio=health.pos_horiz_ratio,
        pos_vert_ratio=health.pos_vert_ratio,
        mag_ratio=health.heading_ratio,
        hagl_ratio=math.nan,
        tas_ratio=math.nan,
        pos_horiz_accuracy=health.std_horiz,
        pos_vert_accuracy=health.std_vert,
    )


_ONBOARD_CONTROLLER = 18
_NO_AUTOPILOT = 8
_VERSION = 3
SET_MESSAGE_INTERVAL = 511
REQUEST_MESSAGE = 512
"""MAV_CMD."""


def heartbeat(status: SystemStatus, mode: int = 0) -> bytes:
    """Return the payload of our HEARTBEAT: an onboard controller that is no autopilot.

    ``mode`` is ours to define, and is the ``nav.state.Status`` of the estimate.
    """
    return pack(
        "HEARTBEAT",
        custom_mode=mode,
        type=_ONBOARD_CONTROLLER,
        autopilot=_NO_AUTOPILOT,
        system_status=status,
        mavlink_version=_VERSION,
    )


def set_message_interval(
    message_id: int, rate: float, *, target_system: int, target_component: int, confirmation: int
) -> bytes:
    """Return the payload of the COMMAND_LONG that requests a message at a rate, Hz; 0: none."""
    return pack(
        "COMMAND_LONG",
        target_system=target_system,
        target_component=target_component,
        command=SET_MESSAGE_INTERVAL,
        confirmation=confirmation,
        param1=float(message_id),
        param2=round(1e6 / rate) if rate > 0.0 else -1.0,
    )


def request_message(
    message_id: int, *, target_system: int, target_component: int, confirmation: int
) -> bytes:
    """Return the payload of the COMMAND_LONG that requests a message once."""
    return pack(
        "COMMAND_LONG",
        target_system=target_system,
        target_component=target_component,
        command=REQUEST_MESSAGE,
        confirmation=confirmation,
        param1=float(message_id),
    )


def request_data_stream(
    group: int, rate: float, *, target_system: int, target_component: int
) -> bytes:
    """Return the payload of REQUEST_DATA_STREAM for a group of messages at a rate, Hz."""
    return pack(
        "REQUEST_DATA_STREAM",
        target_system=target_system,
        target_component=target_component,
        req_stream_id=group,
        req_message_rate=min(round(rate), 1000),
        start_stop=int(rate > 0.0),
    )


def timesync(tc1: int, ts1: int, *, target_system: int, target_component: int) -> bytes:
    """Return the payload of TIMESYNC with its targets, 18 bytes; ``tc1 == 0`` asks."""
    return pack(
        "TIMESYNC",
        tc1=tc1,
        ts1=ts1,
        target_system=target_system,
        target_component=target_component,
    )


def gps_global_origin(lat: float, lon: float, alt: float, *, t_ns: int) -> bytes:
    """Return the payload of GPS_GLOBAL_ORIGIN: where our positions count from (rad, rad, m)."""
    return pack(
        "GPS_GLOBAL_ORIGIN",
        latitude=round(math.degrees(lat) * 1e7),
        longitude=round(math.degrees(lon) * 1e7),
        altitude=round(alt * 1e3),
        time_usec=t_ns // 1000,
    )


@dataclass(frozen=True, slots=True)
class Label:
    """How every ODOMETRY on a link is labelled."""

    frame: Frame
    estimator: EstimatorType
    warnings: tuple[str, ...]
    """What of the configuration is not done, or has no effect; sentences without full stop."""


MONITOR = Label(Frame.LOCAL_NED, EstimatorType.GPS_INS, ())
"""For a listener that is no autopilot: the true type and frame."""


def label(
    family: Family,
    frame: Literal["LOCAL_FRD", "LOCAL_NED"],
    chosen: Literal["auto", "GPS_INS", "VIO"],
) -> Label:
    """Return the label that is configured, but never a type that the autopilot refuses.

    PX4 answers every GPS_INS with a critical text; ArduPilot silently drops every frame of the pose
    but LOCAL_FRD. An autopilot of unknown family is labelled as one of a known family is.
    """
    warnings = []
    estimator = estimator_type(family) if chosen == "auto" else EstimatorType[chosen]
    if family is Family.PX4 and estimator is EstimatorType.GPS_INS:
        estimator = EstimatorType.VIO
        warnings.append(
            "output.odometry.estimator_type: PX4 refuses GPS_INS with a critical text for each "
            "message; VIO is sent instead: set auto or VIO"
        )
    if family is Family.ARDUPILOT and frame != "LOCAL_FRD":
        warnings.append(
            f"output.odometry.frame: ArduPilot ignores {frame} without a word; set LOCAL_FRD for "
            "it to take our estimate"
        )
    return Label(Frame[frame], estimator, tuple(warnings))
