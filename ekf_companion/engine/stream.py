"""Which estimates are sent as ODOMETRY, and what of a correction their receiver is told.

An autopilot takes each ODOMETRY for an independent measurement. So a jump is told by the reset
counter, or kept from it; dead reckoning is sent for a while only, and then silence lets the
autopilot's own failsafe act; and after a start the first message waits for a fix. All follows from
the estimates and their stamps alone, so that a replay sends the same.

Sources: PX4, src/modules/ekf2/EKF/aid_sources/external_vision/ev_pos_control.cpp,
ev_vel_control.cpp, ev_height_control.cpp, ev_yaw_control.cpp, src/modules/mc_pos_control;
ArduPilot, libraries/AP_NavEKF3/AP_NavEKF3_PosVelFusion.cpp, AP_NavEKF3_MagFusion.cpp,
libraries/AC_AttitudeControl/AC_PosControl.cpp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from ekf_companion.config.service import OdometryConfig
from ekf_companion.core.output.follower import NUMBERS, POSITION_LIMITS, Follower
from ekf_companion.engine.autopilot_frame import AutopilotFrame, Place
from ekf_companion.engine.pipeline import QUALITY, Estimate
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.state import Odometry, Status

WAIT_NS = 2 * SECOND_NS
"""A first message waits no longer for the fix that makes it exact."""
HOLDS_OUT_NS = {Family.PX4: 5 * SECOND_NS, Family.ARDUPILOT: 7 * SECOND_NS}
"""So long an autopilot that flies on ODOMETRY holds out without: PX4 gives its position up then
(EKF2_NOAID_TOUT), and EKF3 (``posRetryTimeNoVel_ms``). What a restart has taken is gone of it."""
LEAST_WAIT_NS = SECOND_NS // 2
"""Even where that is over: a fix comes five times a second, and without it the message would end
the flight just as well."""
_RESERVE_NS = SECOND_NS // 2
"""For the way to the autopilot."""
ROUGH_VELOCITY = 1.0
"""One sigma of the velocity over ground, both axes, m/s, from which on a first message does more
harm than a moment of silence. EKF2 takes the velocity of a moved counter with the variance stated,
and PX4 leaves its mode beyond this (COM_VEL_FS_EVH). By a receiver that states 0.5 m/s for an axis
it is 0.7."""
BROKEN_NS = SECOND_NS * 2 // 5
"""After such a silence EKF2 has ended its fusion (twice EV_MAX_INTERVAL), and begins anew."""
LOST_ATTITUDE = 0.35
"""One sigma of an angle from which on an attitude is none, rad: it is being found again."""
FARTHEST = float(2**17)
"""m; further from the origin float32 has steps of more than a centimetre: 1/64 m."""
BEYOND = "too far from the origin for a float32 to carry centimetres"
WAITING = "waiting for the first fix"
_SHIFT = 0.1
"""m; a datum of height that has moved further is told before the next ODOMETRY."""
_BEST, _GOOD = QUALITY[Status.OK], QUALITY[Status.DEGRADED]
_FAILED = QUALITY[Status.INVALID]


@dataclass(frozen=True, slots=True)
class Policy:
    """Which jumps the reset counter tells; the others are kept from the receiver."""

    position: bool
    velocity: bool
    yaw: bool


TELL = Policy(position=True, velocity=True, yaw=True)
SPREAD = Policy(position=False, velocity=False, yaw=False)
POSITION_ONLY = Policy(position=True, velocity=False, yaw=False)
PREFERRED = {Family.ARDUPILOT: POSITION_ONLY}
"""What an autopilot bears best. A moved counter makes EKF2 take position, velocity, height and yaw
as they are sent, and PX4's controller moves its setpoints along. EKF3 takes position and height
only, and ArduPilot's controller moves its targets along; velocity and yaw it refuses beyond their
gates."""


class Offset(NamedTuple):
    """Where a continuous frame c lies in n: ``pos_n = R(yaw) pos_c + shift``."""

    shift: tuple[float, float, float]
    """n, m."""
    yaw: float
    """About down, rad."""


NO_OFFSET = Offset((0.0, 0.0, 0.0), 0.0)


@dataclass(frozen=True, slots=True)
class Jump:
    """A step that no receiver would take for motion."""

    sizes: tuple[float, float, float]
    """Distance (m), speed (m/s) and angle (rad)."""
    is_told: bool
    """Whether the reset counter has moved; else it was kept from the receiver."""


class OdometryStream:
    """Turns the estimates of one vehicle into what its autopilot is sent as ODOMETRY."""

    def __init__(
        self,
        config: OdometryConfig,
        family: Family,
        follower: Follower,
        frame: AutopilotFrame | None = None,
        *,
        is_relative: bool = False,
    ) -> None:
        """Begin with nothing sent.

        Args:
            config: Its limits, and what is told of jumps.
            family: The receiver's.
            follower: What the receiver sees; each inertial sample is appended to its ``samples``.
            frame: The local frame to express positions in; None: that of the estimates.
            is_relative: Whether the covariance leaves out the slow error of the receiver of GNSS.
        """
        self._family, self._is_relative = family, is_relative
        self._follower, self._frame = follower, frame or AutopilotFrame(Family.UNKNOWN)
        self._looked: Odometry | None = None
        self._own: Place | None = None
        """The origin of the estimate that was sent last."""
        self._base: Place | None = None
        """The autopilot's origin that what is sent counts from; None: ours."""
        self._frame_changes = 0
        self.has_new_origin = False
        """Whether it counts from another place than was told; whoever tells it clears this."""
        self.offset = NO_OFFSET
        """Where the frame of what is sent lies in that of the estimates."""
        self._count = 0
        """Resets told so far."""
        self._is_told = False
        """Whether the next message moves the counter."""
        self._resets = 0
        """Of the filter so far, with those that were told beside."""
        self._since_ns: int | None = None
        """Since when there is an estimate, and none was sent yet that is worth to begin with."""
        self._sent_ns: int | None = None
        self._wait_ns = WAIT_NS
        self._is_begun = False
        """Whether the receiver has a stream to go on from."""
        self._unaided = 0
        self._is_oriented = False
        """Whether an attitude that is known was there in this run."""
        self.silence = ""
        """Why nothing is sent of an estimate that is there, in a few words; empty: it is sent."""
        self.jump: Jump | None = None
        """The last."""
        self.jumps = 0
        """How many there were."""
        self.retune(config)

    def retune(self, config: OdometryConfig) -> None:
        """Go on with other limits, and tell jumps or spread them as is configured."""
        self._config = config
        self.is_continuous = config.frame == "continuous"
        """Whether a jump of position and yaw moves the frame."""
        auto = PREFERRED.get(self._family, TELL)
        self._policy = {"auto": auto, "tell": TELL, "spread": SPREAD}[config.jumps]
        if self.is_continuous:
            self._policy = SPREAD

    @property
    def is_running(self) -> bool:
        """Whether ODOMETRY is sent, as far as the estimate decides."""
        return self._is_begun

    @property
    def told(self) -> int:
        """How often the counter has moved."""
        return self._count

    def on_restart(self, lost: float) -> None:
        """Wait for the first fix as long as the follower holds out that heard nothing for s."""
        left_ns = HOLDS_OUT_NS.get(self._family, WAIT_NS) - round(lost * SECOND_NS) - _RESERVE_NS
        self._wait_ns = max(left_ns, LEAST_WAIT_NS)

    def look(self, estimate: Estimate) -> Odometry | None:
        """Look at an estimate: 30 times a second or more, whether it is sent or not."""
        odometry, follower, last = estimate.odometry, self._follower, self._looked
        self._looked = odometry
        if odometry is None:
            follower.forget()
            self._is_begun, self.silence = False, ""
            return None
        stated = (0.0, 0.0, 0.0)
        if last is not None and last.quality >= _GOOD:
            position = follower.std_position if last.quality == _BEST else 0.0
            stated = position, follower.std_velocity, follower.std_yaw
        relative = odometry.relative if self._is_relative else None
        has_step = follower.look(odometry.t_ns, odometry.numbers, stated, relative)
        # A reset of the filter is told even if it moved nothing much, and so is a return
        is_reset, self._resets = odometry.reset_count != self._resets, odometry.reset_count
        self._is_told |= last is None or (is_reset and self._policy.position)
        if has_step:
            self._is_begun &= follower.step[0] * 1e9 < BROKEN_NS
            if True in follower.jumps:
                self._is_told |= self._take_jump(*follower.jumps)
        return odometry

    def _take_jump(self, position: bool, velocity: bool, yaw: bool) -> bool:
        """Keep a jump from the receiver in the parts that are not told; return whether one is."""
        policy, follower = self._policy, self._follower
        is_told = (position and policy.position) or (velocity and policy.velocity)
        is_told |= yaw and policy.yaw
        if self.is_continuous:
            follower.spread(False, velocity, False)
            if position or yaw:
                follower.move_frame()
                *shift, angle = follower.offset
                self.offset = Offset((shift[0], shift[1], shift[2]), angle)
        else:
            follower.spread(
                position and not policy.position,
                velocity and not policy.velocity,
                yaw and not policy.yaw,
            )
        if self._sent_ns is not None:
            _, x, y, z, vx, vy, vz, angle = follower.step
            self.jump = Jump((math.hypot(x, y, z), math.hypot(vx, vy, vz), abs(angle)), is_told)
            self.jumps += 1
        return is_told

    def _tell(self, estimate: Estimate) -> None:
        """Move the counter, for this run and for one that goes on from here."""
        self._count += 1
        if self._policy.position:
            self._count = max(self._count, self._resets)
        if self._count > self._resets:
            estimate.add_resets(self._count - self._resets)
            self._resets = self._count

    def send(
        self, estimate: Estimate, climb_factor: float = 1.0, *, is_local: bool = False
    ) -> Odometry | None:
        """Look at an estimate, and return what is sent of it; None: nothing.

        Where a stream ends, its last message has the quality of a failure.

        Args:
            estimate: The newest.
            climb_factor: Multiplies the variance of the velocity down.
            is_local: Whether the velocity is to be along the local axes, not those of b.
        """
        odometry = self.look(estimate)
        own = estimate.origin if odometry is None else odometry.origin
        if own != self._own or self._frame.changes != self._frame_changes:
            self._count_from(own)
        if odometry is None:
            return None
        was_begun, was_silent, quality = self._is_begun, bool(self.silence), odometry.quality
        follower = self._follower
        is_usual = was_begun and self._is_oriented and quality >= _GOOD
        is_usual = is_usual and follower.std_attitude <= LOST_ATTITUDE
        if not is_usual or max(map(abs, follower.pos_n)) > FARTHEST:
            self.silence = self._reason(estimate, odometry)
        if self.silence:
            self._is_begun = False
            if not was_begun or self.silence == BEYOND:
                return None
            quality = _FAILED
        else:
            if self._sent_ns is None:
                # Whatever was corrected before, nobody has seen
                self._count, self._is_told, self.offset = self._resets, False, NO_OFFSET
                follower.clear(True)
            elif was_silent:
                self._end_silence(estimate.t_ns - self._sent_ns)
            if self._is_told:
                self._tell(estimate)
            self._is_begun, self._is_told = True, False
            self._since_ns, self._sent_ns = None, estimate.t_ns
        # Without an aid they share one error: together they say no more than the first of them
        self._unaided = self._unaided + 1 if quality < _GOOD else 0
        numbers = follower.express(climb_factor, max(self._unaided, 1), is_local)
        return Odometry(odometry.t_ns, numbers, self._count, quality)

    def _count_from(self, own: Place | None) -> None:
        """Count from another place; where that is a jump, the counter moves."""
        frame = self._frame
        last, self._own = self._own, own
        was, self._base = self._base, frame.origin
        self._frame_changes = frame.changes
        self._follower.place = frame.place(own)
        has_shifted = abs(frame.datum - frame.told_datum) > _SHIFT
        is_other = own is not None and (was or last) != (self._base or own)
        if own not in (None, last) or is_other or has_shifted:
            frame.told_datum, self.has_new_origin = frame.datum, True
            if was != self._base and last is not None:
                self._is_told |= frame.distance(was or last) > POSITION_LIMITS[0]

    def _end_silence(self, span_ns: int) -> None:
        """Drop what was to be spread and move the counter: whoever ended its fusion begins anew."""
        if span_ns <= BROKEN_NS or self.is_continuous:
            return
        self._is_told |= self._policy == SPREAD or self._follower.is_spreading
        self._follower.clear(False)

    def _reason(self, estimate: Estimate, odometry: Odometry) -> str:
        """Return why an estimate is not worth to be sent; empty: it is."""
        config, follower = self._config, self._follower
        if odometry.quality < 0:
            return "the estimate is invalid"
        if max(map(abs, follower.pos_n)) > FARTHEST:
            return BEYOND
        # After a restart it is sent as it is: a longer silence would end the autopilot's flight
        is_lost = follower.std_attitude > LOST_ATTITUDE
        if is_lost and self._is_oriented:
            return "the attitude is being found again"
        self._is_oriented |= not is_lost
        is_good = odometry.quality >= _GOOD
        if not self._is_begun and self._is_waiting(estimate, is_good):
            return WAITING
        if is_good:
            return ""
        if estimate.unaided_s > config.dead_reckoning_time:
            return f"dead reckoning over {config.dead_reckoning_time:g} s"
        # By all of the error over ground, whatever of it is told
        if std_horizontal(odometry) > config.dead_reckoning_std:
            return f"dead reckoning beyond {config.dead_reckoning_std:g} m"
        return ""

    def _is_waiting(self, estimate: Estimate, is_good: bool) -> bool:
        """Whether a fix that is still to come would make the first message much better."""
        if self._since_ns is None or estimate.t_ns < self._since_ns:
            self._since_ns = estimate.t_ns
        if estimate.t_ns - self._since_ns >= self._wait_ns:
            return False
        is_rough = self._follower.std_ground_speed() > ROUGH_VELOCITY
        return not is_good or estimate.is_reset_due or is_rough


def std_horizontal(odometry: Odometry) -> float:
    """Return one sigma of the horizontal position, m; infinite if it is not known."""
    numbers = NUMBERS.unpack(odometry.numbers)
    is_known = math.isfinite(numbers[13]) and math.isfinite(numbers[34])
    return math.sqrt(numbers[13] + numbers[19]) if is_known else math.inf
