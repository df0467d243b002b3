"""Recorded flights of simulated autopilots, through a companion: what it would send them today."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from pymavlink.generator.mavcrc import x25crc

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.intake import open_live
from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from tests.paths import DATA

OURS = 194


@cache
def frames(flight: str) -> list[tuple[int, bytes]]:
    """Return the frames of a flight that are not ours, with their stamps, ns; skip without it."""
    path = DATA / flight / "flight.tlog"
    if not path.is_file():
        pytest.skip(f"the recorded flight {flight} is not beside this checkout")
    return [
        (stamp_us * 1000, frame)
        for stamp_us, frame in tlog.read(path).frames()
        if frame[6 if frame[0] == 0xFD else 4] != OURS
    ]


def configured(**odometry: Any) -> Config:
    """Return a configuration that streams whatever the autopilot's parameters are."""
    return Config(output=OutputConfig(odometry=OdometryConfig(mode="always", **odometry)))


@cache
def sent(
    flight: str,
    *names: str,
    autopilot: int | None = None,
    until: float = np.inf,
    weigh: str = "off",
    **odometry: Any,
) -> list[Any]:
    """Return what a companion publishes during a flight, of the named messages.

    ``autopilot`` is a MAV_AUTOPILOT that the recorded heartbeats are to name instead; the flight
    is fed until an ODOMETRY is for a later time than ``until``, s since boot. ``weigh`` is the
    setting ``weigh_faults``.
    """
    found = []
    config = replace(configured(**odometry), weigh_faults=weigh)
    for message in flown(flight, names, config, autopilot):
        if hasattr(message, "quality") and message.time_usec > until * 1e6:
            break
        found.append(message)
    return found


def flown(
    flight: str, names: tuple[str, ...], config: Config, autopilot: int | None = None
) -> Iterator[Any]:
    """Yield the published messages of some names."""
    companion = Companion(config, open_pipeline=open_live)
    for now_ns, recorded in frames(flight):
        frame = recorded if autopilot is None else with_autopilot(recorded, autopilot)
        for name, payload, _ in companion.receive(frame, now_ns):
            if name in names:
                yield unpack(Frame(IDS[name], 1, OURS, 0, payload, b"", 2))
        companion.frames_to_send()


def with_autopilot(frame: bytes, autopilot: int) -> bytes:
    """Return a frame; a HEARTBEAT of MAVLink 2 with another autopilot in it."""
    if frame[0] != 0xFD or int.from_bytes(frame[7:10], "little") != IDS["HEARTBEAT"]:
        return frame
    body = bytearray(frame[1:-2])
    body[9 + 5] = autopilot
    crc = x25crc(bytes([*body, 50])).crc  # the CRC_EXTRA of HEARTBEAT
    return frame[:1] + bytes(body) + crc.to_bytes(2, "little")


class Sent:
    """ODOMETRY as columns."""

    def __init__(self, messages: list[Any]) -> None:
        self.t = np.array([m.time_usec for m in messages]) * 1e-6
        self.pos_n = np.array([(m.x, m.y, m.z) for m in messages])
        q = np.array([m.q for m in messages])
        said = np.array([(m.vx, m.vy, m.vz) for m in messages])
        is_local = np.array([m.child_frame_id == 1 for m in messages])
        self.vel_n = np.where(is_local[:, None], said, so3.rotate(q, said))
        self.yaw = so3.to_euler(q)[:, 2]
        self.count = np.array([m.reset_counter for m in messages])
        self.quality = np.array([m.quality for m in messages])
        cov = np.array([m.pose_covariance for m in messages])
        self.sd = np.sqrt(cov[:, 0] + cov[:, 6])

    def steps(self) -> np.ndarray:
        """Return the distance that each message moves beside its velocity, shape (n - 1,)."""
        dt = np.diff(self.t)[:, None]
        moved = np.diff(self.pos_n, axis=0) - 0.5 * dt * (self.vel_n[1:] + self.vel_n[:-1])
        return np.linalg.norm(moved, axis=1)


def odometry(flight: str, **odometry: Any) -> Sent:
    """Return the ODOMETRY that a companion sends during a flight."""
    return Sent(sent(flight, "ODOMETRY", **odometry))
