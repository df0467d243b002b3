"""What other components send: poses, velocities and ranges of cameras, motion capture and radios.

They are stamped by the autopilot's clock where the two are synchronised, by ours (unix time) where
they come from this board, else by a clock of their own. How far ours is from the autopilot's its
newest stamps show, at the arrival of each message. Of a clock of their own only the difference
counts: the least lag that it ever showed is taken for none, and what is constant of it the
estimator finds as a delay.

Of several senders the first counts until it is silent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.decode.growth import Growth
from ekf_companion.mavlink.decode.preference import Preference
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import AnchorSample, Kind, PoseSample, VelocitySample
from ekf_companion.nav.relative_pose import square
from ekf_companion.nav.stamps import least_lag

Axes = tuple[tuple[int, float], ...]
"""Which axis of another frame, and with which sign, is x, y, z of one whose z points down."""
_DOWN: Axes = ((0, 1.0), (1, 1.0), (2, 1.0))
_FLU: Axes = ((0, 1.0), (1, -1.0), (2, -1.0))
_ENU: Axes = ((1, 1.0), (0, 1.0), (2, -1.0))
_FRAMES = {
    **dict.fromkeys((1, 14, 16, 18, 20), _DOWN),
    21: _FLU,
    **dict.fromkeys((4, 15, 17, 19), _ENU),
}
"""By MAV_FRAME: LOCAL_NED, MOCAP_NED, VISION_NED, ESTIM_NED, LOCAL_FRD; LOCAL_FLU; LOCAL_ENU,
MOCAP_ENU, VISION_ENU, ESTIM_ENU."""
_BODY = {8: _DOWN, 12: _DOWN, 13: _FLU}
"""By MAV_FRAME: BODY_NED, BODY_FRD, BODY_FLU, whose forward axes are the same."""
_NO_AID = {4: "GPS", 5: "GPS_INS", 8: "AUTOPILOT"}
"""MAV_ESTIMATOR_TYPE of what has GNSS in it already."""
_FAILED = -1
"""Quality of a pose that its source itself takes for wrong."""
_GROUND = 240
"""Ids of systems from here on are of ground stations and their like, which send what a motion
capture sees; a lower one that is not the autopilot's is another vehicle."""
_SAME_US = 1_000_000
"""A stamp so near to the autopilot's newest is by its clock; one as old by ours is by that."""
_AHEAD_US = 10_000
"""So far ahead of ours a clock on this board may be: ours is set once at the start, the other as
the network says."""
_SURE = 100.0
"""Highest confidence, per cent."""
_SPAN_US = 1_000_000
"""Longest span of a difference of position: over a longer one its mean velocity is none of then."""
_DELTA_STD = 0.1, 0.9
"""One sigma of a velocity by such a difference at full and at no confidence, m/s (EK3_VIS_VERR_MIN,
EK3_VIS_VERR_MAX)."""
_STATED, _YAW = [0, 1, 2, 6, 7, 11, 20], 20
"""Places of the covariances of the place and of yaw in the upper triangle of a pose's."""
_SENDERS = 16
"""Told apart, at most."""
RANGES = frozenset([IDS["RANGING_BEACON"]])
"""Messages that nobody can have made of GNSS."""
_UNKNOWN_MM, _UNKNOWN_DEGE7 = 2**32 - 1, 2**31 - 1
_ABOVE_SEA = 1
"""RANGING_BEACON_ALT_TYPE; 0: above the ellipsoid, which no altitude here is."""
_POOR = 1
"""RANGING_BEACON_STATUS_FLAG."""
_KINDS: dict[type, Kind] = {
    PoseSample: Kind.POSE,
    VelocitySample: Kind.VELOCITY,
    AnchorSample: Kind.ANCHOR,
}


class _OurClock:
    """Our clock, brought to the autopilot's."""

    def __init__(self) -> None:
        self._offset: int | None = None
        self._last = 0

    def offset(self, now_us: int, latest_us: int) -> int:
        """Return what is added to a time of ours, given the newest stamp that has come by now.

        The most that was seen is nearest: what comes seldom, or late, is older.
        """
        offset = latest_us - now_us
        if self._offset is not None and abs(offset - self._offset) <= _SAME_US:
            offset = -least_lag(-self._offset, -offset, now_us - self._last)
        self._offset, self._last = offset, now_us
        return offset


class _Clock:
    """Stamps of a sender, brought to the autopilot's clock."""

    def __init__(self) -> None:
        self._offset: int | None = None
        """What is added to a stamp, us; None: it is by the autopilot's clock."""
        self._last = 0
        self._is_known = False

    def to_ns(self, stamp_us: int, latest_us: int, ours_us: int | None = None) -> int:
        """Return when it was true, given the autopilot's newest stamp.

        ``ours_us`` is when it was true if the stamp is by our clock; None: it is not.
        """
        if stamp_us == 0:
            return latest_us * 1000  # it does not say
        lag = latest_us - stamp_us
        if abs(lag) <= _SAME_US and (self._offset is None or not self._is_known):
            self._is_known = True
            return stamp_us * 1000
        if ours_us is not None:
            return ours_us * 1000
        if self._offset is None or abs(lag - self._offset) > _SAME_US:
            self._offset = lag  # the first of it, or of a clock that has leapt
        else:
            self._offset = least_lag(self._offset, lag, stamp_us - self._last)
        self._is_known, self._last = True, stamp_us
        return (stamp_us + self._offset) * 1000


class External:
    """Reads the messages of others."""

    def __init__(self, context: Context) -> None:
        """Begin with nobody."""
        self._context = context
        readers: dict[str, Callable[[Any, int], Measurements]] = {
            "ODOMETRY": self._odometry,
            "VISION_POSITION_ESTIMATE": self._angles,
            "GLOBAL_VISION_POSITION_ESTIMATE": self._angles,
            "VICON_POSITION_ESTIMATE": self._angles,
            "ATT_POS_MOCAP": self._mocap,
            "VISION_SPEED_ESTIMATE": self._speed,
            "VISION_POSITION_DELTA": self._delta,
            "RANGING_BEACON": self._range,
        }
        self.readers = {IDS[name]: reader for name, reader in readers.items()}
        """By message id."""
        self.used: dict[Kind, str] = {}
        """Sender and message in use, as ``1/197 ODOMETRY``, by what it measures."""
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._senders: list[tuple[int, int, int]] = []
        self._clocks: dict[tuple[int, int], _Clock] = {}
        self._growths: dict[tuple[int, int, int], Growth] = {}
        self._ours = _OurClock()
        self._sources = {kind: Preference() for kind in _KINDS.values()}
        self.used.clear()

    def read(self, frame: Frame, system_id: int, now_ns: int | None = None) -> Measurements:
        """Return what a frame of another component measures.

        Args:
            frame: Of any message.
            system_id: The autopilot's.
            now_ns: When it arrived from this board, as a .tlog holds it; None: from elsewhere.
        """
        reader = self.readers.get(frame.message_id)
        if reader is None:
            return []
        what = "range to an anchor" if frame.message_id in RANGES else "odometry"
        if frame.system_id != system_id and frame.system_id < _GROUND:
            return self._context.refuse(f"{what}: of another vehicle")
        latest_us = self._context.clock.latest_us
        if latest_us is None:
            return self._context.refuse(f"{what}: no time base yet")
        source = frame.system_id, frame.component_id, frame.message_id
        if source not in self._senders:
            if len(self._senders) == _SENDERS:
                return self._context.refuse(f"{what}: too many senders")
            self._senders.append(source)
        message = unpack(frame)
        stamp_us = message.time_usec if hasattr(message, "time_usec") else message.usec
        ours_us = None
        if now_ns is not None:
            offset = self._ours.offset(now_ns // 1000, latest_us)
            if -_AHEAD_US <= now_ns // 1000 - stamp_us <= _SAME_US:
                ours_us = stamp_us + offset
        clock = self._clocks.setdefault(source[:2], _Clock())
        t_ns = clock.to_ns(stamp_us, latest_us, ours_us)
        self._growth = self._growths.setdefault(source, Growth())
        found = reader(message, t_ns)
        rank = self._senders.index(source)
        return [one for one in found if self._admit(one, rank, source)]

    def _admit(self, one: Any, rank: int, source: tuple[int, int, int]) -> bool:
        kind = _KINDS[type(one)]
        if not self._sources[kind].admit(rank, one.t_ns):
            return False
        self.used[kind] = f"{source[0]}/{source[1]} {LAYOUTS[source[2]].name}"
        return True

    def _odometry(self, m: Any, t_ns: int) -> Measurements:
        """Read ODOMETRY: a pose, and a velocity in the axes of its child frame."""
        if m.estimator_type in _NO_AID:
            return self._context.refuse("odometry: has GNSS in it, or is the autopilot's own")
        if m.quality == _FAILED:
            return self._context.refuse("odometry: failed, its source says")
        found: Measurements = []
        velocity = (m.vx, m.vy, m.vz)
        std = _std(m.velocity_covariance, (0, 6, 11))
        if (axes := _BODY.get(m.child_frame_id)) is not None:
            found += _velocity(t_ns, velocity, axes, std, is_level=False)
        elif (axes := _FRAMES.get(m.child_frame_id)) is not None:
            found += _velocity(t_ns, velocity, axes, std, is_level=True)
        if (axes := _FRAMES.get(m.frame_id)) is None:
            self._context.refuse("odometry: a frame that moves, or is not known")
            return found
        yaw = _yaw(m.q, axes)
        return self._pose_of(t_ns, (m.x, m.y, m.z), axes, yaw, m, m.pose_covariance) + found

    def _angles(self, m: Any, t_ns: int) -> Measurements:
        """Read a pose in a frame whose z points down, by Euler angles."""
        yaw = m.yaw if math.isfinite(m.yaw) and abs(m.yaw) < 7.0 else None
        return self._pose_of(t_ns, (m.x, m.y, m.z), _DOWN, yaw, m, m.covariance)

    def _mocap(self, m: Any, t_ns: int) -> Measurements:
        """Read ATT_POS_MOCAP."""
        yaw = _yaw(m.q, _DOWN)
        return self._pose_of(t_ns, (m.x, m.y, m.z), _DOWN, yaw, m, m.covariance)

    def _speed(self, m: Any, t_ns: int) -> Measurements:
        """Read VISION_SPEED_ESTIMATE: a velocity in a frame whose z points down."""
        std = _std(m.covariance, (0, 4, 8))
        return _velocity(t_ns, (m.x, m.y, m.z), _DOWN, std, is_level=True)

    def _delta(self, m: Any, t_ns: int) -> Measurements:
        """Read VISION_POSITION_DELTA: what is travelled, as the mean velocity in the body.

        It is stated in the body's axes at the end of its span, and counts in the middle, half of
        its turn before. Source of the sigma by confidence: ArduPilot, ``writeBodyFrameOdom``.
        """
        if not 0.0 < m.confidence <= _SURE:
            return self._context.refuse("odometry: failed, its source says")
        if not 0 < m.time_delta_usec <= _SPAN_US:
            return self._context.refuse("odometry: no time span, or one of more than a second")
        if not all(map(math.isfinite, m.angle_delta)):
            return []
        span = m.time_delta_usec * 1e-6
        half = so3.exp(0.5 * np.array(m.angle_delta))
        velocity = so3.rotate(half, np.array(m.position_delta) / span).tolist()
        least, most = _DELTA_STD
        std = least + (most - least) * (1.0 - m.confidence / _SURE)
        t_ns -= 500 * m.time_delta_usec
        return _velocity(t_ns, velocity, _DOWN, std, is_level=False)

    def _range(self, m: Any, t_ns: int) -> Measurements:
        """Read RANGING_BEACON; without an altitude above the sea the configuration has the place.

        Source: MAVLink's dialect ``development``.
        """
        if m.status & _POOR:
            return self._context.refuse("range to an anchor: a poor signal, its radio says")
        if m.range in (0, _UNKNOWN_MM):
            return []
        place = None
        is_stated = _UNKNOWN_DEGE7 not in (m.lat, m.lon) and math.isfinite(m.alt)
        if is_stated and m.alt_type == _ABOVE_SEA:
            place = math.radians(m.lat * 1e-7), math.radians(m.lon * 1e-7), m.alt
        is_known = m.range_accuracy not in (0, _UNKNOWN_MM)
        std = m.range_accuracy * 1e-3 if is_known else None
        return [
            AnchorSample(t_ns=t_ns, range=m.range * 1e-3, anchor=m.beacon_id, std=std, place=place)
        ]

    def _pose_of(
        self,
        t_ns: int,
        place: Sequence[float],
        axes: Axes,
        yaw: float | None,
        m: Any,
        covariance: Sequence[float],
    ) -> Measurements:
        x, y, z = (sign * place[axis] for axis, sign in axes)
        if not math.isfinite(x + y + z):
            return []
        counter = getattr(m, "reset_counter", None)
        std = _std(covariance, (0, 6, 11))
        stated = np.array(covariance)
        drift, yaw_drift = None, None
        if std is not None and np.isfinite(stated[_STATED]).all():
            T = np.zeros((3, 3))
            for row, (axis, sign) in enumerate(axes):
                T[row, axis] = sign
            way = T @ square(stated)[:3, :3] @ T.T
            drift, yaw_drift = self._growth.since(way, float(stated[_YAW]), counter)
        return [
            PoseSample(
                t_ns=t_ns,
                x=x,
                y=y,
                z=z,
                yaw=yaw,
                std=std,
                counter=counter,
                yaw_drift=yaw_drift,
                drift=drift,
            )
        ]


def _velocity(
    t_ns: int,
    vector: Sequence[float],
    axes: Axes,
    std: float | None,
    *,
    is_level: bool,
) -> Measurements:
    x, y, z = (sign * vector[axis] for axis, sign in axes)
    if not math.isfinite(x + y + z):
        return []
    return [VelocitySample(t_ns=t_ns, x=x, y=y, z=z, std=std, is_level=is_level)]


def _std(covariance: Sequence[float], diagonal: tuple[int, ...]) -> float | None:
    """Return one sigma of some axes, their mean; None where the source does not know.

    The first element says so by NaN; no camera is sure to the last digit, so zero means the same.
    """
    mean = sum(covariance[place] for place in diagonal) / len(diagonal)
    return math.sqrt(mean) if math.isfinite(mean) and mean > 0.0 else None


def _yaw(q: Sequence[float], axes: Axes) -> float | None:
    """Return the yaw of the body's forward axis in a frame whose z points down; None: not known.

    Args:
        q: From the body to the frame, w x y z.
        axes: How that frame becomes one whose z points down.
    """
    w, x, y, z = q
    norm = w * w + x * x + y * y + z * z
    if not 0.9 < norm < 1.1:
        return None
    forward = (
        1.0 - 2.0 * (y * y + z * z) / norm,
        2.0 * (x * y + w * z) / norm,
        2.0 * (x * z - w * y) / norm,
    )
    north, east, _ = (sign * forward[axis] for axis, sign in axes)
    return math.atan2(east, north)
