"""Estimates as messages, each at its rate by the stamps of the inertial samples."""

from __future__ import annotations

import math
from dataclasses import replace

from ekf_companion.config.config import Config
from ekf_companion.core.memory.enums import Source
from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.core.output.follower import Follower
from ekf_companion.core.settings.from_settings import has_mean_samples, imu_lag
from ekf_companion.engine.autopilot_frame import AutopilotFrame, Place
from ekf_companion.engine.health import Aid, Health
from ekf_companion.engine.pipeline import Estimate
from ekf_companion.engine.stream import NO_OFFSET, OdometryStream
from ekf_companion.engine.wrong import PLACE, RECEIVER
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import Frame, Label, StatusFlag, label
from ekf_companion.mavlink.outbox import Message
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.state import Odometry, Reason, Status

_OFFSET = "LOCAL_POSITION_NED_SYSTEM_GLOBAL_OFFSET"
_POSITION = "GLOBAL_POSITION_SENSOR"
_INTEGRITY = "GNSS_INTEGRITY"
STREAMS = ("ODOMETRY", "ESTIMATOR_STATUS", "GPS_GLOBAL_ORIGIN", _OFFSET, _INTEGRITY)
"""Messages about an estimate, which may be requested."""
_LARGEST = {Family.ARDUPILOT: 50.0}
"""Of ODOMETRY, Hz: its EKF throws away what comes faster."""
_PLACE_FALSE = {Reason.POSITION_REFUSED, Reason.SLIDE}
_CAUGHT = _PLACE_FALSE | {
    *(Reason.VELOCITY_REFUSED, Reason.POSITION_OFF, Reason.HEIGHT_REFUSED, Reason.HEIGHT_OFF)
}
"""Why an estimate is not OK where its receiver is wrong; of these, the horizontal position."""
_SMALLEST = {"ODOMETRY": 1.0}
_SELDOM = 0.1
"""Hz; more rarely is as good as never."""
_ANY = 1000.0
_LOOKS = 30.0
"""Of the estimate, Hz, whether ODOMETRY is due or not: between two of them it moves smoothly."""
NEVER_NS = 1 << 63
"""A stamp that no estimate has."""
_NO_PAUSE = 0, 0
_ENDLESS_PAUSE = -NEVER_NS, NEVER_NS
"""From one stamp, ns, until another."""


def largest_rate(name: str, family: Family) -> float:
    """Return the rate above which a message is of no use to the autopilot, Hz."""
    return _LARGEST.get(family, _ANY) if name == "ODOMETRY" else _ANY


def smallest_rate(name: str) -> float:
    """Return the rate below which a message is as good as switched off, Hz."""
    return _SMALLEST.get(name, _SELDOM)


def default_rate(name: str, config: Config, family: Family) -> float:
    """Return the rate at which a message is sent where nobody asks for another, Hz."""
    if name == _OFFSET:
        return 1.0 if config.output.odometry.frame == "continuous" else 0.0
    if name != "ODOMETRY":
        return 1.0
    return min(config.output.odometry.rate, largest_rate(name, family))


class Due:
    """Decides when something periodic is due, by the stamps of what drives it."""

    def __init__(self, rate: float) -> None:
        self._next_ns: int | None = None
        self._is_requested = False
        self.pause = _NO_PAUSE
        """From which stamp until which it is not due."""
        self.set_rate(rate)

    def set_rate(self, rate: float) -> None:
        """Go on at another rate, Hz; 0: only when requested."""
        self.rate = rate
        """Hz; 0: only when requested."""
        self._period_ns = round(SECOND_NS / rate) if rate > 0.0 else 0
        self._set_pause()

    def request(self) -> None:
        """Make it due at the next stamp, out of turn."""
        self._is_requested = True
        self._set_pause()

    def is_due(self, t_ns: int) -> bool:
        """Whether a period has passed; a stamp far from the plan makes a new plan."""
        begin_ns, end_ns = self.pause
        if begin_ns <= t_ns < end_ns:
            return False
        if self._is_requested:
            self._is_requested = False
            self._set_pause()
            return True
        if self._next_ns is None or abs(t_ns - self._next_ns) > self._period_ns:
            self._next_ns = t_ns
        self._next_ns += self._period_ns
        self.pause = self._next_ns - self._period_ns, self._next_ns
        return True

    def _set_pause(self) -> None:
        self.pause = _NO_PAUSE
        if self._is_requested:
            return
        if not self._period_ns:
            self.pause = _ENDLESS_PAUSE
        elif self._next_ns is not None:
            self.pause = self._next_ns - self._period_ns, self._next_ns


class Publisher:
    """Turns the estimates of one vehicle into messages, each at its rate."""

    def __init__(
        self,
        config: Config,
        family: Family,
        ours: Label | None = None,
        *,
        is_monitor: bool = False,
        target: tuple[int, int] = (0, 0),
    ) -> None:
        """Begin with nothing published.

        Args:
            config: The rates, the labels of ODOMETRY, and which estimates are sent as such.
            family: The listener's.
            ours: Labels of ODOMETRY, whatever the configuration says.
            is_monitor: Whether the listener only looks on: it gets each estimate as it is.
            target: System and component id of the listener, for what bears an address.
        """
        self._family, self._target = family, target
        self._component_id = config.link.component_id
        self._due = {name: Due(default_rate(name, config, family)) for name in STREAMS}
        self._due[_POSITION] = Due(0.0 if is_monitor else config.output.global_position.rate)
        odometry = config.output.odometry
        self.label = ours or label(family, odometry.frame, odometry.estimator_type)
        """How every ODOMETRY is labelled."""
        states = odometry.covariance
        is_follower = ours is None and family in (Family.PX4, Family.ARDUPILOT)
        self._is_relative = states == "relative" or (states == "auto" and is_follower)
        self._climb_time = odometry.climb_time if self._is_relative else 0.0
        is_framed = not (is_monitor or odometry.frame == "continuous")
        if odometry.message == "vision_position_estimate" and not is_monitor:
            self.use_vision()
        self.frame = AutopilotFrame(family if is_framed else Family.UNKNOWN)
        """The local frame that ODOMETRY is expressed in."""
        self._follower = Follower(imu_lag(config, family), has_mean_samples(config, family))
        self._add = self._follower.samples.append
        self.stream = (
            None
            if is_monitor
            else OdometryStream(
                odometry, family, self._follower, self.frame, is_relative=self._is_relative
            )
        )
        """Which estimates are sent as ODOMETRY; None: each as it is."""
        self._look = Due(_LOOKS)
        self._pause = _NO_PAUSE
        """From which stamp until which nothing is due."""
        self._was_invalid = False
        self._origin: Place | None = None
        """Of the estimate that a monitor was sent last."""
        self._offset = NO_OFFSET
        self._is_caught = False
        """Whether the receiver was found to be wrong when that was looked at last."""

    @property
    def due_ns(self) -> int:
        """The stamp from which something may be due; until then an estimate brings no message."""
        return self._pause[1]

    def set_origin(self, origin: Place) -> None:
        """Count from the origin of the autopilot's own frame from now on."""
        self.frame.set_origin(origin)

    def use_body_velocity(self) -> None:
        """Send the velocity along the body's axes: older PX4 understands no others."""
        self.label = replace(self.label, velocity=Frame.BODY_FRD)

    def use_vision(self) -> None:
        """Send VISION_POSITION_ESTIMATE in place of ODOMETRY: old firmware reads nothing else."""
        ned = Frame.LOCAL_NED
        self.label = replace(self.label, frame=ned, velocity=ned, is_vision=True)

    def on_restart(self, lost: float) -> None:
        """Learn that the estimate goes on from a run before, and that nothing was sent for s."""
        if self.stream is not None:
            self.stream.on_restart(lost)

    def retune(self, config: Config) -> None:
        """Decide by another configuration what is sent as ODOMETRY, and how often a position."""
        if self.stream is not None:
            self.stream.retune(config.output.odometry)
            self.set_rate(_POSITION, config.output.global_position.rate)

    def set_rates(self, config: Config) -> None:
        """Send each message at the rate of another configuration."""
        for name in STREAMS:
            self.set_rate(name, default_rate(name, config, self._family))

    def set_rate(self, name: str, rate: float) -> None:
        """Send a message at this rate, Hz; 0: only when requested."""
        self._due[name].set_rate(rate)
        self._pause = _NO_PAUSE

    def request(self, name: str, estimate: Estimate) -> bool:
        """Make a message due with the next estimate; return whether there is something to send."""
        if name == "ODOMETRY":
            has_one = estimate.odometry is not None and estimate.odometry.quality >= 0
            has_one &= self.stream is None or not self.stream.silence
        elif name == _OFFSET:
            has_one = self.stream is not None and self.stream.is_continuous
        elif name == _INTEGRITY:
            has_one = is_caught(estimate.health)
        else:
            has_one = estimate.origin is not None
        if has_one:
            self._due[name].request()
            self._pause = _NO_PAUSE
        return has_one

    def due(self, estimate: Estimate) -> list[Message]:
        """Return the messages that are due at the stamp of an estimate."""
        messages: list[Message] = []
        t_ns, ours, stream = estimate.t_ns, self.label, self.stream
        if stream is not None and estimate.sample is not None:
            self._add(estimate.sample)
        if self._pause[0] <= t_ns < self._pause[1]:
            return messages
        odometry = self._due_odometry(estimate)
        others = [
            name
            for name, one in self._due.items()
            if not one.pause[0] <= t_ns < one.pause[1] and name != "ODOMETRY" and one.is_due(t_ns)
        ]
        # A new origin goes before the first ODOMETRY that counts from it, and so does an offset
        if "GPS_GLOBAL_ORIGIN" in others and (origin := estimate.origin) is not None:
            self.frame.told_datum = self.frame.datum
            payload = encode.gps_global_origin(*self.frame.counts_from(origin), t_ns=t_ns)
            messages.append(Message("GPS_GLOBAL_ORIGIN", payload))
        if _OFFSET in others and stream is not None and stream.is_continuous:
            messages.append(Message(_OFFSET, encode.global_offset(t_ns, *stream.offset)))
        if odometry is not None and ours.is_vision:
            messages += self._vision(odometry)
        elif odometry is not None:
            payload = encode.odometry(
                odometry, frame=ours.frame, velocity=ours.velocity, estimator=ours.estimator
            )
            messages.append(Message("ODOMETRY", payload, is_replaceable=True))
        if "ESTIMATOR_STATUS" in others and estimate.origin is not None:
            payload = _estimator_status(estimate.health, t_ns)
            messages.append(Message("ESTIMATOR_STATUS", payload))
        if _INTEGRITY in others and estimate.origin is not None:
            messages += self._integrity(estimate.health)
        if _POSITION in others and (position := self._global_position(estimate)) is not None:
            messages.append(position)
        pauses = [self._look.pause, *[one.pause for one in self._due.values()]]
        self._pause = max([begin for begin, _ in pauses]), min([end for _, end in pauses])
        return messages

    def _due_odometry(self, estimate: Estimate) -> Odometry | None:
        """Return the ODOMETRY that is due; where its frame has moved, so is the message on that."""
        stream, due, t_ns = self.stream, self._due, estimate.t_ns
        is_due, is_look = due["ODOMETRY"].is_due(t_ns), self._look.is_due(t_ns)
        if not is_due:
            if is_look and stream is not None:
                stream.look(estimate)
            return None
        climb_factor = max(1.0, 2.0 * self._climb_time * due["ODOMETRY"].rate)
        is_local = self.label.velocity is Frame.LOCAL_NED
        if stream is None:
            return self._as_it_is(estimate, climb_factor, is_local)
        odometry = stream.send(estimate, climb_factor, is_local=is_local)
        if stream.has_new_origin:
            stream.has_new_origin = False
            due["GPS_GLOBAL_ORIGIN"].request()
        if stream.offset != self._offset:
            self._offset = stream.offset
            due[_OFFSET].request()
        return odometry

    def _vision(self, odometry: Odometry) -> list[Message]:
        """Return what old firmware reads in place of ODOMETRY; it states no quality."""
        if odometry.quality < 0:
            return []
        payload = encode.vision_position_estimate(odometry)
        messages = [Message("VISION_POSITION_ESTIMATE", payload, is_replaceable=True)]
        if self._family is not Family.PX4:  # which has no reader of it
            payload = encode.vision_speed_estimate(odometry)
            messages.append(Message("VISION_SPEED_ESTIMATE", payload))
        return messages

    def _integrity(self, health: Health) -> list[Message]:
        """Return GNSS_INTEGRITY while the receiver contradicts the estimate, and once after."""
        was_caught, self._is_caught = self._is_caught, is_caught(health)
        if not was_caught and not self._is_caught:
            return []
        is_false = bool(_PLACE_FALSE & health.reasons.keys()) or health.has_wrong(PLACE)
        payload = encode.gnss_integrity(
            health.receiver, is_caught=self._is_caught, is_place_false=is_false
        )
        return [Message(_INTEGRITY, payload)]

    def _global_position(self, estimate: Estimate) -> Message | None:
        """Return the position as an autopilot takes it; None: there is none that it lacks.

        That is while nothing but inertial samples carries it, and where it is the autopilot's own.
        """
        now = as_estimate(estimate.values)
        place, (north, east, down) = (now.lla[0], now.lla[1], now.lla[2]), now.std_pos
        is_aided = Status.OK <= int(now.status) < Status.DEAD_RECKONING and math.isfinite(place[0])
        if not is_aided or estimate.health.is_position_autopilots:
            return None
        t_ns, std = estimate.t_ns, max(north, east)
        if self._family is Family.ARDUPILOT:
            payload = encode.external_position_estimate(t_ns, place, std, self._target)
            return Message("COMMAND_INT", payload)
        ours = self._component_id
        payload = encode.global_position_sensor(t_ns, place, (std, down), self._target, ours)
        return Message(_POSITION, payload)

    def _as_it_is(self, estimate: Estimate, climb: float, is_local: bool) -> Odometry | None:
        """Return an estimate as a monitor is sent it, an invalid one once."""
        last, self._origin = self._origin, estimate.origin
        if self._origin not in (None, last):
            self._due["GPS_GLOBAL_ORIGIN"].request()
        if (odometry := estimate.odometry) is None:
            return None
        was_invalid, self._was_invalid = self._was_invalid, odometry.quality < 0
        if was_invalid and self._was_invalid:
            return None
        relative = odometry.relative if self._is_relative else None
        self._follower.look(odometry.t_ns, odometry.numbers, (0.0, 0.0, 0.0), relative)
        return odometry._replace(numbers=self._follower.express(climb, 1.0, is_local))


def is_caught(health: Health) -> bool:
    """Return whether the receiver is wrong: refused, or likely so by the fault hypotheses."""
    return bool(_CAUGHT & health.reasons.keys()) or health.has_wrong(RECEIVER)


def _estimator_status(health: Health, t_ns: int) -> bytes:
    """Return the payload of ESTIMATOR_STATUS."""
    flags = StatusFlag.ATTITUDE | StatusFlag.VELOCITY_HORIZ | StatusFlag.VELOCITY_VERT
    flags |= StatusFlag.POS_HORIZ_REL | StatusFlag.POS_HORIZ_ABS | StatusFlag.POS_VERT_ABS
    if health.status == Status.DEAD_RECKONING:
        flags &= ~StatusFlag.POS_HORIZ_ABS
        flags |= StatusFlag.PRED_POS_HORIZ_REL
    elif health.status in (Status.INVALID, Status.ATTITUDE):
        flags = StatusFlag.ATTITUDE
    elif health.status < Status.ATTITUDE:
        flags = StatusFlag(0)
    if health.is_receiver_refused:
        flags |= StatusFlag.GPS_GLITCH
    if health.has_wrong((Source.ACCEL,)):
        flags |= StatusFlag.ACCEL_ERROR
    aids = (Aid.VELOCITY, Aid.POSITION, Aid.HEIGHT, Aid.HEADING)
    return encode.estimator_status(
        t_ns,
        flags,
        [math.sqrt(health.ratios[aid]) for aid in aids],
        (health.std_horizontal, health.std_vertical),
    )
