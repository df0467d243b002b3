"""A companion and the simulated autopilot's bytes: what goes in, and the messages that come out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import LAYOUTS
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig, StreamConfig
from sim_autopilot.flight import Flight

SECOND_NS = 1_000_000_000
STREAMING = Config(output=OutputConfig(odometry=OdometryConfig(mode="always")))
"""Where nobody answers what the guard asks."""


class Said(NamedTuple):
    """A message of a companion."""

    t_ns: int
    """Of the cycle in which it was sent."""
    name: str
    fields: Any


def cycles(
    duration: float,
    scenario: str = "hover",
    *,
    kind: Kind = Kind.PX4,
    system_id: int = 1,
    without: Iterable[str] = (),
    seed: int = 1,
) -> Iterator[tuple[int, bytes]]:
    """Yield stamp and bytes of each cycle of an autopilot's loop, some messages left out."""
    streams = StreamConfig(**dict.fromkeys(without, 0.0))
    config = SimConfig(streams=streams, system_id=system_id)
    flight = Flight.plan(scenario, config, duration=duration, seed=seed)
    autopilot = Autopilot(config, kind)
    for cycle in flight.cycles():
        autopilot.cycle(cycle)
        yield cycle.t_ns, b"".join(autopilot.data_to_send())


def converse(companion: Companion, flight: Iterable[tuple[int, bytes]]) -> list[Said]:
    """Feed the cycles of a flight; return all that the companion says."""
    said: list[Said] = []
    for t_ns, data in flight:
        companion.receive(data, t_ns)
        companion.tick(t_ns)
        said += messages(companion, t_ns)
    return said


def messages(companion: Companion, t_ns: int = 0) -> list[Said]:
    """Return what waits to be sent, once."""
    return as_messages(companion.data_to_send(), t_ns)


def as_messages(frames: Iterable[bytes], t_ns: int = 0) -> list[Said]:
    """Return frames as messages."""
    found = Splitter().feed(b"".join(frames))
    return [Said(t_ns, LAYOUTS[frame.message_id].name, unpack(frame)) for frame in found]


def named(name: str, said: Iterable[Said]) -> list[Any]:
    """Return the fields of the messages of one name."""
    return [one.fields for one in said if one.name == name]
