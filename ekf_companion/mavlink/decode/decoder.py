"""One autopilot's frames to measurements: each frame goes to the reader of its message."""

from __future__ import annotations

from collections.abc import Callable

from ekf_companion.mavlink.decode import aids
from ekf_companion.mavlink.decode.air import Barometer, Magnetometer
from ekf_companion.mavlink.decode.context import Context, DecoderOptions, Family, Measurements
from ekf_companion.mavlink.decode.external import External
from ekf_companion.mavlink.decode.fix import Fixes
from ekf_companion.mavlink.decode.heading import Heading
from ekf_companion.mavlink.decode.inertial import SOURCES, Inertial
from ekf_companion.mavlink.decode.position import Position
from ekf_companion.mavlink.decode.receiver import Receiver
from ekf_companion.mavlink.decode.state import DecoderState
from ekf_companion.mavlink.decode.trim import Trim
from ekf_companion.mavlink.decode.vehicle import Vehicle
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.past_frames import PastFrames
from ekf_companion.mavlink.timebase import Step, TimeBase
from ekf_companion.nav.measurements import ImuSample, Measurement, Restart

HELD = 1024
"""Frames that wait until it is known what the clock did, at most; fewer come in that time."""


class Decoder(DecoderState):
    """Decodes one autopilot's frames to measurements."""

    def __init__(
        self, family: Family = Family.UNKNOWN, options: DecoderOptions | None = None
    ) -> None:
        self.context = Context(family, options or DecoderOptions(), self._forget)
        self.refused = self.context.refused
        """How often, by reason: ``message: why``."""
        self.notes = self.context.notes
        """Sentences for a human, oldest first, a few at most; whoever reads them takes them out."""
        self.trim = Trim(self.context)
        self.mag, self.baro = Magnetometer(self.context, self.trim), Barometer(self.context)
        self.heading, self.vehicle = Heading(self.context), Vehicle(self.context)
        self.inertial = Inertial(self.context, self.mag, self.baro, self.trim)
        self._ranked: list[Inertial | Magnetometer | Barometer | Heading]
        self._ranked = [self.inertial, self.mag, self.baro, self.heading]
        self.fixes = Fixes(self.context)
        self.position = Position(self.context, self.heading, self.fixes)
        self._receiver = Receiver(self.context, self.vehicle)
        self.external = External(self.context)
        self._aids = [reader(self.context) for reader in aids.READERS]
        self._airspeed = next(one for one in self._aids if isinstance(one, aids.Airspeed))
        readers: dict[str, Callable[[Frame], Measurements]] = {
            "HIGHRES_IMU": self.inertial.highres_imu,
            "RAW_IMU": self.inertial.raw_imu,
            "SCALED_IMU": self.inertial.scaled_imu,
            "SCALED_IMU2": self.inertial.scaled_imu,
            "SCALED_IMU3": self.inertial.scaled_imu,
            "SCALED_PRESSURE": self.baro.scaled_pressure,
            "GPS_RAW_INT": self.fixes.gps_raw_int,
            "GPS2_RAW": self.fixes.gps2_raw,
            "GLOBAL_POSITION_INT": self.position.global_position_int,
            "ATTITUDE": self.heading.attitude,
            "VFR_HUD": self._vfr_hud,
            "SYS_STATUS": self._airspeed.sys_status,
            "HEARTBEAT": self.vehicle.heartbeat,
            "EXTENDED_SYS_STATE": self.vehicle.extended_sys_state,
            "SYSTEM_TIME": self.vehicle.system_time,
            "PARAM_VALUE": self._param_value,
            **{reader.message: reader.read for reader in self._aids},
        }
        self.readers = {IDS[name]: reader for name, reader in readers.items()}
        self.held: list[tuple[Frame, Measurements]] = []
        self._is_confirmed = False
        """Whether the clock goes on, of which the frames that are held are behind."""

    def _forget(self, step: Step) -> None:
        """Begin anew after a reboot; the clock has already taken the new time.

        Where the clock was only set, the sources in use are still the best that speak.
        """
        ranks, unit, offset = self.ranks, self.inertial.unit, self.inertial.lanes.offset
        for reader in (
            *self._ranked,
            self.fixes,
            self.position,
            self.trim,
            self.external,
            *self._aids,
        ):
            reader.forget()
        if step is Step.BEGUN:
            self.vehicle.forget()
        else:
            self.prefer(*ranks)
            self.inertial.resume(unit, offset)

    def begin(self) -> None:
        """Begin anew with another autopilot, of whose clock nothing is known."""
        self.context.clock = TimeBase()
        self.held.clear()
        self._receiver.forget()
        self._forget(Step.BEGUN)

    @property
    def missing(self) -> tuple[str, ...]:
        """Parameters of the autopilot that the decoder wants to know and has not been told."""
        return (*self.trim.missing, *self._receiver.missing)

    def _param_value(self, frame: Frame) -> Measurements:
        return [*self.trim.param_value(frame), *self._receiver.param_value(frame)]

    def _vfr_hud(self, frame: Frame) -> Measurements:
        return [*self.heading.vfr_hud(frame), *self._airspeed.vfr_hud(frame)]

    def refuse_ours(self, is_ours: bool, is_yaw_ours: bool) -> None:
        """Refuse the autopilot's own position, or its yaw, while our ODOMETRY is fused in it."""
        self.context.is_ours, self.context.is_yaw_ours = is_ours, is_yaw_ours

    @property
    def is_ours(self) -> bool:
        """Whether the autopilot's own position is made of our ODOMETRY."""
        return self.context.is_ours

    @property
    def is_yaw_ours(self) -> bool:
        """Whether the autopilot's own yaw is made of our ODOMETRY."""
        return self.context.is_yaw_ours

    @property
    def family(self) -> Family:
        """Whose habits apply: the autopilot's."""
        return self.context.family

    @family.setter
    def family(self, family: Family) -> None:
        if family is not self.context.family:
            self.context.family = family
            self.inertial.begin_stream()

    @property
    def clock(self) -> TimeBase:
        """The autopilot's clock."""
        return self.context.clock

    @property
    def imu_source(self) -> str:
        """The message that inertial samples are taken from."""
        return SOURCES[self.inertial.sources.rank]

    @property
    def airspeed_source(self) -> str:
        """The message that airspeeds are taken from."""
        return self._airspeed.source

    @property
    def ranks(self) -> tuple[int, ...]:
        """Ranks of the sources in use: inertial, magnetometer, barometer, heading."""
        return tuple(reader.sources.rank for reader in self._ranked)

    def prefer(self, *ranks: int) -> None:
        """Use the sources of these ranks at once: better ones are known to be silent."""
        for reader, rank in zip(self._ranked, ranks, strict=True):
            if reader is self.mag:
                self.mag.prefer(rank)
            else:
                reader.sources.use(rank)
        self.inertial.begin_stream()

    def pass_again(self, past: PastFrames) -> None:
        """Take into account that a frame came again: the clock goes on as it did."""
        self.confirm()
        if past.is_second_path and not past.is_named:
            past.is_named = True
            self.notes.append(
                "The autopilot's messages come by two paths, on one of them "
                f"{past.lag_us * 1e-6:.2f} s later: each counts once; look for a second link or a "
                "router that leads here"
            )

    def confirm(self) -> None:
        """Take into account that the clock goes on as it did: what is behind is late."""
        self.context.clock.confirm()
        self._is_confirmed = True

    def decode(self, frame: Frame, now_ns: int | None = None) -> Measurements:
        """Return the measurements of a frame: none, one or several.

        ``now_ns`` is when it arrived; None: not known, its stamp alone decides.

        A frame whose stamp is behind the newest waits until it is known why. If it was late, its
        measurements come with those of the next frame that is not; if the clock was set back, it is
        read again by the new clock.
        """
        self.context.clock.now_us = None if now_ns is None else now_ns // 1000
        out = self.readers.get(frame.message_id, _skip)(frame)
        if out and type(out[0]) is Restart:
            held, self.held = self.held, []
            if out[0].goes_on:
                frames = [*(one for one, _ in held), frame]
                again = (self.readers.get(one.message_id, _skip)(one) for one in frames)
                return [out[0], *(found for measurements in again for found in measurements)]
            return out
        if self.context.clock.is_behind and len(self.held) < HELD:
            self._is_confirmed = self._is_confirmed and bool(self.held)
            self.held.append((frame, out))
            return []
        return [*self.free(), *out] if self.held else out

    def free(self) -> Measurements:
        """Return the measurements of the frames that waited, which were late."""
        held, self.held = self.held, []
        late = [found for _, measurements in held for found in measurements]
        return list(map(_late, late)) if self._is_confirmed else late


def _late(measurement: Measurement) -> Measurement:
    """Return a measurement as one that is late for certain."""
    return measurement._replace(is_late=1.0) if isinstance(measurement, ImuSample) else measurement


def _skip(frame: Frame) -> Measurements:
    """Return no measurements: of a message that holds none."""
    return []
