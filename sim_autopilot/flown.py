"""Whether an autopilot that flies on our ODOMETRY flies better than on its own receiver.

Two followers beside a bench, with the same inertial samples: one takes the companion's ODOMETRY as
it reaches the autopilot, the other the fixes and a heading of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from sim_autopilot.follower import Follower, Motion, Tuning
from sim_autopilot.loop import Bench, Peer

_EVERY = 25
"""Samples between two comparisons of the followers' motion."""
_COMPASS_STD = 0.03
"""rad; of the heading of the follower that has a receiver."""
_HEAD_NOISE = 0.3
"""One sigma that the filter assumes for it, rad (EKF2_HEAD_NOISE)."""
_LAGS = np.arange(-0.1, 0.1001, 0.005)
"""s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """RMS errors of a follower, and its lead."""

    horizontal: float
    """m, without the constant offset of the frames."""
    vertical: float
    """m, likewise."""
    velocity: float
    """m/s."""
    tilt: float
    """rad, of roll and pitch."""
    yaw: float
    """rad."""
    lead: float
    """s; how far its velocity is ahead of the truth."""
    bias: float
    """Largest accelerometer bias that it estimated, m/s^2."""
    rejected: int
    """Number of measurements beyond their gates."""
    events: tuple[tuple[float, str], ...]
    """Resets, each with its time, s."""


class _Tap:
    """A peer whose ODOMETRY is also kept, as fields, in the order of sending."""

    def __init__(self, peer: Peer) -> None:
        self.kept: list[Any] = []
        self._peer, self._splitter = peer, Splitter()

    def receive(self, data: bytes, now_ns: int) -> object:
        return self._peer.receive(data, now_ns)

    def tick(self, now_ns: int) -> object:
        return self._peer.tick(now_ns)

    def data_to_send(self) -> list[bytes]:
        out = self._peer.data_to_send()
        for data in out:
            for frame in self._splitter.feed(data):
                if frame.message_id == IDS["ODOMETRY"]:
                    self.kept.append(unpack(frame))
        return out


def fly(
    bench: Bench,
    tuning: Tuning,
    after: float = 20.0,
    change: Callable[[Any], Any] = lambda message: message,
) -> tuple[Result, Result]:
    """Run a bench with two followers.

    Args:
        bench: With the companion as its peer.
        tuning: Of both followers.
        after: Scored from so many seconds of flight on.
        change: Applied to each ODOMETRY before it is fused.

    Returns:
        The result on ODOMETRY, and on the receiver.
    """
    assert bench.peer is not None
    tap = _Tap(bench.peer)
    bench.peer = tap
    on_ours, on_gnss = Follower(tuning), Follower(tuning)
    motions: tuple[list[Motion], list[Motion]] = ([], [])
    receiver = _Receiver(bench, on_gnss)
    begin = bench.flight.first_ns * 1e-9 + after
    for count, (t, gyro, accel) in enumerate(_samples(bench, receiver)):
        for follower in (on_ours, on_gnss):
            follower.sample(t, gyro, accel)
        messages, tap.kept = tap.kept, []
        for message in messages:
            on_ours.odometry(change(message))
        if count % _EVERY == 0 and t > begin:
            motions[0].append(on_ours.motion())
            motions[1].append(on_gnss.motion())
    return _score(bench, on_ours, motions[0]), _score(bench, on_gnss, motions[1])


class _Receiver:
    """Passes the fixes, and a heading with each, to the follower that has a receiver."""

    def __init__(self, bench: Bench, follower: Follower) -> None:
        self._bench, self._follower = bench, follower
        self._rng = np.random.default_rng(bench.flight.seed)
        self._frame: LocalFrame | None = None

    def take(self, m: Any) -> None:
        """Take a GPS_RAW_INT."""
        if m.fix_type < 3 or m.time_usec == 0:
            return
        config = self._bench.flight.config.gnss
        t = m.time_usec * 1e-6 - config.delay
        lat, lon, alt = np.deg2rad(m.lat * 1e-7), np.deg2rad(m.lon * 1e-7), m.alt * 1e-3
        self._frame = self._frame or LocalFrame(float(lat), float(lon), float(alt))
        truth = self._bench.flight.truth_at(np.array([round(t * 1e9)]))
        course = np.deg2rad(m.cog * 1e-2)
        down = truth.vel_n[0, 2] + config.noise_vel * self._rng.normal()
        vel_n = np.array([m.vel * 1e-2 * np.cos(course), m.vel * 1e-2 * np.sin(course), down])
        yaw = float(truth.euler[0, 2]) + _COMPASS_STD * self._rng.normal()
        self._follower.heading(t, yaw, _HEAD_NOISE)
        stds = (m.h_acc * 1e-3, m.v_acc * 1e-3, m.vel_acc * 1e-3)
        self._follower.fix(t, self._frame.to_ned(lat, lon, alt), vel_n, stds)


def _samples(bench: Bench, receiver: _Receiver) -> Iterator[tuple[float, Array, Array]]:
    """Run the bench; yield its inertial samples, and pass its fixes on."""
    splitter = Splitter()
    for _, data in bench.frames():
        for frame in splitter.feed(data):
            if frame.message_id == IDS["GPS_RAW_INT"]:
                receiver.take(unpack(frame))
            elif frame.message_id == IDS["HIGHRES_IMU"]:
                m = unpack(frame)
                gyro, accel = (m.xgyro, m.ygyro, m.zgyro), (m.xacc, m.yacc, m.zacc)
                yield m.time_usec * 1e-6, np.array(gyro), np.array(accel)


def _score(bench: Bench, follower: Follower, motions: list[Motion]) -> Result:
    t = np.array([one.t for one in motions])
    vel_n = np.array([one.vel_n for one in motions])

    def truth_at(shift: float) -> Any:
        return bench.flight.truth_at(np.round((t + shift) * 1e9).astype(np.int64))

    truth = truth_at(0.0)
    offset = np.array([one.pos_n for one in motions]) - truth.pos_n
    offset -= np.median(offset, axis=0)
    euler = so3.wrap(so3.to_euler(np.array([one.q_nb for one in motions])) - truth.euler)
    costs = [_rms((vel_n - truth_at(lag).vel_n)[:, :2]) for lag in _LAGS]
    return Result(
        horizontal=_rms(np.hypot(offset[:, 0], offset[:, 1])),
        vertical=_rms(offset[:, 2]),
        velocity=_rms(np.linalg.norm(vel_n - truth.vel_n, axis=1)),
        tilt=_rms(np.hypot(euler[:, 0], euler[:, 1])),
        yaw=_rms(euler[:, 2]),
        lead=float(_LAGS[int(np.argmin(costs))]),
        bias=follower.worst_bias,
        rejected=follower.rejected,
        events=tuple(follower.events),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
