"""Magnetometer and barometer, whichever message carries them."""

from __future__ import annotations

import math

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.compass import Compasses
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.decode.preference import Preference
from ekf_companion.mavlink.decode.state import FieldState, PressureState
from ekf_companion.mavlink.decode.trim import Trim
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.earth import PRESSURES, pressure_altitude
from ekf_companion.nav.matrix3 import Vector3
from ekf_companion.nav.measurements import BaroSample, MagSample

PRESSURE_SOURCES = ("HIGHRES_IMU", "SCALED_PRESSURE")
"""Messages that carry a pressure, by rank; those with a field are those of the inertial samples."""
WEAKEST, STRONGEST = 0.15, 0.8
"""gauss; the Earth's field has 0.22 to 0.67, and a vehicle adds some."""
_STRANGE = 100
"""Fields in a row that are not the Earth's, before a human is told."""
FIRST_OTHER = 3
"""Rank of the message from which on each has a compass of its own: SCALED_IMU2, SCALED_IMU3."""
LOWEST, HIGHEST = PRESSURES


class Magnetometer(FieldState):
    """Reads the magnetic field from the best message that carries one."""

    def __init__(self, context: Context, trim: Trim) -> None:
        self._context, self._trim = context, trim
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.sources = Preference()
        self.last: tuple[float, ...] = ()
        self.strange = 0
        self.compasses = Compasses()
        self._first: tuple[float, ...] = ()

    def prefer(self, rank: int) -> None:
        """Use the source of this rank at once; one that has another compass was chosen for it."""
        self.sources.use(rank)
        self.compasses.used = _compass(rank)

    def compare(self, rank: int, t_ns: int, field: Vector3, rate_b: Vector3 | None) -> None:
        """Compare the field of another compass (gauss), and go to it where the first is wrong."""
        if field == (0.0, 0.0, 0.0):
            return
        first = self.last if self.sources.rank < FIRST_OTHER else self._first
        was = self.compasses.used
        now = self.compasses.compare(
            _compass(rank), t_ns, field, _in_gauss(first) if len(first) == 3 else None, rate_b
        )
        if now != was:
            self._use(now, "its field jumps, and neither the gyro nor the others do")

    def _use(self, compass: int, why: str) -> None:
        was = self.compasses.used
        if not was:
            self._first = self.last
        self.compasses.use(compass)
        self.sources.use(compass + FIRST_OTHER - 1 if compass else 0)
        self._context.refused["mag: compass changed"] += 1
        self._context.notes.append(f"Compass {compass + 1} is used instead of {was + 1}: {why}")

    def _is_used(self, rank: int, t_ns: int) -> bool:
        """Whether a field is of the compass that is used instead of the first."""
        compass = _compass(rank)
        if compass == self.compasses.used:
            return True
        if not self.compasses.is_silent(t_ns):
            return False
        self._use(compass, "that is silent")
        return True

    def add(self, out: Measurements, rank: int, t_ns: int, x: float, y: float, z: float) -> None:
        """Append a field in gauss if it may be the Earth's and is not the last one again."""
        if (x, y, z) == (0.0, 0.0, 0.0):
            if self.last:  # else there is no magnetometer
                self._context.refused["mag: of zeros"] += 1
            return
        if self.compasses.used:
            if rank < FIRST_OTHER:
                self._first = (x, y, z)
            if not self._is_used(rank, t_ns):
                return
        elif rank != self.sources.sole and not self.sources.admit(rank, t_ns):
            return
        if (x, y, z) == self.last:
            return
        self.last = (x, y, z)
        norm = math.sqrt(x * x + y * y + z * z)
        if 1e6 * WEAKEST <= norm <= 1e6 * STRONGEST:
            # ArduPilot before #32286
            self._context.refused["mag: unit corrected by 1e6"] += 1
            self._context.note_once(
                "HIGHRES_IMU brings the magnetic field a million times too large, as ArduPilot "
                "did before 4.7; it is taken in the unit that is meant"
            )
            x, y, z, norm = x * 1e-6, y * 1e-6, z * 1e-6, norm * 1e-6
        if not WEAKEST <= norm <= STRONGEST:
            self._context.refuse("mag: no field of the Earth")
            self.strange += 1
            if self.strange == _STRANGE:
                self._context.note_once(
                    f"The magnetometer measures {norm:.3g} gauss, and the Earth's field has 0.22 "
                    "to 0.67: it is not used; check its unit, its calibration, and what is near it"
                )
            return
        self.strange = 0
        if self.compasses.used:
            x, y, z = self.compasses.as_first((x, y, z))
        x, y, z = self._trim.to_vehicle(x, y, z)
        out.append(MagSample(t_ns=t_ns, mag_x=x, mag_y=y, mag_z=z, compass=_compass(rank)))


def _compass(rank: int) -> int:
    """Return which compass a message carries, by its rank; 0: the first."""
    return max(rank - FIRST_OTHER + 1, 0)


def _in_gauss(field: tuple[float, ...]) -> Vector3:
    """Return a field in gauss, as ArduPilot before #32286 means it too."""
    x, y, z = field
    scale = 1e-6 if math.hypot(x, y, z) > 1e6 * WEAKEST else 1.0
    return x * scale, y * scale, z * scale


class Barometer(PressureState):
    """Reads the pressure from the best message that carries one."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.sources = Preference()
        self.last = 0.0

    def scaled_pressure(self, frame: Frame) -> Measurements:
        """Read SCALED_PRESSURE."""
        m = unpack(frame)
        out, t_ns = self._context.follow_ms(m.time_boot_ms, "SCALED_PRESSURE")
        if t_ns is not None:
            self.add(out, 1, t_ns, m.press_abs)
        return out

    def add(self, out: Measurements, rank: int, t_ns: int, pressure: float) -> None:
        """Append the altitude of a pressure in hPa, or in Pa where only that can be meant (PX4)."""
        if pressure == 0.0 or (rank != self.sources.sole and not self.sources.admit(rank, t_ns)):
            return
        if pressure == self.last:
            return
        self.last = pressure
        if self._context.is_submarine:
            self._context.refuse("baro: pressure within the hull")
            self._context.note_once(
                "This is a submarine: its barometer measures the air within the hull, which is no "
                "height, and is not used"
            )
            return
        is_pascal = LOWEST <= pressure <= HIGHEST
        if not is_pascal:
            pressure *= 100.0
        if not LOWEST <= pressure <= HIGHEST:
            self._context.refuse("baro: no pressure of the air")
            return
        if is_pascal:
            self._context.note_once(
                f"The pressure in {PRESSURE_SOURCES[rank]} comes in Pa, where MAVLink means hPa "
                "(PX4 sends it so); it is read as Pa, and nothing is to be done"
            )
        out.append(BaroSample(t_ns=t_ns, alt=pressure_altitude(pressure)))
