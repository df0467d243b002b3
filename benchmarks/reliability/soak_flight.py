"""A flight of any length: the errors of each ODOMETRY, and the memory that the estimator holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.reliability.fuzz import resident_mb
from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.past_frames import KEPT
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.autopilot import Received
from sim_autopilot.config import SimConfig
from sim_autopilot.faults.fault import Fault
from sim_autopilot.firmware import PERSONALITIES
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench
from sim_autopilot.score import Witness, body_velocity

RATE = 250.0
"""Of the inertial samples, Hz."""
LATENCY = 0.001
"""Of the link, each way, s."""
UNLIMITED = OdometryConfig(jumps="tell", dead_reckoning_time=3600.0, dead_reckoning_std=1e4)
"""The errors are the estimator's: dead reckoning is judged too, and no jump is spread."""
LARGEST_RATE = 60.0
"""Most ODOMETRY per second that are kept."""
LOOK_EVERY = 10.0
"""Between two checks of memory and queues, s of flight."""
_DEEPEST = 12
_ROW = 12


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Errors:
    """Of every ODOMETRY at its time of validity; arrays of shape (n,)."""

    t: Array
    """Since the start of the flight, s, ascending."""
    size: Array
    """Position, m; velocity, m/s; tilt and yaw, rad; shape (n, 4)."""
    resets: npt.NDArray[np.int64]
    """How often the reset_counter has increased."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What the process and its queues hold at a time."""

    t: float
    """Since the start of the flight, s."""
    resident: float
    """MB."""
    largest: int
    """Items in the largest container reachable from the estimator that keeps no past frames."""
    where: str
    """Its path from there."""
    waiting: int
    """Events that wait in the timeline for the next inertial sample."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Flown:
    """One flight."""

    errors: Errors
    looks: list[Look]
    companion: Companion


class PreallocatedWitness(Witness):
    """Receives ODOMETRY into a table made beforehand, as memory is being measured."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench.flight, bench.rig.clock.true_ns)
        self._bench = bench
        self._table = np.ones((round(bench.flight.duration * LARGEST_RATE), _ROW + 1))
        self._length = 0

    def sent(self, now_ns: int) -> None:
        """Keep nothing."""

    def receive(self, message: Received) -> None:
        """Keep what the errors are computed from."""
        fields = message.fields
        if message.name == "GPS_GLOBAL_ORIGIN":
            self._origin(fields)
        elif message.name == "ODOMETRY":
            t_ns = self._bench.rig.clock.true_ns(fields.time_usec * 1000, message.now_ns)
            self._table[self._length] = (
                (t_ns - self._bench.flight.first_ns) * 1e-9,
                *(fields.x, fields.y, fields.z),
                *fields.q,
                *body_velocity(fields)[0],
                fields.reset_counter,
                max(len(self._origins) - 1, 0),
            )
            self._length += 1

    def errors(self) -> Errors:
        """Compare all with the truth."""
        rows = self._table[: self._length]
        # in order of arrival, and beyond 255
        rows[:, 11] = np.cumsum(np.diff(rows[:, 11], prepend=rows[:1, 11]) % 256)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        pos_n = rows[:, 1:4].copy()
        for index, origin in enumerate(self._origins):
            of_it = rows[:, _ROW] == index
            home = self._bench.flight.trajectory.frame
            pos_n[of_it] = home.to_ned(*origin.to_geodetic(pos_n[of_it]))
        q_nb, t = rows[:, 4:8], rows[:, 0]
        size = sizes(self._bench.flight, t, pos_n, so3.rotate(q_nb, rows[:, 8:11]), q_nb)
        return Errors(t=t, size=size, resets=rows[:, 11].astype(np.int64))


def sizes(flight: Flight, t: Array, pos_n: Array, vel_n: Array, q_nb: Array) -> Array:
    """Compare with the truth; return errors like ``Errors.size``, shape (n, 4)."""
    truth = flight.truth_at(flight.first_ns + np.round(t * 1e9).astype(np.int64))
    # the error's rotation vector in n: about the vertical it is yaw, the rest is tilt
    turn_n = so3.log(so3.multiply(q_nb, so3.conjugate(truth.q_nb)))
    return np.stack(
        [
            np.linalg.norm(pos_n - truth.pos_n, axis=1),
            np.linalg.norm(vel_n - truth.vel_n, axis=1),
            np.hypot(turn_n[:, 0], turn_n[:, 1]),
            np.abs(turn_n[:, 2]),
        ],
        axis=1,
    )


def fly(
    personality: str,
    seed: int,
    duration: float,
    faults: Sequence[Fault] = (),
    scenario: str = "figure-eight",
) -> Flown:
    """Fly with faults, and check memory and queues now and then."""
    flight = plan(personality, seed, duration, scenario)
    config = Config(output=OutputConfig(odometry=UNLIMITED))
    companion = Companion(replace(config, link=replace(config.link, imu_rate=RATE)))
    bench = Bench(
        flight,
        companion,
        personality=PERSONALITIES[personality],
        faults=faults,
        latency=LATENCY,
    )
    bench.witness = witness = PreallocatedWitness(bench)
    looks: list[Look] = []
    next_ns = flight.first_ns
    for at_ns, _ in bench.frames():
        if at_ns >= next_ns:
            next_ns = at_ns + round(LOOK_EVERY * 1e9)
            looks.append(look(companion, (at_ns - flight.first_ns) * 1e-9))
    return Flown(errors=witness.errors(), looks=looks, companion=companion)


def plan(personality: str, seed: int, duration: float, scenario: str = "figure-eight") -> Flight:
    """Plan a flight with an autopilot's rates and delays, and inertial samples at 250 Hz."""
    config = SimConfig()
    config = replace(config, imu=replace(config.imu, rate=RATE))
    return Flight.plan(
        scenario, PERSONALITIES[personality].suited(config), seed=seed, duration=duration
    )


def look(companion: Companion, t: float) -> Look:
    """Measure the process's memory and every container reachable from the estimator.

    The frames of the last seconds, and their keys, count beyond their own bound only.
    """
    found = [one for one in containers(companion) if not (".past._" in one[0] and one[1] <= KEPT)]
    where, largest = max(found, key=lambda one: one[1])
    pipeline = companion.pipeline
    waiting = 0 if pipeline is None else len(pipeline.state().waiting)
    return Look(t=t, resident=resident_mb(), largest=largest, where=where, waiting=waiting)


def containers(root: object) -> Iterator[tuple[str, int]]:
    """Yield path and length of every list, queue, set, table and text that an object holds."""
    seen: set[int] = set()
    ahead: list[tuple[str, object, int]] = [("", root, 0)]
    while ahead:
        path, one, depth = ahead.pop()
        if id(one) in seen or depth > _DEEPEST or isinstance(one, type | int | float | str):
            continue
        seen.add(id(one))
        if isinstance(one, bytes | bytearray | memoryview | np.ndarray):
            yield path, len(one) if not isinstance(one, np.ndarray) else one.shape[0]
            continue
        parts: list[tuple[str, object]] = []
        if isinstance(one, Mapping):
            yield path, len(one)
            parts = [(f"{path}[{key!r}]", value) for key, value in list(one.items())]
        elif isinstance(one, Sequence | AbstractSet) or hasattr(one, "maxlen"):
            items = list(one)  # type: ignore[call-overload]
            yield path, len(items)
            parts = [(f"{path}[{number}]", value) for number, value in enumerate(items)]
        names = list(getattr(one, "__dict__", ()))
        for kind in type(one).__mro__:
            slots = kind.__dict__.get("__slots__", ())
            names += [slots] if isinstance(slots, str) else list(slots)
        parts += [(f"{path}.{name}", getattr(one, name, None)) for name in names]
        ahead += [(name, part, depth + 1) for name, part in parts]
