"""Inertial samples from the best message that carries them, and what else these messages carry."""

from __future__ import annotations

import math
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.air import FIRST_OTHER, Barometer, Magnetometer
from ekf_companion.mavlink.decode.context import Context, Family, Measurements
from ekf_companion.mavlink.decode.preference import Preference
from ekf_companion.mavlink.decode.state import InertialState
from ekf_companion.mavlink.decode.trim import Trim
from ekf_companion.mavlink.dejitter import Dejitter
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import by_name
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.inertial_unit import Unit
from ekf_companion.nav.lanes import CHANGED, LEFT, SHARE, USED, Lanes
from ekf_companion.nav.matrix3 import Vector3
from ekf_companion.nav.measurements import ImuSample
from ekf_companion.nav.repetition import MEASURED, SPIKE, ZERO, Repetition, Sample

SOURCES = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""The best first: whole numbers are coarser, and milliseconds coarser than microseconds."""
ACCEL_GYRO = 0x3F
MAG = 0x1C0
PRESSURE = 0x200
"""Bits of HIGHRES_IMU.fields_updated."""
_MILLI_G = STANDARD_GRAVITY * 1e-3
_MILLISECOND_US = 1000
REPEATED = "stamp repeated"
"""Why a sample is refused for its stamp."""
ANOTHER_UNIT, UNIT_CHANGED = "another unit is used", "IMU: unit changed"
"""Why a sample is not used; and the count of changes."""
_NO_SAMPLE = (0.0,) * 6
_LOOK_US = 2_000_000
"""Time for which a second unit is looked at, us, before it is known whether it is one to go to."""
_PAUSE_US = 60_000_000
"""Time until it is looked at again, us, if it is not."""


class Inertial(InertialState):
    """Reads inertial samples from the best message that carries them."""

    def __init__(self, context: Context, mag: Magnetometer, baro: Barometer, trim: Trim) -> None:
        self._context, self._mag, self._baro, self._trim = context, mag, baro, trim
        self._layout = by_name("HIGHRES_IMU")
        self._ranks = {by_name(name).message_id: rank for rank, name in enumerate(SOURCES)}
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.sources = Preference(SHARE)
        self.instance = self._context.options.imu_id
        """The sensor in use, as HIGHRES_IMU numbers them."""
        self.instances = Preference(SHARE)
        self.lanes = Lanes(self.instance)
        """All units that are heard, by their numbers: HIGHRES_IMU.id, SCALED_IMU2 the second."""
        self.is_watching = False
        """Whether several are compared."""
        self.look_us = 0
        """Until when a second unit is looked at, or from when on again."""
        self._carriers: dict[int, int] = {}
        """Rank of the message that each unit is watched by."""
        self.last_us = -1
        self._is_marked = False
        """Whether HIGHRES_IMU has said of a sample that it is new: then it says so of each."""
        self._unmarked: Sample | None = None
        self.begin_stream()

    def begin_stream(self) -> None:
        """Forget stamps and samples of the message in use: another has other numbers."""
        self.repetition = Repetition()
        is_ms = self.sources.rank > 1
        is_sent = self._context.family is Family.ARDUPILOT
        self.dejitter: Dejitter | None = None
        if self._context.options.is_dejittered and (is_ms or is_sent):
            self.dejitter = Dejitter(_MILLISECOND_US if is_ms else 1)

    @property
    def is_dejittered(self) -> bool:
        """Whether stamps are being corrected."""
        return self.dejitter is not None and self.dejitter.is_active

    def highres_imu(self, frame: Frame) -> Measurements:
        """Read HIGHRES_IMU."""
        context = self._context
        (t_us, ax, ay, az, gx, gy, gz, mx, my, mz, pressure, _, _, _, updated, instance) = (
            self._layout.unpack(frame.payload)
        )
        out, is_sure = [], True
        if not context.clock.follow(t_us):
            followed = context.follow_us(t_us, "HIGHRES_IMU")
            if followed is None:
                return []
            out, is_sure = followed, not context.clock.is_in_doubt
        t_ns = t_us * 1000
        sample = (gx, gy, gz, ax, ay, az)
        is_whole = is_sure and (updated & ACCEL_GYRO == ACCEL_GYRO or not self._is_marked)
        if is_whole and self._is_done(out, instance, 0, t_us, sample):
            if instance == context.options.imu_id:
                self._add_others(out, updated, t_ns, (mx, my, mz), pressure)
            return out
        # The configured one goes first
        rank = 0 if instance == context.options.imu_id else instance + 1
        was = self.instances.rank
        if rank != self.instances.sole and not self.instances.admit(rank, t_ns):
            context.refused["HIGHRES_IMU: another instance"] += 1
            return out
        if rank != was:
            self._note_instance(instance, is_better=rank < was)
            self._use(instance, t_ns)
        if updated & ACCEL_GYRO:
            self._is_marked = True
        elif self._is_unmarked(sample):
            updated = ACCEL_GYRO | MAG | PRESSURE
        if updated & MAG == MAG and (mx or my or mz):
            self.repetition.see(mx, my, mz)
        if updated & ACCEL_GYRO != ACCEL_GYRO:
            context.refuse("HIGHRES_IMU: accel or gyro not updated")
        elif (
            t_us > self.last_us
            and (why := self.repetition.judge(t_us, sample))
            and self.is_refused(why)
        ):
            self.last_us = t_us
            # nor the magnetometer: it turned with the vehicle, and by how much is not known
            return out
        else:
            t_ns = self._add(out, 0, t_us, sample, is_sure)
        if is_sure:  # else what came with it cannot wait for the next, as the sample will
            self._add_others(out, updated, t_ns, (mx, my, mz), pressure)
        return out

    def _add_others(
        self, out: Measurements, updated: int, t_ns: int, field: Vector3, pressure: float
    ) -> None:
        """Append field and pressure of a HIGHRES_IMU, those that are new."""
        if updated & MAG == MAG:
            self._mag.add(out, 0, t_ns, *field)
        if updated & PRESSURE:
            self._baro.add(out, 0, t_ns, pressure)

    def is_refused(self, why: str, rank: int = 0) -> bool:
        """Return whether a sample is refused, for it measures nothing; count it, and tell a human.

        At the end of its range, or with an axis that is stuck, it measures still, with a larger
        noise, which the filter finds.
        """
        self._context.refused[f"{SOURCES[rank]}: {why}"] += 1
        number = self.instance if rank == 0 else max(rank - 2, 0)
        same = "" if why in (ZERO, SPIKE) else ": it says the same again and again"
        use = "so its noise counts as larger" if why in MEASURED else "which is not used"
        self._context.note_once(
            f"Inertial sensor {number} is {why}{same}, {use}; check the sensor, its mounting and "
            "its range"
        )
        return why not in MEASURED

    @property
    def unit(self) -> int:
        """Number of the unit in use."""
        rank = self.sources.rank
        return self.instance if rank == 0 else max(rank - 2, 0)

    def units(self) -> dict[str, str]:
        """Return what becomes of each unit that is heard, by its number; empty: there is one."""
        if len(self.lanes.units) < 2:
            return {}
        return {str(one.number): self._words(one) for one in self.lanes.units}

    def _words(self, one: Unit) -> str:
        """Return what becomes of a unit."""
        if one.number == self.unit:
            return "used"
        if not one.faults:
            return "spare"
        found = f"{one.why} at {one.failed_ns * 1e-9:.1f} s"
        is_over = not one.has_failed(self.lanes.unit(self.unit).t_ns)
        return f"spare, was {found}" if is_over else found

    def resume(self, number: int, offset: Sample) -> None:
        """Go on with a unit of a run before, and what was added to its readings."""
        if self.sources.rank == 0:
            self.instance = number
            self.instances.use(0 if number == self._context.options.imu_id else number + 1)
        self.lanes.resume(number, offset)
        self.is_watching = self.lanes.is_shifted

    def _is_done(self, out: Measurements, unit: int, rank: int, t_us: int, sample: Sample) -> bool:
        """Judge a unit by a sample beside the others; return whether that is all to be done.

        It is where another is used; where this is the first of another one, ``out`` has it.
        """
        is_used = unit == self.unit
        if not self.lanes.has_room(unit):
            return False
        if not self.is_watching:
            if is_used or t_us < self.look_us:
                return False
            self.is_watching, self.look_us = True, t_us + _LOOK_US
        lanes, t_ns = self.lanes, t_us * 1000
        carrier = self._carriers.get(unit, rank)
        if is_used:
            if rank != self.sources.rank:
                return False
        elif rank > carrier and not lanes.unit(unit).is_silent(t_ns):
            return False
        self._carriers[unit] = rank
        became = lanes.add(unit, t_ns, *sample)
        one = lanes.unit(unit)
        told = [(change.left, change.why) for change in lanes.changes]
        if became == LEFT and one.faults and (unit, one.why) not in told:
            self._context.note_once(f"Inertial sensor {unit}, which stands by, is {one.why}")
        if became == USED:
            if t_us >= self.look_us:
                self.is_watching = lanes.is_shifted or lanes.has_spare(t_ns)
                self.look_us = t_us + (_LOOK_US if self.is_watching else _PAUSE_US)
            return False
        if became == CHANGED:
            self.change(out)
            return True
        # A unit that was left is not gone back to for being preferred
        may_be_preferred = not lanes.knows(unit) and not lanes.is_shifted
        may_be_preferred |= lanes.is_starving(unit, t_ns)
        if may_be_preferred or lanes.unit(self.unit).is_silent(t_ns):
            return False
        self._context.refused[f"{SOURCES[rank]}: {ANOTHER_UNIT}"] += 1
        return True

    def change(self, out: Measurements) -> None:
        """Use the unit that was found to be better, from its first sample that was not used on."""
        change = self.lanes.changes[-1]
        rank = self._carriers[change.used]
        self.sources.use(rank)
        if rank == 0:
            self.instance = change.used
            is_first = change.used == self._context.options.imu_id
            self.instances.use(0 if is_first else change.used + 1)
        self.begin_stream()
        self._context.refused[UNIT_CHANGED] += 1
        self._context.notes.append(
            f"Inertial sensor {change.used} is used: {change.left} is {change.why}"
        )
        for t_ns, *numbers in change.ready:
            gx, gy, gz, ax, ay, az = numbers
            self._emit(out, t_ns // 1000, (gx, gy, gz, ax, ay, az))

    def _use(self, unit: int, t_ns: int) -> None:
        """Take into account that another unit is used, since the one before has been silent."""
        count = len(self.lanes.changes)
        self.lanes.use(unit, t_ns)
        if len(self.lanes.changes) > count:
            self.is_watching = True

    def _is_unmarked(self, sample: Sample) -> bool:
        """Whether a sample is new that is not marked so, as its sender never marks one."""
        if self._is_marked or sample == self._unmarked:
            return False
        self._unmarked = sample
        if sample == _NO_SAMPLE:
            return False
        self._context.note_once(
            "HIGHRES_IMU marks no sample as new (fields_updated): each that differs from the one "
            "before is taken"
        )
        return True

    def _note_instance(self, instance: int, *, is_better: bool) -> None:
        """Note that another sensor is used from now on.

        ArduPilot sends the first sensor that works, and that may change in flight.
        """
        away = f"is used: {self.instance} has been silent, or much slower, for 3 s"
        why = "speaks steadily" if is_better else away
        self._context.refused["HIGHRES_IMU: instance changed"] += 1
        self._context.notes.append(f"Inertial sensor {instance} {why}; its biases are other ones")
        self.instance = instance

    def raw_imu(self, frame: Frame) -> Measurements:
        """Read RAW_IMU, which has units on ArduPilot only."""
        if self._context.family is not Family.ARDUPILOT:
            return self._context.refuse("RAW_IMU: not ArduPilot")
        m = unpack(frame)
        t_us = self._context.clock.widened(m.time_usec)
        out = self._context.follow_us(t_us, "RAW_IMU")
        if out is None:
            return []
        self._add_integers(out, 1, t_us, m)
        return out

    def scaled_imu(self, frame: Frame) -> Measurements:
        """Read SCALED_IMU, SCALED_IMU2 or SCALED_IMU3."""
        m = unpack(frame)
        out, t_ns = self._context.follow_ms(m.time_boot_ms, "SCALED_IMU")
        if t_ns is None:
            return out
        if t_ns == 0:
            return self._context.refuse("SCALED_IMU: no time")
        self._add_integers(out, self._ranks[frame.message_id], t_ns // 1000, m)
        return out

    def _add_integers(self, out: Measurements, rank: int, t_us: int, m: Any) -> None:
        """Append the content of RAW_IMU and SCALED_IMU: milli-g, mrad/s and milligauss."""
        xacc, yacc, zacc, xgyro, ygyro, zgyro, xmag, ymag, zmag = m[1:10]
        t_ns = t_us * 1000
        rates: tuple[float, float, float] | None = None
        if not (xacc or yacc or zacc or xgyro or ygyro or zgyro):
            if rank == self.sources.rank:
                self.is_refused(ZERO, rank)
            else:
                self._context.refuse("SCALED_IMU: no sensor behind it")
        else:
            rates = (xgyro * 1e-3, ygyro * 1e-3, zgyro * 1e-3)
            forces = (xacc * _MILLI_G, yacc * _MILLI_G, zacc * _MILLI_G)
            if not self._context.clock.is_in_doubt and self._is_done(
                out, max(rank - 2, 0), rank, t_us, rates + forces
            ):
                self._add_field(out, rank, t_ns, xmag, ymag, zmag, rates)
                return
            if rank == self.sources.rank and (xmag or ymag or zmag):
                self.repetition.see(xmag, ymag, zmag)
            if self._is_stuck(rank, t_us, rates + forces):
                return
            is_sure = not self._context.clock.is_in_doubt
            t_ns = self._add(out, rank, t_us, rates + forces, is_sure)
            if not is_sure:
                return
        self._add_field(out, rank, t_ns, xmag, ymag, zmag, rates)

    def _add_field(
        self,
        out: Measurements,
        rank: int,
        t_ns: int,
        xmag: int,
        ymag: int,
        zmag: int,
        rates: tuple[float, float, float] | None,
    ) -> None:
        """Append the field, milligauss, that came with a sample."""
        if rank >= FIRST_OTHER:
            # a third compass comes without a third inertial sensor too
            self._mag.compare(rank, t_ns, (xmag * 1e-3, ymag * 1e-3, zmag * 1e-3), rates)
        self._mag.add(out, rank, t_ns, xmag * 1e-3, ymag * 1e-3, zmag * 1e-3)

    def _is_stuck(self, rank: int, t_us: int, sample: Sample) -> bool:
        """Refuse a new sample of the message in use if its sensor measures nothing."""
        is_new = t_us > self.last_us and not self._context.clock.is_in_doubt
        if rank != self.sources.rank or not is_new:
            return False
        why = self.repetition.judge(t_us, sample)
        if why is None or not self.is_refused(why, rank):
            return False
        self.last_us = t_us
        return True

    def _add(self, out: Measurements, rank: int, t_us: int, sample: Sample, is_sure: bool) -> int:
        """Append a sample if it is good; return the time, ns, of all that came with it.

        A stamp that is not sure yet is left as it is, and nothing is learnt from it.
        """
        context = self._context
        t_ns = t_us * 1000
        was = self.sources.rank
        if not math.isfinite(sum(sample)):
            context.refuse("IMU: not a number")
        elif rank != self.sources.sole and not self.sources.admit(rank, t_ns):
            context.refuse("IMU: a better source speaks")
        elif t_us == self.last_us:
            context.refuse(f"IMU: {REPEATED}")
        else:
            if rank != was:
                self._note_source(was, rank)
                self._use(self.unit, t_ns)
            if is_sure:
                return self._emit(out, t_us, sample)
            out.append(ImuSample(t_ns, *self._in_vehicle(t_ns, sample)))
        return t_ns

    def _emit(self, out: Measurements, t_us: int, sample: Sample) -> int:
        """Append a sample of the unit in use; return its time, ns."""
        self.last_us, t_ns = t_us, t_us * 1000
        sample = self._in_vehicle(t_ns, sample)
        if self.dejitter is not None:
            t_ns = self.dejitter.smooth(t_us)
        out.append(ImuSample(t_ns, *sample, *self.lanes.take_std()))
        return t_ns

    def _in_vehicle(self, t_ns: int, sample: Sample) -> Sample:
        """Return a sample in the axes of the vehicle, continued from those of the unit before."""
        if self.lanes.is_shifted:
            sample = self.lanes.shifted(sample)
        trim = self._trim
        if trim.first_ns is None:
            trim.first_ns = t_ns
        if trim.rows is None:
            return sample
        gx, gy, gz = trim.to_vehicle(*sample[:3])
        ax, ay, az = trim.to_vehicle(*sample[3:])
        return gx, gy, gz, ax, ay, az

    def _note_source(self, was: int, now: int) -> None:
        self.begin_stream()
        away = f"is used: {SOURCES[was]} has been silent, or much slower, for 3 s"
        why = "speaks steadily" if now < was else away
        self._context.notes.append(f"{SOURCES[now]} {why}")
