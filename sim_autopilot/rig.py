"""The autopilot with its faults: cycles and bytes in, bytes out.

Times are on the world's clock, the one that flights are planned on; the autopilot's own differs
from it by the faults of its clock (:mod:`sim_autopilot.faults.clock`).
"""

from __future__ import annotations

from collections.abc import Sequence

from sim_autopilot.autopilot import Autopilot, Received
from sim_autopilot.faults.clock import Clock
from sim_autopilot.faults.fault import Fault
from sim_autopilot.faults.sensors import SensorFaults
from sim_autopilot.faults.wire import Wire
from sim_autopilot.flight import Cycle, Flight
from sim_autopilot.personality import Kind, Personality


class Rig:
    """One autopilot, its sensors, its clock and both directions of its link."""

    def __init__(
        self,
        flight: Flight,
        *,
        personality: Personality | Kind = Kind.PX4,
        faults: Sequence[Fault] = (),
        latency: float = 0.0,
    ) -> None:
        """Connect its parts; the latency is that of the link, each way, s.

        The personality is the autopilot to imitate; of a kind the ideal one.
        """
        zero_ns = flight.first_ns - flight.period_ns
        flown = flight.scenario
        self.autopilot = Autopilot(
            flight.config,
            personality,
            is_wing=flown.is_wing,
            is_rolling=flown.is_rolling,
            seed=flight.seed,
        )
        self.clock = Clock(faults, zero_ns)
        self._sensors = SensorFaults(faults, zero_ns)
        self._out = Wire(faults, flight.seed, zero_ns, "out", latency)
        self._in = Wire(faults, flight.seed, zero_ns, "in", latency)
        self._received: list[Received] = []

    def cycle(self, cycle: Cycle) -> None:
        """Run one cycle of the autopilot's loop."""
        now_ns = cycle.flight_ns
        self._advance(now_ns)
        cycle = self._sensors.apply(cycle)
        if self.clock.boot(now_ns) > self.autopilot.reboots:
            self.autopilot.reboot()
        if self.clock.is_silent(now_ns):
            return
        fix = cycle.fix
        if fix is not None:
            fix = fix._replace(t_ns=self.clock.shown_ns(fix.t_ns))
        self.autopilot.cycle(cycle._replace(t_ns=self.clock.shown_ns(now_ns), fix=fix))
        self._send(self.autopilot.loop_ns)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes that the companion sent at a time."""
        self._in.push(now_ns, data)
        self._advance(now_ns)

    def pop(self, now_ns: int) -> tuple[int, bytes] | None:
        """Return the next frame that has reached the companion by a time, and when it arrived."""
        self._advance(now_ns)
        return self._out.pop(now_ns)

    def received(self) -> list[Received]:
        """Return the messages that reached the autopilot since the last call, with world times."""
        messages, self._received = self._received, []
        return messages

    def _advance(self, now_ns: int) -> None:
        """Deliver to the autopilot what has arrived by now."""
        while (item := self._in.pop(now_ns)) is not None:
            at_ns, data = item
            if self.clock.boot(at_ns) > self.autopilot.reboots or self.clock.is_silent(at_ns):
                continue
            self.autopilot.receive(data, self.clock.shown_ns(at_ns))
            self._received += [one._replace(now_ns=at_ns) for one in self.autopilot.received()]
            self._send(at_ns)

    def _send(self, now_ns: int) -> None:
        for frame in self.autopilot.data_to_send():
            self._out.push(now_ns, frame)
