"""A checkpoint: the filter's whole state as bytes, and whether a restart may go on from it.

No file and no clock here. A wrong state is worse than none, which costs a few seconds of alignment:
so whatever does not fit is refused, with a sentence that says why. The autopilot's clock decides.
Ours may have been set meanwhile (a board without a real-time clock starts wherever it stopped), so
within one boot the time since boot is compared, and unix time only across two.

Whatever becomes of the state, the frame outlives it: an autopilot that follows ODOMETRY counts from
its origin, and in the air a new one would be a jump. So the origin goes on with a cold start too,
as long as it is the same vehicle, and its autopilot has not rebooted.

The bytes, little endian: a header, the state block, the rows that wait for a sample, where there
are fault hypotheses these behind a fingerprint of their layout, a CRC-32. A checkpoint without
them, or with those of another layout, is used all the same: they begin anew.
"""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.config.service import CheckpointConfig
from ekf_companion.core.memory import bank as declared_bank
from ekf_companion.core.memory import enums
from ekf_companion.core.memory import state as declared_state
from ekf_companion.core.memory.bank import FOUND
from ekf_companion.core.memory.declare import pxd
from ekf_companion.core.memory.enums import Fault, Mode, Reset
from ekf_companion.core.memory.overlay import as_banks, as_state, errors
from ekf_companion.core.memory.packing import unpack
from ekf_companion.core.memory.scratch import ROW
from ekf_companion.core.memory.state import BLOCK, Alignment, Field
from ekf_companion.core.settings.settings import HABITS
from ekf_companion.engine.checkpoint_parts import (
    UNSENT,
    Clocks,
    Origin,
    Refusal,
    Remains,
    SentFrame,
    Sources,
    Vehicle,
    Why,
)
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.repetition import Sample
from ekf_companion.version import __version__

MAGIC = b"\x89EKFCKPT"
FAST = 1
"""Level of the compression: a state is mostly zeros, and is written once a second."""
FORMAT = 6
LIMIT = CheckpointConfig().limit
"""Age beyond which a checkpoint is stale unless told otherwise, s."""
DISAGREEMENT_NS = 2_000_000_000
"""Between two clocks' measures of one span: a stalled link, not a reboot, which takes longer."""
LARGEST_DELAY_NS = 2_000_000_000
"""From a sample's stamp to the time when it was true; settings allow 1 s."""
LARGEST = 1e12
"""In the motion and its covariance."""
MOST_STARTS = 5
"""After so many restarts, each within :data:`STEADY_NS` of the last, the state may be the cause."""
STEADY_NS = 3_000_000_000
"""What a bad state breaks, it breaks at the first samples and fixes."""
_HEADER = struct.Struct("<8sI8s8s32s12s2B4BH5q16s9dB6d2I")
_LARGEST_RANK = 4
_LARGEST_OFFSET = 1e3
"""Between two inertial units, rad/s and m/s^2: no two differ by as much."""
_HIGHEST = 1e5
"""Of an origin, m, as of a fix (``core/order/events.py``)."""
_FARTHEST = 1e3
"""Slow error of a receiver, m: none that is believed comes near."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class State:
    """Everything that the estimator needs to go on."""

    epoch_ns: int
    """The zero of times in the block, autopilot clock, ns."""
    stamp_ns: int
    """Stamp of the newest inertial sample, ns."""
    block: Array
    """As core.layout says, shape (BLOCK,)."""
    waiting: Array
    """Events that waited for the next sample, shape (n, ROW)."""
    settings: bytes
    """Fingerprint of the numbers that the estimator runs with, 8 bytes."""
    sent_before: int = 0
    """Resets that were sent before this state was begun with, >= 0."""
    bank: Array = field(default_factory=lambda: np.zeros(0))
    """Fault hypotheses, as ``Timeline.bank`` returns them; empty: there are none."""

    @property
    def next_reset(self) -> int:
        """The count of resets that comes after the last one sent."""
        return self.sent_before + int(as_state(self.block).resets) + 1


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Checkpoint:
    """A state, and whose and when it was."""

    state: State
    vehicle: Vehicle
    clocks: Clocks
    """When it was taken, together with the state's stamp."""
    sources: Sources
    sent: SentFrame = UNSENT
    unit: int = 0
    """Number of the inertial unit in use."""
    unit_offset: Sample = (0.0,) * 6
    """What is added to its readings, rad/s and m/s^2: they continue those of another one."""
    starts: int = 0
    """Restarts from checkpoints in a row, none of which lasted a minute."""

    @property
    def remains(self) -> Remains:
        """What is left of it if its state is refused."""
        origin = _origin(self.state.block)
        return Remains(self.vehicle, self.clocks, self.state.stamp_ns, origin, self.sent)

    def refuse_vehicle(self, vehicle: Vehicle, settings: bytes) -> Refusal | None:
        """Return why it does not fit this vehicle and these settings; None if it does."""
        if self.vehicle != vehicle:
            return foreign(self.vehicle, vehicle)
        if self.state.settings != settings:
            words = "the estimator's settings are others now, and it begins with them"
            return Refusal(Why.SETTINGS, words, self.state.next_reset, self.remains)
        return None

    def refuse_time(self, stamp_ns: int, now: Clocks, limit: float = LIMIT) -> Refusal | None:
        """Return why it does not fit the stamp of an inertial sample of now; None if it does.

        One stamp proves nothing: it may have waited in a buffer. See :mod:`.warm_start`.
        """
        lost = (stamp_ns - self.state.stamp_ns) * 1e-9
        passed = now.since(self.clocks) * 1e-9
        if lost <= 0.0:
            return Refusal(
                Why.REBOOTED,
                f"the autopilot's clock stands {-lost:.1f} s before it, so the autopilot has "
                "rebooted since: a new flight begins with a new alignment and a new origin",
            )
        if lost > limit:
            return Refusal(
                Why.STALE,
                f"it is {lost:.1f} s old by the autopilot's clock, and checkpoint.limit is "
                f"{limit:g} s: by now the vehicle can be anywhere and lie anyhow",
                self.state.next_reset,
                self.remains,
            )
        if abs(passed - lost) * 1e9 > DISAGREEMENT_NS:
            return Refusal(
                Why.CLOCKS,
                f"{lost:.1f} s have passed since by the autopilot's clock, {passed:.1f} s by ours: "
                "it has rebooted, our clock was set, or a simulator is faster than time",
                self.state.next_reset,
                self.remains,
            )
        return None


def foreign(theirs: Vehicle, ours: Vehicle) -> Refusal:
    """Return the refusal of another vehicle's checkpoint."""
    return Refusal(
        Why.FOREIGN,
        f"it is of another vehicle ({theirs}; this is {ours}); "
        "two vehicles want two files (checkpoint.file)",
    )


def layout_fingerprint() -> bytes:
    """Return 8 bytes that change with any field or number of the filter's memory."""
    declared = f"{pxd(enums)}{pxd(declared_state)}{ROW}"
    return hashlib.sha256(declared.encode()).digest()[:8]


def bank_fingerprint() -> bytes:
    """Return 8 bytes that change with any field of the fault hypotheses."""
    return hashlib.sha256(pxd(declared_bank).encode()).digest()[:8]


LAYOUT = layout_fingerprint()
BANK_LAYOUT = bank_fingerprint()


def settings_fingerprint(parameters: Array, delays_ns: npt.NDArray[np.int64]) -> bytes:
    """Return 8 bytes that change with any parameter of the estimator."""
    return hashlib.sha256(parameters.tobytes() + delays_ns.tobytes()).digest()[:8]


def encode(checkpoint: Checkpoint) -> bytes:
    """Return the checkpoint as bytes."""
    state = checkpoint.state
    body = _HEADER.pack(
        MAGIC,
        FORMAT,
        LAYOUT,
        state.settings,
        __version__.encode(),
        checkpoint.vehicle.family.encode(),
        checkpoint.vehicle.system_id,
        checkpoint.vehicle.component_id,
        *checkpoint.sources,
        min(checkpoint.starts, 0xFFFF),
        state.epoch_ns,
        state.stamp_ns,
        state.sent_before,
        *checkpoint.clocks,
        *_origin_numbers(_origin(state.block)),
        *checkpoint.sent,
        checkpoint.unit,
        *checkpoint.unit_offset,
        len(state.block),
        len(state.waiting),
    )
    content = state.block.astype("<f8").tobytes() + state.waiting.astype("<f8").tobytes()
    if len(state.bank):
        content += BANK_LAYOUT + state.bank.astype("<f8").tobytes()
    body += zlib.compress(content, FAST)
    return body + zlib.crc32(body).to_bytes(4, "little")


def is_ours(data: bytes) -> bool:
    """Whether bytes begin as a checkpoint does."""
    return data[: len(MAGIC)] == MAGIC


def decode(data: bytes) -> Checkpoint | Refusal:
    """Return the checkpoint in bytes of :func:`encode`, or why they are refused."""
    if not is_ours(data):
        words = "it does not begin as a checkpoint; name a file for nothing else"
        return Refusal(Why.DAMAGED, words)
    if len(data) < _HEADER.size + 4 or zlib.crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
        return Refusal(
            Why.DAMAGED,
            "its checksum is wrong: it was cut off or altered on the disk; look at the disk if it "
            "comes again",
        )
    (_, form, layout, settings, version, family, system_id, component_id, *rest) = (
        _HEADER.unpack_from(data)
    )
    *sources, starts, epoch_ns, stamp_ns, before, unix_ns, boot_ns, boot_id = rest[:11]
    *numbers, size, count = rest[11:]
    lat, lon, datum, unit, gx, gy, gz, ax, ay, az = numbers[6:]
    offset = gx, gy, gz, ax, ay, az
    sent = SentFrame(datum=datum if abs(datum) < _HIGHEST else math.nan)
    if abs(lat) < math.pi / 2 and abs(lon) <= math.pi:
        sent = sent._replace(lat=lat, lon=lon)
    vehicle = Vehicle(family.rstrip(b"\0").decode(errors="replace"), system_id, component_id)
    clocks = Clocks(unix_ns, boot_ns, boot_id)
    remains = None
    if form == FORMAT:
        remains = Remains(vehicle, clocks, stamp_ns, _origin_of(numbers[:6]), sent)
    wrote = version.rstrip(b"\0").decode(errors="replace")
    if (form, layout, wrote) != (FORMAT, LAYOUT, __version__[:32]):
        return Refusal(
            Why.VERSION,
            f"ekf-companion {wrote} wrote it, and this {__version__} lays its state out otherwise; "
            "the next one takes its place",
            remains=remains,
        )
    end = 8 * (size + count * ROW)
    try:
        whole = zlib.decompress(data[_HEADER.size : -4])
    except zlib.error:
        whole = b""
    more = len(whole) - end
    if size != BLOCK or more < 0 or more % 8:
        return Refusal(Why.DAMAGED, "its size does not fit its content")
    content = np.frombuffer(whole[:end], dtype="<f8").astype(np.float64)
    state = State(
        epoch_ns=epoch_ns,
        stamp_ns=stamp_ns,
        block=content[:size],
        waiting=content[size:].reshape(count, ROW),
        settings=settings,
        sent_before=before,
        bank=_bank(whole[end:]),
    )
    is_offset = all(abs(one) < _LARGEST_OFFSET for one in offset)
    if max(sources) > _LARGEST_RANK or not is_offset or vehicle.family not in HABITS:
        return Refusal(Why.DAMAGED, "it names what there is not; please report it")
    if refusal := _refuse_state(state):
        return replace(refusal, remains=remains if refusal.why is Why.ALIGNING else None)
    if starts >= MOST_STARTS:
        return Refusal(
            Why.LOOP,
            f"{starts} restarts came within seconds of each other, and the state may be their "
            "cause; look above for what ended the daemon",
            state.next_reset,
            remains,
        )
    return Checkpoint(
        state=state,
        vehicle=vehicle,
        clocks=clocks,
        sent=sent,
        sources=Sources(*sources),
        unit=unit,
        unit_offset=offset,
        starts=starts,
    )


def _bank(data: bytes) -> Array:
    """Return fault hypotheses in the bytes behind a state; empty: there are none of this layout."""
    none = np.zeros(0)
    found = np.frombuffer(data[len(BANK_LAYOUT) :], dtype="<f8").astype(np.float64)
    if data[: len(BANK_LAYOUT)] != BANK_LAYOUT or not len(found):
        return none
    try:
        numbers = unpack(found)  # which lives as long as what lies over it
    except ValueError:
        return none
    banks: Any = as_banks(numbers[None])
    bank = banks[0]
    if not 0 <= bank.finds <= FOUND:
        return none
    kinds = {bank.found[i].kind for i in range(bank.finds)}
    kinds |= {bank.instance[i].kind for i in range(bank.n)}
    return found if kinds <= set(Fault) and np.isfinite(found).all() else none


def _refuse_state(state: State) -> Refusal | None:
    """Refuse a state that no filter can be in, or that is not worth going on from."""
    x = as_state(state.block)
    if x.mode in (Mode.INIT, Mode.LEVEL):
        words = "it had not found its attitude yet"
        return Refusal(Why.ALIGNING, words, state.next_reset if x.resets else 0)
    P = np.array(x.P)
    motion = np.hstack([x.q_nb, errors(x), x.gyro, x.accel])
    is_possible = (
        _is_known(state.block)
        and bool((np.abs(motion) < LARGEST).all())
        and 0.0 <= x.dt < LARGEST
        and bool((np.abs(P) < LARGEST).all())
        and not np.isinf(state.block).any()
        and float(np.diagonal(P).min()) >= 0.0
        and abs(float(np.linalg.norm(x.q_nb)) - 1.0) < 1e-6
        and x.mode in (Mode.ATTITUDE, Mode.NAVIGATE)
        and 0.0 <= x.resets < 2.0**53
        and x.reset_reason in tuple(Reset)
        and abs(state.stamp_ns - state.epoch_ns - x.t) < LARGEST_DELAY_NS
        and bool(np.isfinite(state.waiting[:, :2]).all())
    )
    if not is_possible:
        return Refusal(Why.DAMAGED, "it holds a state that no vehicle can be in; please report it")
    return None


def _origin(block: Array) -> Origin | None:
    """Return the origin in a state's block; None if there is none yet."""
    x = as_state(block)
    if not x.origin.is_known:
        return None
    north, east, down = x.gnss_offset
    return Origin(x.origin.lat, x.origin.lon, x.origin.alt, (north, east, down))


def _origin_numbers(origin: Origin | None) -> tuple[float, ...]:
    return (math.nan,) * 6 if origin is None else (*origin[:3], *origin.offset)


def _origin_of(numbers: Sequence[float]) -> Origin | None:
    """Return the origin in a header's numbers, unless no place can be there."""
    lat, lon, alt, *offset = numbers
    is_place = abs(lat) < math.pi / 2 and abs(lon) <= math.pi and abs(alt) < _HIGHEST
    if not (is_place and all(abs(one) < _FARTHEST for one in offset)):
        return None
    return Origin(lat, lon, alt, (offset[0], offset[1], offset[2]))


def _is_known(block: Array) -> bool:
    """Return whether all is finite that must be."""
    known = block.copy()
    x = as_state(known)
    x.field, x.alignment = Field(), Alignment()
    x.armed = x.landed = 0.0
    x.slide.way[:] = (0.0, 0.0)
    x.force_sum[:] = (0.0, 0.0, 0.0)
    return bool(np.isfinite(known).all())


__all__ = [
    "UNSENT",
    "Clocks",
    "Origin",
    "Refusal",
    "Remains",
    "SentFrame",
    "Sources",
    "Vehicle",
    "Why",
]
