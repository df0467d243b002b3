"""A line between a session and its autopilot that is slow, late, uneven, lossy, or stands still.

Each way is a queue of bytes, as a TCP stream to a serial port: what is sent waits for what was sent
before it. The autopilot answers TIMESYNC and parameters, and notes how old each ODOMETRY is when
it arrives. No socket, no clock.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.mavlink.codec import pack, unpack
from ekf_companion.mavlink.event import HoldChanged
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.outbox import Message
from ekf_companion.mavlink.session import Session, SessionOptions
from tests.mavlink.conversation import ARDUPILOT, MS, SECOND, Voice

FUSED = {"VISO_TYPE": 1.0, "VISO_DELAY_MS": 10.0, "EK3_SRC_OPTIONS": 0.0} | {
    f"EK3_SRC{k}_{part}": 6.0 if k == 1 else 0.0
    for k in (1, 2, 3)
    for part in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
}
"""ArduPilot that flies on ODOMETRY alone."""


@dataclass
class Way:
    """One way of the line."""

    rate: float = 1e9
    """Bytes/s."""
    delay_ns: int = 0
    jitter_ns: int = 0
    """Evenly spread on top of the delay; the order stays."""
    loss: float = 0.0
    stalls: tuple = ()
    """Begin and end of the times in which nothing moves, ns."""
    rng: object = field(default_factory=lambda: np.random.default_rng(7))
    free_ns: int = 0
    last_ns: int = 0
    queue: deque = field(default_factory=deque)

    def send(self, data, now_ns):
        if self.rng.random() < self.loss:
            return
        self.free_ns = max(self.free_ns, now_ns) + round(len(data) / self.rate * 1e9)
        at = self.free_ns + self.delay_ns + round(self.rng.random() * self.jitter_ns)
        for begin, end in self.stalls:
            at = end if begin <= at < end else at
        self.last_ns = max(self.last_ns, at)
        self.queue.append((self.last_ns, data))

    def arrived(self, now_ns):
        while self.queue and self.queue[0][0] <= now_ns:
            yield self.queue.popleft()


class Flown:
    """A session that has been flown over a line."""

    def __init__(self, there, back=None, *, family=ARDUPILOT, parameters=None, clock=1.0):
        self.there, self.back = there, back or Way()
        self.session = Session(SessionOptions(rates={}, guard=GuardOptions()))
        self.autopilot = Voice(family=family)
        self.parameters = FUSED | (parameters or {})
        self.clock = clock
        """Seconds of the autopilot's clock in one of ours."""
        self.loop_ns = 0
        """By how much our own loop stalls between a stamp and what is sent with it."""
        self.is_answering = True
        self.base_mode = 0
        self.arrivals = []
        """When each ODOMETRY arrived, and how old it was, s."""
        self.holds = []
        """When it was announced that ODOMETRY waits or is sent again, s, and the text."""
        self.events = []
        self.now_ns = 0
        self._splitter = Splitter()

    def fly(self, seconds, *, rate=30.0):
        """Go on for so long, with ODOMETRY at a rate."""
        end_ns, step_ns = self.now_ns + round(seconds * SECOND), 10 * MS
        odometry_ns = round(SECOND / rate)
        while self.now_ns < end_ns:
            now_ns = self.now_ns = self.now_ns + step_ns
            if now_ns // SECOND != (now_ns - step_ns) // SECOND:
                self.back.send(self.autopilot.heartbeat(base_mode=self.base_mode), now_ns)
                self.back.send(self.autopilot.place(now_ns // MS), now_ns)
            self._at_autopilot(now_ns)
            for at, data in self.back.arrived(now_ns):
                self.session.receive(data, at)
            if now_ns // odometry_ns != (now_ns - step_ns) // odometry_ns:
                payload = pack("ODOMETRY", time_usec=now_ns // 1000, quality=100)
                self.session.publish(Message("ODOMETRY", payload, is_replaceable=True), now_ns)
            self.session.delivery.lag.loop_ns = self.loop_ns
            if now_ns % (50 * MS) == 0:
                self.session.tick(now_ns)
            for data in self.session.data_to_send():
                self.there.send(data, now_ns + self.loop_ns)
            for event in self.session.events():
                self.events.append(event)
                if isinstance(event, HoldChanged):
                    self.holds.append((now_ns * 1e-9, event.hold and event.hold.text))
        return self

    def _at_autopilot(self, now_ns):
        for at, data in self.there.arrived(now_ns):
            for frame in self._splitter.feed(data):
                message = unpack(frame)
                name = type(message).__name__
                if name == "ODOMETRY":
                    self.arrivals.append((at * 1e-9, at * 1e-9 - message.time_usec * 1e-6))
                elif name == "TIMESYNC" and message.tc1 == 0 and self.is_answering:
                    tc1 = 1 + round(at * self.clock)
                    self.back.send(self.autopilot.say("TIMESYNC", tc1=tc1, ts1=message.ts1), at)
                elif name == "PARAM_REQUEST_READ":
                    self._answer_parameter(message.param_id.decode(), at)

    def _answer_parameter(self, name, at):
        if (value := self.parameters.get(name)) is None:
            return
        said = self.autopilot.say(
            "PARAM_VALUE", param_id=name.encode(), param_value=value, param_type=9, param_count=1
        )
        self.back.send(said, at)

    def take_off(self, is_flying=True):
        self.base_mode = 128 if is_flying else 0
        return self

    def ages(self, begin=0.0, end=1e9):
        """Return how old each ODOMETRY was that arrived between two times, s."""
        return [age for at, age in self.arrivals if begin <= at < end]

    def rate(self, begin, end):
        """Return how many arrived a second."""
        return len(self.ages(begin, end)) / (end - begin)
