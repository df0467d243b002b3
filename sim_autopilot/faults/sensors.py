"""Faults of the sensors: cycles in, cycles out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from ekf_companion.nav.earth import radii
from sim_autopilot.faults.fault import Fault, Layer, of_layer
from sim_autopilot.flight import Cycle, Fix, Vector
from sim_autopilot.sensors import pressure

_NAN: Vector = (math.nan, math.nan, math.nan)


class SensorFaults:
    """All of a flight; keeps the last good sample."""

    def __init__(self, faults: Sequence[Fault], zero_ns: int) -> None:
        """Read the faults of a flight that starts at ``zero_ns`` of the world's clock."""
        self._faults = [fault for _, fault in of_layer(faults, Layer.SENSOR)]
        self._zero_ns = zero_ns
        self._good: Cycle | None = None
        self._good_fix: Fix | None = None
        self._acts: dict[str, Callable[[Fault, Cycle, float], Cycle]] = {
            "gnss-outage": _outage,
            "gnss-jump": _jump,
            "gnss-drag": _drag,
            "gnss-frozen": self._frozen,
            "imu-saturation": _saturation,
            "imu-stuck": self._stuck,
            "imu-nan": lambda fault, cycle, t: cycle._replace(gyro_b=_NAN, accel_b=_NAN),
            "imu-gap": lambda fault, cycle, t: cycle._replace(has_imu=False),
            "mag-disturbance": _disturbance,
            "baro-step": _step,
        }

    def apply(self, cycle: Cycle) -> Cycle:
        """Return the cycle with the faults that act now."""
        t = (cycle.flight_ns - self._zero_ns) * 1e-9
        acting = [fault for fault in self._faults if fault.start <= t < fault.end]
        right = cycle
        for fault in acting:
            cycle = self._acts[fault.kind.name](fault, cycle, t - fault.start)
        names = {fault.kind.name for fault in acting}
        if self._good is None or "imu-stuck" not in names:
            self._good = right
        if right.fix is not None and (self._good_fix is None or "gnss-frozen" not in names):
            self._good_fix = right.fix
        return cycle

    def _stuck(self, fault: Fault, cycle: Cycle, t: float) -> Cycle:
        right = self._good or cycle
        return cycle._replace(gyro_b=right.gyro_b, accel_b=right.accel_b)

    def _frozen(self, fault: Fault, cycle: Cycle, t: float) -> Cycle:
        if cycle.fix is None or self._good_fix is None:
            return cycle
        frozen = self._good_fix
        if fault.values["time"] == "advancing":
            frozen = frozen._replace(t_ns=cycle.fix.t_ns)
        return cycle._replace(fix=frozen)


def _outage(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.fix is None or fault.values["how"] == "silent":
        return cycle._replace(fix=None)
    return cycle._replace(fix=cycle.fix._replace(fix_type=0))


def _jump(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.fix is None:
        return cycle
    north, east, down = (fault.number(key) for key in ("north", "east", "down"))
    return cycle._replace(fix=_moved(cycle.fix, north, east, down))


def _drag(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.fix is None:
        return cycle
    speed, course = fault.number("speed"), math.radians(fault.number("course"))
    north, east = speed * math.cos(course), speed * math.sin(course)
    fix = _moved(cycle.fix, north * t, east * t, 0.0)
    vel_north, vel_east, vel_down = fix.vel_n
    return cycle._replace(fix=fix._replace(vel_n=(vel_north + north, vel_east + east, vel_down)))


def _saturation(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    return cycle._replace(
        gyro_b=_clipped(cycle.gyro_b, fault.number("gyro")),
        accel_b=_clipped(cycle.accel_b, fault.number("accel")),
    )


def _disturbance(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.mag_b is None:
        return cycle
    x, y, z = cycle.mag_b
    added = [fault.number(key) for key in ("forward", "right", "down")]
    return cycle._replace(mag_b=(x + added[0], y + added[1], z + added[2]))


def _step(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.baro is None:
        return cycle
    alt = cycle.baro[1] + fault.number("height")
    return cycle._replace(baro=(pressure(alt), alt))


def _moved(fix: Fix, north: float, east: float, down: float) -> Fix:
    meridian, transverse = radii(fix.lat)
    return fix._replace(
        lat=fix.lat + north / (float(meridian) + fix.alt),
        lon=fix.lon + east / ((float(transverse) + fix.alt) * math.cos(fix.lat)),
        alt=fix.alt - down,
    )


def _clipped(vector: Vector, limit: float) -> Vector:
    x, y, z = (max(-limit, min(limit, value)) for value in vector)
    return x, y, z
