"""The daemon on this board, for a program beside it: poses and velocities in, estimates out.

Both ways are MAVLink over UDP, so that any program in any language may do the same: ODOMETRY to
``link.aid_url``, ODOMETRY and GPS_GLOBAL_ORIGIN from an address of ``output.monitors``.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from ekf_companion.errors import DataError
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.relative_pose import UPPER, square

FrameName = Literal["LOCAL_NED", "LOCAL_ENU", "LOCAL_FRD", "LOCAL_FLU"]
_FRAMES = {"LOCAL_NED": 1, "LOCAL_ENU": 4, "LOCAL_FRD": 20, "LOCAL_FLU": 21}
"""MAV_FRAME."""
_BODY_FRD, _VIO = 12, 3
_ODOMETRY, _ORIGIN = IDS["ODOMETRY"], IDS["GPS_GLOBAL_ORIGIN"]
_UNKNOWN = (math.nan,) * 3
_LARGEST = 65536


class BoardOrigin(NamedTuple):
    """Where the positions of the estimates count from."""

    lat_deg: float
    lon_deg: float
    alt: float
    """Above mean sea level, m."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardEstimate:
    """An estimate of the daemon."""

    t_ns: int
    """When it was true, autopilot's clock, ns."""
    received_ns: int
    """When it was received, unix time, ns."""
    pos_n: Array
    """North, east, down of the origin, m, shape (3,)."""
    q_nb: Array
    """From the body (forward, right, down) to north, east, down; w first, shape (4,)."""
    vel_b: Array
    """Forward, right, down, m/s, shape (3,)."""
    rate_b: Array
    """Angular rate, rad/s, shape (3,)."""
    pose_covariance: Array
    """Of position (m) and roll, pitch, yaw (rad), shape (6, 6)."""
    velocity_covariance: Array
    """Of the velocity (m/s) and the rates, shape (6, 6)."""
    resets: int
    """Changes with every jump, from 1 to 255 and on from 1."""
    quality: int
    """100 all aids, 50 one is missing, 20 dead reckoning, -1 do not use it."""


class Board:
    """The daemon of this board: send it poses and velocities, and read its estimates.

    A context manager; without it call :meth:`close`.
    """

    def __init__(
        self,
        aid_port: int = 14560,
        estimate_port: int | None = None,
        *,
        host: str = "127.0.0.1",
        system_id: int = 240,
        component_id: int = 197,
    ) -> None:
        """Make ready to send, and to receive if a port is given.

        Args:
            aid_port: That of ``link.aid_url``.
            estimate_port: That of ``udpout:127.0.0.1:PORT`` in ``output.monitors``; None: no
                estimate is read.
            host: Where the daemon is.
            system_id: Ours: the autopilot's, or 240 and higher.
            component_id: Ours: 197 is visual-inertial odometry.

        Raises:
            OSError: The port for the estimates is taken.
        """
        self.origin: BoardOrigin | None = None
        """Of the estimates that were read; None: not known yet."""
        self._sender = Sender(system_id, component_id)
        self._target = host, aid_port
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._estimates: socket.socket | None = None
        self._splitter = Splitter()
        if estimate_port is not None:
            self._estimates = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                self._estimates.bind(("127.0.0.1", estimate_port))
            except OSError:
                self.close()
                raise

    def __enter__(self) -> Board:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the sockets."""
        for one in (self._socket, self._estimates):
            if one is not None:
                one.close()

    def send(
        self,
        *,
        t: float | None = None,
        position: Sequence[float] | Array | None = None,
        q: Sequence[float] | Array | None = None,
        velocity: Sequence[float] | Array | None = None,
        pose_covariance: Any = None,
        velocity_covariance: Any = None,
        frame: FrameName = "LOCAL_FRD",
        is_body_velocity: bool = True,
        reset_counter: int = 0,
        quality: int = 100,
    ) -> None:
        """Send what another estimator has found: a pose, a velocity, or both.

        Args:
            t: When it was true, unix time of this board (``time.time()``): s, or whole ns; None:
                now.
            position: In its own frame, m, shape (3,); None: not known.
            q: From the body (forward, right, down) to that frame, w first, shape (4,); None: not
                known.
            velocity: m/s, shape (3,); None: not known.
            pose_covariance: Of position (m) and roll, pitch, yaw (rad), shape (6, 6), or of the
                position only, (3, 3); None: not known.
            velocity_covariance: Of the velocity (m/s), shape (3, 3); None: not known.
            frame: Which axes its own frame has.
            is_body_velocity: Whether the velocity is along the body's axes (forward, right, down),
                else along those of the frame.
            reset_counter: Another number says that a new frame has begun.
            quality: 1 to 100 per cent, -1 if it has failed.

        Raises:
            DataError: An array has another shape or holds what is no number, q is no rotation, or
                there is neither a position nor a velocity.
        """
        if position is None and velocity is None:
            raise DataError("send: neither position nor velocity; give one of them")
        turn = _numbers("q", q, (4,), (0.0, 0.0, 0.0, 0.0))
        if q is not None and abs(np.linalg.norm(turn) - 1.0) > 1e-3:
            raise DataError(f"q: {turn.tolist()} has length {np.linalg.norm(turn):.3f}, not 1")
        if frame not in _FRAMES:
            raise DataError(f"frame: {frame!r:.60} is none of {', '.join(_FRAMES)}")
        now_ns = time.time_ns()
        at_ns = (
            now_ns if t is None else int(t) if isinstance(t, int | np.integer) else round(t * 1e9)
        )
        if abs(at_ns - now_ns) > 10**12:
            raise DataError(
                f"t: {t} is not unix time of now, {now_ns * 1e-9:.0f} s; take time.time()"
            )
        place = _numbers("position", position, (3,), _UNKNOWN)
        speed = _numbers("velocity", velocity, (3,), _UNKNOWN)
        said = self._sender.message(
            "ODOMETRY",
            time_usec=at_ns // 1000,
            frame_id=_FRAMES[frame],
            child_frame_id=_BODY_FRD if is_body_velocity else _FRAMES[frame],
            **dict(zip(("x", "y", "z"), place.tolist(), strict=True)),
            q=turn.tolist(),
            **dict(zip(("vx", "vy", "vz"), speed.tolist(), strict=True)),
            pose_covariance=_triangle("pose_covariance", pose_covariance),
            velocity_covariance=_triangle("velocity_covariance", velocity_covariance),
            reset_counter=reset_counter % 256,
            estimator_type=_VIO,
            quality=quality,
        )
        self._socket.sendto(said, self._target)

    def read(self, timeout: float | None = None) -> BoardEstimate | None:
        """Return the next estimate; None if none comes in time.

        Args:
            timeout: Longest wait, s; None: for as long as it takes.

        Raises:
            DataError: No port was given to receive estimates at.
        """
        if self._estimates is None:
            raise DataError("read: give estimate_port, and that port in output.monitors")
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            left = None if end is None else max(end - time.monotonic(), 0.0)
            self._estimates.settimeout(left or (None if end is None else 1e-6))
            try:
                data = self._estimates.recv(_LARGEST)
            except (TimeoutError, BlockingIOError):
                return None
            received_ns = time.time_ns()
            for frame in self._splitter.feed(data):
                if frame.message_id == _ORIGIN:
                    m = unpack(frame)
                    self.origin = BoardOrigin(
                        m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3
                    )
                elif frame.message_id == _ODOMETRY:
                    return _estimate(unpack(frame), received_ns)


def _numbers(name: str, values: Any, shape: tuple[int, ...], missing: Sequence[float]) -> Array:
    if values is None:
        return np.array(missing)
    found = np.asarray(values, dtype=float)
    if found.shape != shape or not np.isfinite(found).all():
        raise DataError(f"{name}: {values!r:.60} is not {shape[0]} finite numbers")
    return found


def _triangle(name: str, covariance: Any) -> list[float]:
    """Return the upper triangle of a covariance, row by row; NaN first where it is not known."""
    if covariance is None:
        return [math.nan] * 21
    given = np.asarray(covariance, dtype=float)
    if given.shape not in ((3, 3), (6, 6)) or not np.isfinite(given).all():
        raise DataError(f"{name}: is not a finite array of shape (3, 3) or (6, 6)")
    if not (np.allclose(given, given.T) and np.diagonal(given).min() >= 0.0):
        raise DataError(f"{name}: is not symmetric, or has a negative variance")
    whole = np.full((6, 6), math.nan)
    whole[: len(given), : len(given)] = given
    triangle: list[float] = whole[UPPER].tolist()
    return triangle


def _estimate(m: Any, received_ns: int) -> BoardEstimate:
    return BoardEstimate(
        t_ns=m.time_usec * 1000,
        received_ns=received_ns,
        pos_n=np.array([m.x, m.y, m.z]),
        q_nb=np.array(m.q),
        vel_b=np.array([m.vx, m.vy, m.vz]),
        rate_b=np.array([m.rollspeed, m.pitchspeed, m.yawspeed]),
        pose_covariance=square(np.array(m.pose_covariance)),
        velocity_covariance=square(np.array(m.velocity_covariance)),
        resets=m.reset_counter,
        quality=m.quality,
    )
