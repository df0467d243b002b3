"""Inertial messages, the best that speaks, and what else they bring."""

from __future__ import annotations

import math
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.air import Barometer, Magnetometer
from ekf_companion.mavlink.decode.context import Door, Family, Measurements
from ekf_companion.mavlink.decode.preference import Preference
from ekf_companion.mavlink.decode.repetition import Repetition
from ekf_companion.mavlink.dejitter import Dejitter
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import by_name
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import ImuSample

SOURCES = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""From the best: whole numbers are coarser, and milliseconds coarser than microseconds."""
_ACCEL_GYRO = 0x3F
_MAG = 0x1C0
_PRESSURE = 0x200
"""Bits of HIGHRES_IMU.fields_updated."""
_MILLI_G = STANDARD_GRAVITY * 1e-3
_MILLISECOND_US = 1000
_STARVING = 0.25
"""A finer sensor at less than a quarter of the rate of a coarser one misses more than it shows."""


class Inertial:
    """The inertial samples, from the best message that brings them."""

    def __init__(self, door: Door, mag: Magnetometer, baro: Barometer) -> None:
        self._door, self._mag, self._baro = door, mag, baro
        self._layout = by_name("HIGHRES_IMU")
        self._ranks = {by_name(name).message_id: rank for rank, name in enumerate(SOURCES)}
        self.forget()

    def forget(self) -> None:
        """Begin anew after a reboot."""
        self.sources = Preference(_STARVING)
        self.instance = self._door.options.imu_id
        """The sensor in use, as HIGHRES_IMU numbers them."""
        self._instances = Preference(_STARVING)
        self._last_us = -1
        self._repetition = Repetition()
        self.begin_stream()

    def begin_stream(self) -> None:
        """Know nothing of the stamps of the message in use."""
        is_ms = self.sources.rank > 1
        is_sent = self._door.family is Family.ARDUPILOT
        self._dejitter: Dejitter | None = None
        if self._door.options.is_dejittered and (is_ms or is_sent):
            self._dejitter = Dejitter(_MILLISECOND_US if is_ms else 1)

    def prefer(self, rank: int) -> None:
        """Take a source at once: it is known already that better ones are silent."""
        self.sources.rank = rank
        self.begin_stream()

    @property
    def is_dejittered(self) -> bool:
        """Whether stamps are being moved."""
        return self._dejitter is not None and self._dejitter.is_active

    def highres_imu(self, frame: Frame) -> Measurements:
        """Read HIGHRES_IMU."""
        layout, door = self._layout, self._door
        (t_us, ax, ay, az, gx, gy, gz, mx, my, mz, pressure, _, _, _, updated, instance) = (
            layout.struct.unpack(frame.payload.ljust(layout.size, b"\0")[: layout.size])
        )
        out = door.follow_us(t_us, "HIGHRES_IMU")
        if out is None:
            return []
        t_ns = t_us * 1000
        # The configured one goes first
        rank, was = (0 if instance == door.options.imu_id else instance + 1), self._instances.rank
        if not self._instances.admit(rank, t_ns):
            door.refused["HIGHRES_IMU: another instance"] += 1
            return out
        if rank != was:
            self._note_instance(instance, is_better=rank < was)
        if updated & _ACCEL_GYRO != _ACCEL_GYRO:
            door.refuse("HIGHRES_IMU: accel or gyro not updated")
        elif t_us > self._last_us and (
            why := self._repetition.judge(t_us, (gx, gy, gz, ax, ay, az))
        ):
            self._tell_silence(why)
            self._last_us = t_us
            # the compass turned with a vehicle whose turning nobody saw
            return out
        else:
            t_ns = self._add(out, 0, t_us, gx, gy, gz, ax, ay, az)
        if updated & _MAG == _MAG:
            self._mag.add(out, 0, t_ns, mx, my, mz)
        if updated & _PRESSURE:
            self._baro.add(out, 0, t_ns, pressure)
        return out

    def _tell_silence(self, why: str) -> None:
        self._door.refuse(f"HIGHRES_IMU: {why}")
        self._door.tell_once(
            f"Inertial sensor {self.instance} is {why}: it says the same again and again, which is "
            "not used; check the sensor, its mounting and its range"
        )

    def _note_instance(self, instance: int, *, is_better: bool) -> None:
        """Use another sensor from now on.

        ArduPilot sends the first sensor that works, and that may change in flight.
        """
        away = f"is used: {self.instance} has been silent, or much slower, for 3 s"
        why = "speaks steadily" if is_better else away
        self._door.refused["HIGHRES_IMU: instance changed"] += 1
        self._door.tell(f"Inertial sensor {instance} {why}; its biases are other ones")
        self.instance = instance

    def raw_imu(self, frame: Frame) -> Measurements:
        """Read RAW_IMU, which has units on ArduPilot only."""
        if self._door.family is not Family.ARDUPILOT:
            return self._door.refuse("RAW_IMU: not ArduPilot")
        m = unpack(frame)
        out = self._door.follow_us(m.time_usec, "RAW_IMU")
        if out is None:
            return []
        self._add_integers(out, 1, m.time_usec, m)
        return out

    def scaled_imu(self, frame: Frame) -> Measurements:
        """Read SCALED_IMU, SCALED_IMU2 or SCALED_IMU3."""
        m = unpack(frame)
        out, t_ns = self._door.follow_ms(m.time_boot_ms, "SCALED_IMU")
        if t_ns is None:
            return out
        if t_ns == 0:
            return self._door.refuse("SCALED_IMU: no time")
        self._add_integers(out, self._ranks[frame.message_id], t_ns // 1000, m)
        return out

    def _add_integers(self, out: Measurements, rank: int, t_us: int, m: Any) -> None:
        """Add what RAW_IMU and SCALED_IMU share: milli-g, mrad/s and milligauss."""
        xacc, yacc, zacc, xgyro, ygyro, zgyro, xmag, ymag, zmag = m[1:10]
        t_ns = t_us * 1000
        if not (xacc or yacc or zacc or xgyro or ygyro or zgyro):
            self._door.refuse("SCALED_IMU: no sensor behind it")
        else:
            rates = (xgyro * 1e-3, ygyro * 1e-3, zgyro * 1e-3)
            t_ns = self._add(
                out, rank, t_us, *rates, xacc * _MILLI_G, yacc * _MILLI_G, zacc * _MILLI_G
            )
        self._mag.add(out, rank, t_ns, xmag * 1e-3, ymag * 1e-3, zmag * 1e-3)

    def _add(
        self,
        out: Measurements,
        rank: int,
        t_us: int,
        gx: float,
        gy: float,
        gz: float,
        ax: float,
        ay: float,
        az: float,
    ) -> int:
        """Add a sample, where it is one; give the time, ns, of all that came with it."""
        door = self._door
        t_ns = t_us * 1000
        was = self.sources.rank
        if not math.isfinite(gx + gy + gz + ax + ay + az):
            door.refuse("IMU: not a number")
        elif not self.sources.admit(rank, t_ns):
            door.refuse("IMU: a better source speaks")
        elif t_us == self._last_us:
            door.refuse("IMU: stamp repeated")
        else:
            if rank != was:
                self._note_source(was, rank)
            self._last_us = t_us
            if self._dejitter is not None:
                sampled = self._dejitter.smooth(t_us)
                if sampled is None:
                    door.refuse("IMU: out of order")
                    return t_ns
                t_ns = sampled
            out.append(
                ImuSample(
                    t_ns=t_ns,
                    gyro_x=gx,
                    gyro_y=gy,
                    gyro_z=gz,
                    accel_x=ax,
                    accel_y=ay,
                    accel_z=az,
                )
            )
        return t_ns

    def _note_source(self, was: int, now: int) -> None:
        self.begin_stream()
        away = f"is used: {SOURCES[was]} has been silent, or much slower, for 3 s"
        why = "speaks steadily" if now < was else away
        self._door.tell(f"{SOURCES[now]} {why}")
