"""nav_msgs/Odometry of ROS 2, as what ``Board`` sends, and of what it reads.

A pose of ROS 2 is in a frame whose z points up, of a body whose axes are forward, left, up
(REP 103); its covariance is that of the position and of a rotation about the frame's axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ekf_companion.arrays.board import BoardEstimate
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.relative_pose import FLU_TO_FRD

_BOTH = np.kron(np.eye(2), FLU_TO_FRD)
_NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def read_odometry(m: Any) -> dict[str, Any]:
    """Return what ``Board.send`` takes of a nav_msgs/Odometry, but for the time.

    A covariance of zeros is not known, and a twist of zeros with such a covariance was not filled
    in. An attitude without length is not known either.
    """
    pose, twist = m.pose.pose, m.twist.twist
    p, q, v = pose.position, pose.orientation, twist.linear
    given: dict[str, Any] = {
        "frame": "LOCAL_FRD",
        "position": FLU_TO_FRD @ (p.x, p.y, p.z),
        "pose_covariance": _covariance(m.pose.covariance, 6),
    }
    if q.w or q.x or q.y or q.z:
        given["q"] = np.array((q.w, q.x, -q.y, -q.z))
    P = _covariance(m.twist.covariance, 3)
    if P is not None or v.x or v.y or v.z:
        given["velocity"], given["velocity_covariance"] = FLU_TO_FRD @ (v.x, v.y, v.z), P
    return given


def _covariance(values: Any, size: int) -> Array | None:
    P = np.asarray(values, np.float64).reshape(6, 6)
    if not np.diagonal(P)[:3].any():
        return None
    P = _BOTH @ P @ _BOTH
    whole: Array = 0.5 * (P + P.T)
    return whole[:size, :size]


def write_odometry(
    one: BoardEstimate, t_ns: int, types: Mapping[str, Any], frame: str, body: str
) -> Any | None:
    """Return an estimate as nav_msgs/Odometry, in axes east, north, up.

    Args:
        one: The estimate.
        t_ns: When it was true, unix time, ns.
        types: Classes of messages by name.
        frame: Name of the frame of the pose.
        body: Name of that of the body.

    Returns:
        The message; None: the daemon says that the estimate is not to be used, or its covariance
        is not known.
    """
    P, V = one.pose_covariance, one.velocity_covariance
    if one.quality < 0 or not (np.isfinite(P).all() and np.isfinite(V).all()):
        return None
    _, pitch, yaw = so3.to_euler(one.q_nb).tolist()
    # A rotation vector of changes of roll, pitch and yaw: about x of the body, the node line, down
    cp, sp, cy, sy = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    by_angles = np.array([[cy * cp, -sy, 0.0], [sy * cp, cy, 0.0], [-sp, 0.0, 1.0]])
    T = np.zeros((6, 6))
    T[:3, :3], T[3:, 3:] = _NED_TO_ENU, _NED_TO_ENU @ by_angles
    w, *xyz = so3.to_east_north_up(one.q_nb).tolist()
    vector = types["geometry_msgs/msg/Vector3"]
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](*(_NED_TO_ENU @ one.pos_n).tolist()),
        orientation=types["geometry_msgs/msg/Quaternion"](*xyz, w),
    )
    twist = types["geometry_msgs/msg/Twist"](
        linear=vector(*(FLU_TO_FRD @ one.vel_b).tolist()),
        angular=vector(*(FLU_TO_FRD @ one.rate_b).tolist()),
    )
    seconds, rest = divmod(t_ns, 1_000_000_000)
    return types["nav_msgs/msg/Odometry"](
        header=types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](seconds, rest), frame_id=frame
        ),
        child_frame_id=body,
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, (T @ P @ T.T).ravel()),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, (_BOTH @ V @ _BOTH).ravel()),
    )
