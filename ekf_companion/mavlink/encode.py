"""Estimates to payloads, in wire units, as the two autopilots accept them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from struct import Struct
from typing import Literal

import numpy as np

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.nav import so3
from ekf_companion.nav.state import Odometry, Status


class Frame(IntEnum):
    """MAV_FRAME: frames of the pose, and of the velocity."""

    LOCAL_NED = 1
    """North, east, down: for PX4, and for listeners that are no autopilot."""
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


_ODOMETRY = Struct("<Q220s4Bb")
_POSE, _VELOCITY, _TRIANGLE = Struct("<7f"), Struct("<3f"), Struct("<21f")
_POSE_COVARIANCE = 13 * 4
_VELOCITY_COVARIANCE = _POSE_COVARIANCE + _TRIANGLE.size
"""Where the covariances begin in the numbers of an estimate."""


def odometry(
    estimate: Odometry,
    *,
    frame: Frame = Frame.LOCAL_FRD,
    velocity: Frame = Frame.BODY_FRD,
    estimator: EstimatorType = EstimatorType.GPS_INS,
) -> bytes:
    """Return the payload of ODOMETRY; the frames are those in which its numbers are."""
    return _ODOMETRY.pack(
        estimate.t_ns // 1000,
        estimate.numbers,
        frame,
        velocity,
        # From 1 to 255: 0 would mean that none are counted
        estimate.reset_count % 255 + 1,
        estimator,
        max(-1, min(100, estimate.quality)),
    )


_WITHOUT_ODOMETRY = {Family.PX4: ((1, 0), (1, 9)), Family.ARDUPILOT: ((3, 0), (4, 1))}
"""Firmware that reads no ODOMETRY, from one version until another; what is below numbers itself in
a way of its own. Sources: PX4 #9301; ArduPilot, the release that also brought EK3_SRCn_*."""


def knows_odometry(family: Family, version: str) -> bool:
    """Return whether a firmware reads ODOMETRY; ``version`` as in ``1.16.0``, empty: not known."""
    found = tuple(int(part) for part in version.split(".")[:2] if part.isdigit())
    first, end = _WITHOUT_ODOMETRY.get(family, ((0, 0), (0, 0)))
    return len(found) < 2 or not first <= found < end


POSES = ("ODOMETRY", "VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE")
"""As which the estimate is sent: the first, or the others together."""
RESET_COUNTER = dict(zip(POSES, (-3, -1, -1), strict=True))
"""Where the reset counter lies in the payload of each, from its end."""


def vision_position_estimate(estimate: Odometry) -> bytes:
    """Return the payload of VISION_POSITION_ESTIMATE."""
    x, y, z, *q = _POSE.unpack_from(estimate.numbers)
    return pack(
        "VISION_POSITION_ESTIMATE",
        usec=estimate.t_ns // 1000,
        **dict(zip("xyz", (x, y, z), strict=True)),
        **dict(zip(("roll", "pitch", "yaw"), so3.to_euler(np.array(q)).tolist(), strict=True)),
        covariance=_TRIANGLE.unpack_from(estimate.numbers, _POSE_COVARIANCE),
        reset_counter=estimate.reset_count % 255 + 1,
    )


def vision_speed_estimate(estimate: Odometry) -> bytes:
    """Return the payload of VISION_SPEED_ESTIMATE; the velocity must be along the local axes."""
    xx, xy, xz, _, _, _, yy, yz, _, _, _, zz = _TRIANGLE.unpack_from(
        estimate.numbers, _VELOCITY_COVARIANCE
    )[:12]
    return pack(
        "VISION_SPEED_ESTIMATE",
        usec=estimate.t_ns // 1000,
        **dict(zip("xyz", _VELOCITY.unpack_from(estimate.numbers, _POSE.size), strict=True)),
        covariance=(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        reset_counter=estimate.reset_count % 255 + 1,
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


def estimator_status(
    t_ns: int, flags: StatusFlag, ratios: Sequence[float], stds: Sequence[float]
) -> bytes:
    """Return the payload of ESTIMATOR_STATUS.

    Args:
        t_ns: Time of the estimate, autopilot clock.
        flags: What is estimated.
        ratios: Innovation over gate, above 1 refused, NaN if not known: of velocity, horizontal
            position, height and heading.
        stds: One sigma of the horizontal position and of the height, m.
    """
    names = ("vel_ratio", "pos_horiz_ratio", "pos_vert_ratio", "mag_ratio")
    return pack(
        "ESTIMATOR_STATUS",
        time_usec=t_ns // 1000,
        flags=int(flags),
        **dict(zip(names, ratios, strict=True)),
        hagl_ratio=math.nan,
        tas_ratio=math.nan,
        pos_horiz_accuracy=stds[0],
        pos_vert_accuracy=stds[1],
    )


_RAIM_OK, _RAIM_FAILED, _SPOOFING_DETECTED = 2, 3, 3
_NO_BYTE, _NO_WORD = 0xFF, 0xFFFF


def gnss_integrity(receiver: int, *, is_caught: bool, is_place_false: bool) -> bytes:
    """Return the payload of GNSS_INTEGRITY.

    Args:
        receiver: Whose it is, from 0 on.
        is_caught: Whether its fixes contradict the estimate.
        is_place_false: Whether its position is false, though it states a fix.
    """
    return pack(
        "GNSS_INTEGRITY",
        id=receiver,
        raim_hfom=_NO_WORD,
        raim_vfom=_NO_WORD,
        raim_state=_RAIM_FAILED if is_caught else _RAIM_OK,
        spoofing_state=_SPOOFING_DETECTED if is_place_false else 0,
        corrections_quality=_NO_BYTE,
        system_status_summary=_NO_BYTE,
        gnss_signal_quality=_NO_BYTE,
        post_processing_quality=_NO_BYTE,
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


def request_message(message_id: int, rate: float | None, **addressing: int) -> bytes:
    """Return the payload of the COMMAND_LONG that requests a message.

    Args:
        message_id: Of the message.
        rate: Hz; 0: stop it; None: send it once.
        **addressing: ``target_system``, ``target_component`` and ``confirmation``.
    """
    if rate is None:
        return pack("COMMAND_LONG", command=REQUEST_MESSAGE, param1=float(message_id), **addressing)
    return pack(
        "COMMAND_LONG",
        command=SET_MESSAGE_INTERVAL,
        param1=float(message_id),
        param2=round(1e6 / rate) if rate > 0.0 else -1.0,
        **addressing,
    )


def request_data_stream(group: int, rate: float, **target: int) -> bytes:
    """Return the payload of REQUEST_DATA_STREAM for a group of messages at a rate, Hz.

    ``target`` is ``target_system`` and ``target_component``.
    """
    return pack(
        "REQUEST_DATA_STREAM",
        req_stream_id=group,
        req_message_rate=min(round(rate), 1000),
        start_stop=int(rate > 0.0),
        **target,
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


def global_position(
    t_ns: int,
    place: tuple[float, float, float],
    height: float,
    vel_n: tuple[float, float, float],
    yaw: float,
) -> bytes:
    """Return the payload of GLOBAL_POSITION_INT.

    Args:
        t_ns: Time of the estimate, autopilot clock.
        place: Latitude and longitude (degrees), altitude above mean sea level (m).
        height: Above the start, m.
        vel_n: Velocity north, east, down, m/s.
        yaw: From true north, clockwise, rad.
    """
    lat, lon, alt = place
    vx, vy, vz = (max(-32767, min(32767, round(100.0 * one))) for one in vel_n)
    return pack(
        "GLOBAL_POSITION_INT",
        time_boot_ms=t_ns // 1_000_000 % (1 << 32),
        lat=round(lat * 1e7),
        lon=round(lon * 1e7),
        alt=round(alt * 1e3),
        relative_alt=round(height * 1e3),
        vx=vx,
        vy=vy,
        vz=vz,
        hdg=round(math.degrees(yaw) * 100.0) % 36000,
    )


EXTERNAL_POSITION_ESTIMATE = 43003
"""MAV_CMD."""
_GLOBAL, _ESTIMATOR = 0, 6
"""MAV_FRAME_GLOBAL; GLOBAL_POSITION_ESTIMATOR of GLOBAL_POSITION_SRC."""
_WRAP_NS = 4096 * 10**9
"""Where a time in float32 begins anew: below it resolves half a millisecond."""


def external_position_estimate(
    t_ns: int, place: tuple[float, float, float], std: float, target: tuple[int, int]
) -> bytes:
    """Return the payload of the COMMAND_INT that gives an autopilot a position.

    Args:
        t_ns: Time of the estimate, autopilot clock.
        place: Latitude and longitude (degrees), altitude above mean sea level (m).
        std: One sigma of the horizontal position, an axis, m.
        target: System and component id of the autopilot.
    """
    return pack(
        "COMMAND_INT",
        target_system=target[0],
        target_component=target[1],
        command=EXTERNAL_POSITION_ESTIMATE,
        frame=_GLOBAL,
        param1=t_ns % _WRAP_NS * 1e-9,
        param3=std,
        x=round(place[0] * 1e7),
        y=round(place[1] * 1e7),
        z=math.nan,
    )


def global_position_sensor(
    t_ns: int,
    place: tuple[float, float, float],
    stds: tuple[float, float],
    target: tuple[int, int],
    sensor_id: int,
) -> bytes:
    """Return the payload of GLOBAL_POSITION_SENSOR.

    Args:
        t_ns: Time of the estimate, autopilot clock.
        place: Latitude and longitude (degrees), altitude above mean sea level (m).
        stds: One sigma of the horizontal position, an axis, and of the height, m.
        target: System and component id of the autopilot.
        sensor_id: Ours among the sensors of global positions.
    """
    return pack(
        "GLOBAL_POSITION_SENSOR",
        time_usec=t_ns // 1000,
        lat=round(place[0] * 1e7),
        lon=round(place[1] * 1e7),
        alt_ellipsoid=math.nan,
        alt=place[2],
        eph=stds[0],
        epv=stds[1],
        target_system=target[0],
        target_component=target[1],
        id=sensor_id,
        source=_ESTIMATOR,
    )


def global_offset(t_ns: int, shift: tuple[float, float, float], yaw: float) -> bytes:
    """Return the payload of LOCAL_POSITION_NED_SYSTEM_GLOBAL_OFFSET.

    Args:
        t_ns: Time of the estimate, autopilot clock.
        shift: Where the origin of the frame of our ODOMETRY lies, north, east, down of
            GPS_GLOBAL_ORIGIN, m.
        yaw: Of that frame's first axis from north, rad.
    """
    return pack(
        "LOCAL_POSITION_NED_SYSTEM_GLOBAL_OFFSET",
        time_boot_ms=t_ns // 1_000_000 & 0xFFFF_FFFF,
        **dict(zip("xyz", shift, strict=True)),
        yaw=yaw,
    )


@dataclass(frozen=True, slots=True)
class Label:
    """How every ODOMETRY on a link is labelled."""

    frame: Frame
    velocity: Frame
    estimator: EstimatorType
    warnings: tuple[str, ...]
    is_vision: bool = False
    """Whether VISION_POSITION_ESTIMATE and VISION_SPEED_ESTIMATE are sent in place of it; then both
    frames are LOCAL_NED."""
    """What of the configuration is not done, or has no effect; sentences without full stop."""


def label(
    family: Family,
    frame: Literal["auto", "LOCAL_FRD", "LOCAL_NED", "continuous"],
    chosen: Literal["auto", "GPS_INS", "VIO"],
) -> Label:
    """Return the label that is configured, but never a type that the autopilot refuses.

    PX4 answers every GPS_INS with a critical text, and takes the heading of LOCAL_FRD for unknown;
    ArduPilot silently drops all frames but LOCAL_FRD and BODY_FRD. An autopilot of unknown family
    is labelled as one of a known family is. PX4 turns a velocity of the body by its own attitude,
    and would so take the error of ours in it for one of its own; north, east and down it takes as
    they are.
    """
    warnings = []
    estimator = EstimatorType.GPS_INS if chosen == "auto" else EstimatorType[chosen]
    if family is Family.PX4:
        estimator = EstimatorType.VIO
        if chosen == "GPS_INS":
            warnings.append(
                "output.odometry.estimator_type: PX4 refuses GPS_INS with a critical text for each "
                "message; VIO is sent instead: set auto or VIO"
            )
    if frame == "auto":
        frame = "LOCAL_NED" if family is Family.PX4 else "LOCAL_FRD"
    # A frame whose axes may turn away from north and east is a LOCAL_FRD
    named = Frame.LOCAL_FRD if frame == "continuous" else Frame[frame]
    if family is Family.ARDUPILOT and named is not Frame.LOCAL_FRD:
        warnings.append(
            f"output.odometry.frame: ArduPilot ignores {frame} without a word; set LOCAL_FRD for "
            "it to take our estimate"
        )
    is_north = family is Family.PX4 and named is Frame.LOCAL_NED
    velocity = Frame.LOCAL_NED if is_north else Frame.BODY_FRD
    return Label(named, velocity, estimator, tuple(warnings))
