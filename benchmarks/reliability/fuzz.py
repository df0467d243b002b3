"""Feed random and mutated bytes, and well-formed messages with any values, to the companion.

Session and pipeline must raise nothing, keep their state finite and their memory flat, and estimate
again when an undisturbed flight follows::

    python -m benchmarks.reliability.fuzz            # 10^7 bytes, 10^6 messages
    python -m benchmarks.reliability.fuzz --bytes 1e5 --messages 1e4 --seed 7
"""

from __future__ import annotations

import argparse
import logging
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.messages import LAYOUTS, Layout
from ekf_companion.nav.state import Status
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight

SECOND_NS = 1_000_000_000
HEARD = """
    HEARTBEAT SYSTEM_TIME TIMESYNC COMMAND_ACK COMMAND_LONG COMMAND_INT HIGHRES_IMU RAW_IMU
    SCALED_IMU SCALED_IMU2 SCALED_IMU3 SCALED_PRESSURE GPS_RAW_INT GPS2_RAW GLOBAL_POSITION_INT
    ATTITUDE VFR_HUD HOME_POSITION EXTENDED_SYS_STATE PARAM_VALUE PARAM_REQUEST_READ
    PARAM_REQUEST_LIST PARAM_SET AUTOPILOT_VERSION STATUSTEXT GPS_GLOBAL_ORIGIN ESTIMATOR_STATUS
    ODOMETRY REQUEST_DATA_STREAM MESSAGE_INTERVAL LOCAL_POSITION_NED RADIO_STATUS
"""
"""Messages that the companion may read."""
SENDERS = ((1, 1), (1, 1), (1, 1), (1, 1), (1, 194), (2, 1), (255, 190), (0, 0))
"""Mostly the autopilot; ourselves, another autopilot, a ground station, nobody."""
CHECK_EVERY = 2_000
"""Pieces between two checks of the state."""
WARM_UP = 20_000
"""Pieces after which memory is counted: by then everything has been needed once."""
_INTEGERS = {"b": 8, "B": 8, "h": 16, "H": 16, "i": 32, "I": 32, "q": 64, "Q": 64, "c": 8}


@dataclass(frozen=True, slots=True)
class Outcome:
    """The state after a campaign."""

    fed: int
    """Bytes or messages."""
    growth_mb: float
    """Of the resident memory after the warm-up, MB; NaN: too few pieces."""
    status: Status
    """After the undisturbed flight that followed."""


class FuzzedCompanion:
    """A companion without a link; its time advances with the bytes that are fed."""

    def __init__(self) -> None:
        self.companion = Companion(Config(), is_recording=True)
        self.now_ns = 1_700_000_000 * SECOND_NS

    def feed(self, data: bytes, step_ns: int = 4_000_000) -> None:
        """Feed bytes as the daemon does."""
        self.now_ns += step_ns
        self.companion.receive(data, self.now_ns)
        self.companion.tick(self.now_ns)
        self.companion.data_to_send()
        self.companion.session.outbox.take_record()

    def check(self) -> None:
        """Assert that the state is finite and its variances are not negative."""
        pipeline = self.companion.pipeline
        if pipeline is None:
            return
        x = as_state(pipeline._timeline.block())
        P = np.array(x.P)
        assert np.isfinite(P).all(), "a covariance that is not finite"
        assert (np.diagonal(P) >= 0.0).all(), "a negative variance"
        for name in ("q_nb", "vel_n", "pos_n", "gyro_bias", "accel_bias"):
            assert np.isfinite(np.array(getattr(x, name))).all(), f"{name} is not finite"

    def recover(self, seed: int) -> Status:
        """Feed half a minute of an undisturbed flight, from a reboot of the autopilot."""
        for data in undisturbed(seed, duration=30.0):
            self.feed(data)
        self.check()
        assert self.companion.pipeline is not None
        return self.companion.pipeline.health().status


def undisturbed(seed: int, duration: float) -> Iterator[bytes]:
    """Yield the bytes of an undisturbed flight, a cycle at a time."""
    flight = Flight.plan("figure-eight", SimConfig(), seed=seed, duration=duration)
    autopilot = Autopilot(flight.config)
    autopilot.heartbeat()
    for cycle in flight.cycles():
        autopilot.cycle(cycle)
        yield b"".join(autopilot.data_to_send())


def mutated(count: int, seed: int) -> Iterator[bytes]:
    """Yield damaged pieces of a flight, and random bytes: ``count`` bytes in all."""
    rng = np.random.default_rng(seed)
    flight = list(undisturbed(seed, duration=20.0))
    turn = 0
    while count > 0:
        data = bytearray(flight[turn % len(flight)])
        turn += 1
        kind = rng.integers(8)
        if kind == 0:
            data = bytearray(rng.bytes(int(rng.integers(1, 300))))
        elif kind == 1 and data:
            for place in rng.integers(0, len(data), size=int(rng.integers(1, 6))):
                data[place] ^= 1 << int(rng.integers(8))
        elif kind == 2 and data:
            cut = int(rng.integers(len(data)))
            del data[cut : cut + int(rng.integers(1, 20))]
        elif kind == 3:
            place = int(rng.integers(len(data) + 1))
            data[place:place] = rng.bytes(int(rng.integers(1, 20)))
        elif kind == 4:
            data += data[: int(rng.integers(len(data) + 1))]
        elif kind == 5:
            data = bytearray(rng.choice([0xFD, 0xFE, 0x00, 0xFF], size=30).astype(np.uint8))
        count -= len(data)
        yield bytes(data)


def messages(count: int, seed: int) -> Iterator[bytes]:
    """Yield ``count`` frames whose fields hold anything, and between them a flight."""
    rng = np.random.default_rng(seed)
    senders = [Sender(*ids) for ids in SENDERS]
    layouts, names = [LAYOUTS[i] for i in LAYOUTS], HEARD.split()
    heard = [layout for layout in layouts if layout.name in names]
    rest = [layout for layout in layouts if layout.name not in names]
    flight: Iterator[bytes] = iter(())
    for _ in range(count):
        if rng.random() < 0.3:
            data = next(flight, None)
            if data is None:
                flight = undisturbed(int(rng.integers(1 << 30)), duration=20.0)
                data = next(flight)
            yield data
        among = heard if rng.random() < 0.95 else rest
        layout = among[int(rng.integers(len(among)))]
        sender = senders[int(rng.integers(len(senders)))]
        sender.sequence = int(rng.integers(256)) if rng.random() < 0.1 else sender.sequence
        yield sender.frame(layout.name, payload(layout, rng))


def payload(layout: Layout, rng: np.random.Generator) -> bytes:
    """Return a payload whose fields are extreme, random or plausible."""
    values: list[object] = []
    for field in layout.fields:
        if field.code == "s":
            values.append(rng.bytes(field.length))
            continue
        for _ in range(field.length or 1):
            values.append(_value(field.code, field.name, rng))
    return struct.Struct(layout.struct.format).pack(*values)


def _value(code: str, name: str, rng: np.random.Generator) -> object:
    kind = rng.integers(6)
    if code == "c":
        return rng.bytes(1)
    if code in "fd":
        if kind < 4:
            return float(rng.normal() * 10.0 ** rng.integers(-3, 4))
        return (math.nan, math.inf, -math.inf, 0.0, 3e38, 1e-38)[int(rng.integers(6))]
    bits = _INTEGERS[code]
    low = -(1 << (bits - 1)) if code.islower() else 0
    high = (1 << bits) + low - 1
    if name.startswith("target"):
        return int(rng.integers(0, 2)) if kind < 5 else min(high, 194)
    if kind < 3:
        scale = 10.0 ** rng.uniform(0.0, bits * 0.3)
        return int(min(max(rng.normal() * scale, low), high * 0.99))
    if kind == 3:
        return 0
    return (low, high, high - 1, low + 1)[int(rng.integers(4))]


def run(pieces: Iterator[bytes], count: int, seed: int) -> Outcome:
    """Feed all, with checks of the state in between, then an undisturbed flight."""
    rng = np.random.default_rng(seed)
    fuzzed, base, fed = FuzzedCompanion(), 0.0, 0
    for number, data in enumerate(pieces):
        fed += len(data)
        while data:
            size = int(rng.integers(1, 400))
            fuzzed.feed(data[:size], int(rng.integers(1, 8_000_000)))
            data = data[size:]
        if number % CHECK_EVERY == 0:
            fuzzed.check()
        if number == WARM_UP:
            base = resident_mb()
    fuzzed.check()
    growth = resident_mb() - base if base else math.nan
    return Outcome(count, growth, fuzzed.recover(seed))


def resident_mb() -> float:
    """Return this process's resident memory, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 1e6


def main() -> None:
    """Run both campaigns and print their outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bytes", type=float, default=1e7)
    parser.add_argument("--messages", type=float, default=1e6)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    for what, make, count in (
        ("bytes", mutated, int(options.bytes)),
        ("messages", messages, int(options.messages)),
    ):
        outcome = run(make(count, options.seed), count, options.seed)
        print(
            f"{outcome.fed:>9} {what}: nothing raised, state finite, memory "
            f"{outcome.growth_mb:+.1f} MB, then {outcome.status.name}"
        )


if __name__ == "__main__":
    main()
