"""Inertial samples from the best message that carries them, and what else these messages carry."""

from __future__ import annotations

import math
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.air import Barometer, Magnetometer
from ekf_companion.mavlink.decode.context import Context, Family, Measurements, Preference
from ekf_companion.mavlink.decode.trim import Trim
from ekf_companion.mavlink.dejitter import Dejitter
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import by_name
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import ImuSample

SOURCES = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""The best first: whole numbers are coarser, and milliseconds coarser than microseconds."""
_ACCEL_GYRO = 0x3F
_MAG = 0x1C0
_PRESSURE = 0x200
"""Bits of HIGHRES_IMU.fields_updated."""
_MILLI_G = STANDARD_GRAVITY * 1e-3
_MILLISECOND_US = 1000
_STARVING = 0.25
"""A finer sensor at less than a quarter of the rate of a coarser one loses more than it gains."""


class Inertial:
    """Reads inertial samples from the best message that carries them."""

    def __init__(self, context: Context, mag: Magnetometer, baro: Barometer, trim: Trim) -> None:
        self._context, self._mag, self._baro, self._trim = context, mag, baro, trim
        self._layout = by_name("HIGHRES_IMU")
        self._ranks = {by_name(name).message_id: rank for rank, name in enumerate(SOURCES)}
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.sources = Preference(_STARVING)
        self.instance = self._context.options.imu_id
        """The sensor in use, as HIGHRES_IMU numbers them."""
        self._instances = Preference(_STARVING)
        self._last_us = -1
        self._repetition = Repetition()
        self.begin_stream()

    def begin_stream(self) -> None:
        """Forget the stamps of the message in use."""
        is_ms = self.sources.rank > 1
        is_sent = self._context.family is Family.ARDUPILOT
        self._dejitter: Dejitter | None = None
        if self._context.options.is_dejittered and (is_ms or is_sent):
            self._dejitter = Dejitter(_MILLISECOND_US if is_ms else 1)

    @property
    def is_dejittered(self) -> bool:
        """Whether stamps are being corrected."""
        return self._dejitter is not None and self._dejitter.is_active

    def highres_imu(self, frame: Frame) -> Measurements:
        """Read HIGHRES_IMU."""
        layout, context = self._layout, self._context
        (t_us, ax, ay, az, gx, gy, gz, mx, my, mz, pressure, _, _, _, updated, instance) = (
            layout.struct.unpack(frame.payload.ljust(layout.size, b"\0")[: layout.size])
        )
        out, is_sure = [], True
        if not context.clock.follow(t_us):
            followed = context.follow_us(t_us, "HIGHRES_IMU")
            if followed is None:
                return []
            out, is_sure = followed, not context.clock.is_in_doubt
        t_ns = t_us * 1000
        # The configured one goes first
        rank = 0 if instance == context.options.imu_id else instance + 1
        was = self._instances.rank
        if rank != self._instances.sole and not self._instances.admit(rank, t_ns):
            context.refused["HIGHRES_IMU: another instance"] += 1
            return out
        if rank != was:
            self._note_instance(instance, is_better=rank < was)
        sample = (gx, gy, gz, ax, ay, az)
        if updated & _ACCEL_GYRO != _ACCEL_GYRO:
            context.refuse("HIGHRES_IMU: accel or gyro not updated")
        elif t_us > self._last_us and (why := self._repetition.judge(t_us, sample)):
            self._refuse_stuck(why)
            self._last_us = t_us
            # nor the magnetometer: it turned with the vehicle, and by how much is not known
            return out
        else:
            t_ns = self._add(out, 0, t_us, sample, is_sure)
        if not is_sure:
            return out  # what came with it cannot wait for the next, as the sample will
        if updated & _MAG == _MAG:
            self._mag.add(out, 0, t_ns, mx, my, mz)
        if updated & _PRESSURE:
            self._baro.add(out, 0, t_ns, pressure)
        return out

    def _refuse_stuck(self, why: str) -> None:
        self._context.refuse(f"HIGHRES_IMU: {why}")
        self._context.note_once(
            f"Inertial sensor {self.instance} is {why}: it says the same again and again, which is "
            "not used; check the sensor, its mounting and its range"
        )

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
        out = self._context.follow_us(m.time_usec, "RAW_IMU")
        if out is None:
            return []
        self._add_integers(out, 1, m.time_usec, m)
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
        if not (xacc or yacc or zacc or xgyro or ygyro or zgyro):
            self._context.refuse("SCALED_IMU: no sensor behind it")
        else:
            rates = (xgyro * 1e-3, ygyro * 1e-3, zgyro * 1e-3)
            forces = (xacc * _MILLI_G, yacc * _MILLI_G, zacc * _MILLI_G)
            is_sure = not self._context.clock.is_in_doubt
            t_ns = self._add(out, rank, t_us, rates + forces, is_sure)
            if not is_sure:
                return
        self._mag.add(out, rank, t_ns, xmag * 1e-3, ymag * 1e-3, zmag * 1e-3)

    def _add(self, out: Measurements, rank: int, t_us: int, sample: _Sample, is_sure: bool) -> int:
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
        elif t_us == self._last_us:
            context.refuse("IMU: stamp repeated")
        else:
            if rank != was:
                self._note_source(was, rank)
            trim = self._trim
            trim.begin(t_ns)
            sample = (*trim.to_vehicle(*sample[:3]), *trim.to_vehicle(*sample[3:]))
            if not is_sure:
                out.append(ImuSample(t_ns, *sample))
                return t_ns
            self._last_us = t_us
            if self._dejitter is not None:
                sampled = self._dejitter.smooth(t_us)
                if sampled is None:
                    context.refuse("IMU: out of order")
                    return t_ns
                t_ns = sampled
            out.append(ImuSample(t_ns, *sample))
        return t_ns

    def _note_source(self, was: int, now: int) -> None:
        self.begin_stream()
        away = f"is used: {SOURCES[was]} has been silent, or much slower, for 3 s"
        why = "speaks steadily" if now < was else away
        self._context.notes.append(f"{SOURCES[now]} {why}")


_Sample = tuple[float, float, float, float, float, float]
"""Rate, rad/s, and specific force, m/s^2, in the body."""

_CHANCE = math.log(1e-12)
"""Logarithm of the probability of a run at which it is no chance: if samples were independent, one
false alarm in some years at 250 Hz."""
_MEMORY = 2048
"""Pairs after which the counts are halved."""
_FEWEST = 64
"""Fewest pairs to conclude anything from."""
_RATE = 0.1
"""rad/s; no range ends so low, and no gyro has such a bias, so the sensor turns."""
_FORCE = 2.0
"""m/s^2; nor does an accelerometer's range."""
_LANDED_US = 5_000_000
"""Equal samples as of standing still may come from a simulator if they last so long."""

STUCK = "stuck"
LIMITED = "at the end of its range"


class Repetition:
    """Finds in the samples of one sensor that it is stuck, or at the end of its range.

    A sensor's noise makes its readings differ. How often two in a row are equal to the bit all the
    same is counted for each axis; a run of equal ones that is too long to be chance means that the
    axis measures nothing any more. It is counted because whole numbers in disguise, and simulators
    without noise, repeat themselves all the time: there no run is long enough.
    """

    __slots__ = ("_equal", "_last", "_pairs", "_runs", "_since_us")

    def __init__(self) -> None:
        self._last: _Sample = (math.nan,) * 6
        self._runs = [0] * 6
        self._equal = [0] * 6
        self._pairs = 0
        self._since_us = 0

    def judge(self, t_us: int, sample: _Sample) -> str | None:
        """Return why a sample, newer than all before, measures nothing; None if it does."""
        last, self._last = self._last, sample
        self._pairs += 1
        is_any = False
        for axis in range(6):
            if sample[axis] == last[axis]:
                is_any = True
                self._runs[axis] += 1
                self._equal[axis] += 1
            else:
                self._runs[axis] = 0
        if not is_any:
            self._since_us = t_us
            if self._pairs >= 2 * _MEMORY:
                self._pairs //= 2
                self._equal = [count // 2 for count in self._equal]
            return None
        silent = [axis for axis in range(6) if self._is_silent(axis)]
        if len(silent) == 6 and not self._may_stand(t_us, sample):
            return STUCK
        largest = (_RATE,) * 3 + (_FORCE,) * 3
        if len(silent) < 6 and any(abs(sample[axis]) > largest[axis] for axis in silent):
            return LIMITED
        return None

    def _is_silent(self, axis: int) -> bool:
        """Whether an axis has been constant for longer than chance explains."""
        run = self._runs[axis]
        known = self._pairs - run
        if not run or known < _FEWEST:
            return False
        return run * math.log((self._equal[axis] - run + 1) / (known + 2)) < _CHANCE

    def _may_stand(self, t_us: int, sample: _Sample) -> bool:
        rate, force = math.hypot(*sample[:3]), math.hypot(*sample[3:])
        is_still = rate < _RATE and abs(force - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY
        return is_still and t_us - self._since_us > _LANDED_US
