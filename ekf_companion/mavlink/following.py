"""Whether the autopilot follows: while it fuses our ODOMETRY, its own estimate must be ours.

It may refuse what we send, get it late, be fed by somebody else as well, or have lost its aid and
not said so. All of that shows in one place: the distance between its estimate and ours at the same
time. Who is right does not matter for that.

An ArduPilot whose source sets are alternatives may be on its own receiver, and nothing in its
telemetry tells. It is watched once it has been near to ours; the words then only name the distance.
PX4 keeps an offset of heights, and may count from an origin that it has not told, so only what it
moves since it began to follow counts.

How far is too far: beyond its gates an autopilot refuses ours (the table in docs/ODOMETRY.md,
"Jumps"), so within them nothing is said.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from ekf_companion.mavlink.decision import Decision, Hold
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, FollowingChanged, PeerFound
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_POSITION = 1.4
"""m, horizontal and vertical: where EKF3 begins to refuse positions; EKF2 resets to ours before."""
_VELOCITY = 0.87
"""m/s, likewise."""
_YAW = math.radians(15.0)
"""EKF2's gate; EKF3's is 34 deg."""
_LAG = 0.1
"""s; a follower may be so late without harm: its places and velocities are off by what is moved and
turned in that time. EKF2 and EKF3 are late by 0.01 to 0.03 s (docs/SITL.md)."""
_GRACE_NS = 3 * SECOND_NS
"""After ODOMETRY began or jumped: EKF3 takes a velocity beyond its gate within that."""
_WINDOW, _MANY = 10, 4
"""Of the comparisons of the last two seconds, so many must be too far before it is said: 0.8 s, or
by turns, as where two sources are fused by turns."""
_CALM_NS = 2 * SECOND_NS
"""So long it must be near again."""
_NEAR_NS = 5 * SECOND_NS
"""So long it must have been near before it counts as following, where it can choose."""
_BASE_NS = 2 * SECOND_NS
"""Over which the offset of PX4's frame is learnt."""
_CALM = 0.5
"""Of the limits: nearer than that is near again."""
_MOVING = 2.0
"""m/s; slower no lag shows."""
_LAG_MEMORY = 10
"""Comparisons over which the lag is a mean: two seconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Separation:
    """What the autopilot's estimate is off what it is sent, at one time: theirs less ours."""

    t_ns: int
    """On the autopilot's clock."""
    pos_n: tuple[float, float, float]
    """North, east, down, m."""
    vel_n: tuple[float, float, float]
    """m/s."""
    yaw: float = math.nan
    """rad; NaN: not known."""
    moving: tuple[float, float] = (0.0, 0.0)
    """Our velocity north and east, m/s."""
    turning: float = 0.0
    """Our acceleration, m/s^2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """How far the autopilot is from what it is sent; NaN: not known."""

    is_watched: bool = False
    """Whether it fuses ours, so that both must be the same."""
    apart: str = ""
    """What is too far, in a few words; empty: nothing."""
    horizontal: float = math.nan
    """m."""
    vertical: float = math.nan
    """m, up."""
    velocity: float = math.nan
    """m/s."""
    yaw: float = math.nan
    """rad."""
    lag: float = math.nan
    """How late it is along the way, s; known while it moves."""


class Following(Service):
    """Watches whether the autopilot follows ODOMETRY."""

    def __init__(
        self,
        emit: Emit,
        decision: Callable[[], Decision],
        is_sent: Callable[[], bool],
        *,
        withholds: bool = False,
    ) -> None:
        """Begin with nothing compared.

        Args:
            emit: Takes the events.
            decision: Returns what the guard knows of the autopilot.
            is_sent: Returns whether ODOMETRY may be sent.
            withholds: Whether nothing is sent while it does not follow.
        """
        self.withholds = withholds
        """Whether nothing is sent while it does not follow."""
        self._emit, self._decision, self._is_sent = emit, decision, is_sent
        self._family = Family.UNKNOWN
        self._forget()

    def _forget(self) -> None:
        self.hold = None
        self.state = State()
        """Of the last comparison."""
        self._settled_ns: int | None = None
        """From when on it is judged; None: ODOMETRY has not begun."""
        self._near_ns: int | None = None
        """Since when it is near."""
        self._far: deque[bool] = deque(maxlen=_WINDOW)
        """Which of the last comparisons were too far."""
        self._has_followed = False
        self._base: list[tuple[float, float, float]] = []
        self._base_ns: int | None = None

    def begin(self, peer: PeerFound) -> None:
        """Begin anew with an autopilot."""
        self._forget()
        self._family = peer.family

    def end(self) -> None:
        """Forget the autopilot."""
        self._forget()

    def note_jump(self) -> None:
        """Learn that what is sent has jumped, or begun again: it takes a moment to follow."""
        self._settled_ns = None

    def judge(self, separation: Separation, *, is_running: bool) -> None:
        """Judge one comparison; ``is_running`` is whether there is an estimate worth to be sent."""
        decision, t_ns = self._decision(), separation.t_ns
        is_fused = decision.is_fused and bool(decision.parameters)
        if not (is_fused and is_running and (self._is_sent() or self.hold is not None)):
            self._settled_ns = self._near_ns = self._base_ns = None
            self._far.clear()
            self._has_followed = False
            self._base.clear()
            self._show(replace(_measured(separation), lag=math.nan))
            self.hold = None
            return
        if self._settled_ns is None:
            self._settled_ns = t_ns + _GRACE_NS
            self._far.clear()
            self._base.clear()
            self._base_ns = None
        separation = self._without_offset(separation)
        if decision.is_alternative:
            # on its own sensors its height is the barometer's, and ours is sent above its datum
            separation = replace(separation, pos_n=(*separation.pos_n[:2], 0.0))
        state = _measured(separation)
        if math.isfinite(self.state.lag) and math.isfinite(state.lag):
            share = 1.0 / _LAG_MEMORY
            state = replace(state, lag=self.state.lag + share * (state.lag - self.state.lag))
        excess = _excess(state, separation)
        self._near_ns = (self._near_ns or t_ns) if excess < _CALM else None
        if self._near_ns is not None and t_ns - self._near_ns >= _NEAR_NS:
            self._has_followed = True
        is_watched = t_ns >= self._settled_ns
        is_watched = is_watched and (self._has_followed or not decision.is_alternative)
        self._far.append(is_watched and excess > 1.0)
        apart = self.state.apart
        if self._far[-1] and sum(self._far) >= _MANY:
            apart = _words(state, separation)
        elif self._near_ns is not None and t_ns - self._near_ns >= _CALM_NS:
            apart = ""
        self._show(replace(state, is_watched=is_watched, apart=apart))
        self.hold = self._held() if self.withholds else None

    def _without_offset(self, separation: Separation) -> Separation:
        """Return a separation without the offset that PX4 keeps between its frame and ours."""
        if self._family is Family.ARDUPILOT:
            return separation
        t_ns = separation.t_ns
        self._base_ns = t_ns if self._base_ns is None else self._base_ns
        if t_ns - self._base_ns <= _BASE_NS or not self._base:
            self._base.append(separation.pos_n)
        n = len(self._base)
        mean = [sum(one[axis] for one in self._base) / n for axis in range(3)]
        north, east, down = (a - b for a, b in zip(separation.pos_n, mean, strict=True))
        return replace(separation, pos_n=(north, east, down))

    def _held(self) -> Hold | None:
        if not self.state.apart:
            return None
        return Hold(
            reason=f"the autopilot's own estimate is not ours: {self.state.apart}",
            remedy="output.odometry.not_followed: tell would go on",
            text="autopilot does not follow",
        )

    def _show(self, state: State) -> None:
        """Keep a state; emit that it follows, or does not, where that has changed."""
        was, self.state = self.state, state
        if bool(was.apart) != bool(state.apart):
            self._emit(FollowingChanged(state.apart, self._decision().is_alternative))


def _measured(separation: Separation) -> State:
    north, east, down = separation.pos_n
    vn, ve = separation.moving
    speed = math.hypot(vn, ve)
    return State(
        horizontal=math.hypot(north, east),
        vertical=-down,
        velocity=math.hypot(*separation.vel_n),
        yaw=separation.yaw,
        lag=-(north * vn + east * ve) / speed**2 if speed > _MOVING else math.nan,
    )


def _limits(separation: Separation) -> tuple[float, float]:
    """Return how far off place and velocity may be, m and m/s: a follower is a little late."""
    speed = math.hypot(*separation.moving)
    return _POSITION + _LAG * speed, _VELOCITY + _LAG * separation.turning


def _excess(state: State, separation: Separation) -> float:
    """Return the largest of all distances, by its limit."""
    position, velocity = _limits(separation)
    yaw = 0.0 if math.isnan(state.yaw) else abs(state.yaw) / _YAW
    return max(
        state.horizontal / position,
        abs(state.vertical) / _POSITION,
        state.velocity / velocity,
        yaw,
    )


def _words(state: State, separation: Separation) -> str:
    """Return what is too far, in a few words: the worst first in the order of danger."""
    position, velocity = _limits(separation)
    parts = []
    if state.horizontal > position:
        parts.append(f"{state.horizontal:.1f} m off")
    if abs(state.vertical) > _POSITION:
        where = "above" if state.vertical > 0.0 else "below"
        parts.append(f"{abs(state.vertical):.1f} m {where}")
    if state.velocity > velocity:
        parts.append(f"{state.velocity:.1f} m/s off")
    if not math.isnan(state.yaw) and abs(state.yaw) > _YAW:
        parts.append(f"yaw {math.degrees(abs(state.yaw)):.0f} deg off")
    return ", ".join(parts)
