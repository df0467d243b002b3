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

from dataclasses import dataclass

from ekf_companion.config.service import OdometryConfig
from ekf_companion.engine.pipeline import QUALITY, Estimate
from ekf_companion.engine.residual import (
    Offset,
    Residual,
    scale_errors,
    state_covariance,
    std_attitude,
    std_ground_speed,
    stds,
)
from ekf_companion.engine.step import POSITION, JumpDetector, Pose, Step, StepMeter, to_pose
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


@dataclass(frozen=True, slots=True)
class Jump:
    """A step that no receiver would take for motion."""

    step: Step
    is_told: bool
    """Whether the reset counter has moved; else it was kept from the receiver."""


class OdometryStream:
    """Turns the estimates of one vehicle into what its autopilot is sent as ODOMETRY."""

    def __init__(
        self,
        config: OdometryConfig,
        family: Family,
        meter: StepMeter,
        *,
        is_relative: bool = False,
    ) -> None:
        """Begin with nothing sent; the covariance may leave out the receiver's slow error."""
        self._family, self._is_relative = family, is_relative
        self._meter, self._detector, self._residual = meter, JumpDetector(), Residual()
        self._looked: tuple[Odometry, Pose] | None = None
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

    @property
    def offset(self) -> Offset:
        """Where the frame of what is sent lies in that of the estimates."""
        return self._residual.offset

    def on_restart(self, lost: float) -> None:
        """Wait for the first fix as long as the follower holds out that heard nothing for s."""
        left_ns = HOLDS_OUT_NS.get(self._family, WAIT_NS) - round(lost * SECOND_NS) - _RESERVE_NS
        self._wait_ns = max(left_ns, LEAST_WAIT_NS)

    def add(self, sample: tuple[float, ...]) -> None:
        """Add the inertial sample of an estimate; to be called for each."""
        self._meter.add(sample)

    def move(self, distance: float) -> None:
        """Count from a place that is so far from the last, m: a jump moves the counter."""
        self._is_told |= distance > POSITION.least

    def look(self, estimate: Estimate) -> None:
        """Look at an estimate: 30 times a second or more, whether it is sent or not."""
        odometry = estimate.odometry
        if odometry is None:
            self._meter.forget()
            self._looked, self._is_begun, self.silence = None, False, ""
            return
        odometry = state_covariance(odometry, self._is_relative)
        pose = to_pose(odometry)
        step = self._meter.measure(pose)
        resets, last = odometry.reset_count, self._looked
        # A reset of the filter is told even if it moved nothing much, and so is a return
        self._is_told |= last is None or (resets != self._resets and self._policy.position)
        self._looked, self._resets = (odometry, pose), resets
        if step is not None:
            assert last is not None
            self._is_begun &= step.dt * 1e9 < BROKEN_NS
            self._residual.decay(step.dt)
            self._is_told |= self._take_step(step, pose, _stated(last[0]))

    def _take_step(self, step: Step, pose: Pose, stated: tuple[float, float, float]) -> bool:
        """Keep a jump from the receiver in the parts that are not told; return whether one is."""
        position, velocity, yaw = self._detector.judge(step, stated)
        if not (position or velocity or yaw):
            return False
        policy = self._policy
        is_told = (position and policy.position) or (velocity and policy.velocity)
        is_told |= yaw and policy.yaw
        if self.is_continuous:
            self._residual.spread(step, position=False, velocity=velocity, yaw=False)
            if position or yaw:
                self._residual.move_frame(step, pose)
        else:
            self._residual.spread(
                step,
                position=position and not policy.position,
                velocity=velocity and not policy.velocity,
                yaw=yaw and not policy.yaw,
            )
        if self._sent_ns is not None:
            self.jump = Jump(step, is_told)
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

    def send(self, estimate: Estimate, climb_factor: float = 1.0) -> Odometry | None:
        """Return what is sent of the estimate that was looked at last; None: nothing.

        Where a stream ends, its last message has the quality of a failure. ``climb_factor``
        multiplies the variance of the velocity down.
        """
        if self._looked is None:
            return None
        odometry, pose = self._looked
        was_begun, was_silent = self._is_begun, bool(self.silence)
        self.silence = self._reason(estimate, odometry)
        if self.silence:
            self._is_begun = False
            if not was_begun or self.silence == BEYOND:
                return None
            odometry = odometry._replace(quality=_FAILED)
        else:
            if self._sent_ns is None:
                # Whatever was corrected before, nobody has seen
                self._count, self._is_told, self._residual = self._resets, False, Residual()
            elif was_silent:
                self._end_silence(estimate.t_ns - self._sent_ns)
            if self._is_told:
                self._tell(estimate)
            self._is_begun, self._is_told = True, False
            self._since_ns, self._sent_ns = None, estimate.t_ns
        odometry = state_covariance(odometry, climb_factor=climb_factor)
        self._unaided = self._unaided + 1 if odometry.quality < _GOOD else 0
        if self._unaided > 1:
            # They share one error: together they say no more than the first of them alone
            odometry = scale_errors(odometry, float(self._unaided))
        return self._residual.apply(odometry, pose)._replace(reset_count=self._count)

    def _end_silence(self, span_ns: int) -> None:
        """Drop what was to be spread and move the counter: whoever ended its fusion begins anew."""
        if span_ns <= BROKEN_NS or self.is_continuous:
            return
        self._is_told |= self._policy == SPREAD or self._residual.is_any
        self._residual.clear()

    def _reason(self, estimate: Estimate, odometry: Odometry) -> str:
        """Return why an estimate is not worth to be sent; empty: it is."""
        config = self._config
        if odometry.quality < 0:
            return "the estimate is invalid"
        assert self._looked is not None
        if max(map(abs, self._looked[1].pos_n)) > FARTHEST:
            return BEYOND
        # After a restart it is sent as it is: a longer silence would end the autopilot's flight
        is_lost = std_attitude(odometry) > LOST_ATTITUDE
        if is_lost and self._is_oriented:
            return "the attitude is being found again"
        self._is_oriented |= not is_lost
        is_good = odometry.quality >= _GOOD
        if not self._is_begun and self._is_waiting(estimate, odometry, is_good):
            return WAITING
        if is_good:
            return ""
        if estimate.unaided_s > config.dead_reckoning_time:
            return f"dead reckoning over {config.dead_reckoning_time:g} s"
        # By all of the error over ground, whatever of it is told
        if stds(estimate.odometry or odometry)[0] > config.dead_reckoning_std:
            return f"dead reckoning beyond {config.dead_reckoning_std:g} m"
        return ""

    def _is_waiting(self, estimate: Estimate, odometry: Odometry, is_good: bool) -> bool:
        """Whether a fix that is still to come would make the first message much better."""
        if self._since_ns is None or estimate.t_ns < self._since_ns:
            self._since_ns = estimate.t_ns
        if estimate.t_ns - self._since_ns >= self._wait_ns:
            return False
        is_rough = std_ground_speed(odometry) > ROUGH_VELOCITY
        return not is_good or estimate.is_reset_due or is_rough


def _stated(odometry: Odometry) -> tuple[float, float, float]:
    """Return one sigma of position, velocity and yaw, 0 of what lacked its aid."""
    if odometry.quality < _GOOD:
        return 0.0, 0.0, 0.0
    position, velocity, yaw = stds(odometry)
    return position if odometry.quality == _BEST else 0.0, velocity, yaw
