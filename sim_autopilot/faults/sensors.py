"""Faults of the sensors: cycles in, cycles out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import radii
from sim_autopilot.faults.fault import Fault, Layer
from sim_autopilot.flight import Cycle, Fix, Flow, Vector
from sim_autopilot.sensors import pressure

_NAN: Vector = (math.nan, math.nan, math.nan)
OnCycle = Callable[[Fault, Cycle, float], Cycle]
"""Changes a cycle by a fault that has lasted for some time, s."""


class SensorFaults:
    """All of a flight; keeps the last good sample."""

    def __init__(self, faults: Sequence[Fault], zero_ns: int) -> None:
        """Read the faults of a flight that starts at ``zero_ns`` of the world's clock."""
        self._faults = [fault for fault in faults if fault.kind.layer is Layer.SENSOR]
        self._zero_ns = zero_ns
        self._good: Cycle | None = None
        self._good_fix: Fix | None = None
        self._begin: dict[int, Cycle] = {}
        """At the begin of each fault, by its number."""
        self._past: dict[int, deque[Cycle]] = {
            number: deque()
            for number, fault in enumerate(self._faults)
            if fault.kind.name.endswith("-late")
        }
        """What is still to come late, likewise."""
        self._good_flow: Flow | None = None
        self._on_fix: dict[str, Callable[[Fault, Fix, float], Fix | None]] = {
            "gnss-outage": _outage,
            "gnss-jump": _jump,
            "gnss-drag": _drag,
            "gnss-frozen": self._frozen,
        }
        self._on_cycle: dict[str, OnCycle] = {
            "imu-saturation": _saturation,
            "imu-stuck": self._stuck,
            "imu-nan": lambda fault, cycle, t: cycle._replace(gyro_b=_NAN, accel_b=_NAN),
            "imu-gap": lambda fault, cycle, t: cycle._replace(has_imu=False),
            "mag-disturbance": _disturbance,
            "baro-step": _step,
            "range-bounce": _bounce,
            "range-step": _on("range_m", lambda fault, read, t: read + fault.number("by")),
            "range-drift": _on("range_m", _drift),
            "range-scale": _on("range_m", _scale),
            "range-frozen": self._held("range_m"),
            "range-late": self._late("range_m"),
            "pitot-blocked": self._blocked,
            "pitot-frozen": self._held("airspeed"),
            "pitot-scale": _on("airspeed", _scale),
            "pitot-drift": _on("airspeed", _drift),
            "pitot-late": self._late("airspeed"),
            "wheel-slip": _on("wheel_m", _drift),
            "wheel-frozen": self._held("wheel_m"),
            "wheel-scale": self._wheel_scale,
            "wheel-late": self._late("wheel_m"),
            "flow-frozen": self._flow_frozen,
            "flow-blind": _blind,
            "flow-scale": _flow_scale,
            "flow-drift": _flow_drift,
            "flow-turned": _flow_turned,
            "flow-late": self._flow_late,
            "flow-jitter": _flow_jitter,
            "mounting": _mounting,
            "own-estimate": _own_estimate,
            "accel-drift": _accel_drift,
            "imu-step": _imu_step,
            "imu-noise": _imu_noise,
        }

    def apply(self, cycle: Cycle) -> Cycle:
        """Return the cycle with the faults that act now."""
        t = (cycle.flight_ns - self._zero_ns) * 1e-9
        for number, past in self._past.items():
            past.append(cycle)
            self._before(self._faults[number], cycle)
        acting = [fault for fault in self._faults if fault.start <= t < fault.end]
        right = cycle
        for fault in acting:
            if (act := self._on_cycle.get(fault.kind.name)) is not None:
                cycle = act(fault, cycle, t - fault.start)
            elif cycle.fix is not None:
                fix = self._on_fix[fault.kind.name](fault, cycle.fix, t - fault.start)
                cycle = cycle._replace(fix=fix)
        names = {fault.kind.name for fault in acting}
        if self._good is None or "imu-stuck" not in names:
            self._good = right
        if right.flow is not None and (self._good_flow is None or "flow-frozen" not in names):
            self._good_flow = right.flow
        if right.fix is not None and (self._good_fix is None or "gnss-frozen" not in names):
            self._good_fix = right.fix
        return cycle

    def _stuck(self, fault: Fault, cycle: Cycle, t: float) -> Cycle:
        right = self._good or cycle
        return cycle._replace(gyro_b=right.gyro_b, accel_b=right.accel_b)

    def _frozen(self, fault: Fault, fix: Fix, t: float) -> Fix:
        frozen = self._good_fix or fix
        return frozen._replace(t_ns=fix.t_ns) if fault.values["time"] == "advancing" else frozen

    def _flow_frozen(self, fault: Fault, cycle: Cycle, t: float) -> Cycle:
        if cycle.flow is None:
            return cycle
        frozen = self._good_flow or cycle.flow
        return cycle._replace(flow=frozen._replace(t_ns=cycle.flow.t_ns))

    def _first(self, fault: Fault, cycle: Cycle) -> Cycle:
        """Return the first cycle of a fault."""
        return self._begin.setdefault(self._faults.index(fault), cycle)

    def _held(self, name: str) -> OnCycle:
        """Return a fault that repeats its first reading of a field."""

        def act(fault: Fault, cycle: Cycle, t: float) -> Cycle:
            return cycle._replace(**{name: getattr(self._first(fault, cycle), name)})

        return act

    def _before(self, fault: Fault, cycle: Cycle) -> Cycle:
        """Return the cycle that is as old as what comes late now."""
        past = self._past[self._faults.index(fault)]
        then_ns = cycle.flight_ns - round(fault.number("delay") * 1e9)
        while len(past) > 1 and past[1].flight_ns <= then_ns:
            past.popleft()
        return past[0]

    def _late(self, name: str) -> OnCycle:
        """Return a fault that brings the readings of a field late."""

        def act(fault: Fault, cycle: Cycle, t: float) -> Cycle:
            return cycle._replace(**{name: getattr(self._before(fault, cycle), name)})

        return act

    def _flow_late(self, fault: Fault, cycle: Cycle, t: float) -> Cycle:
        flow = self._before(fault, cycle).flow
        if flow is not None:
            flow = flow._replace(t_ns=flow.t_ns + round(fault.number("delay") * 1e9))
        return cycle._replace(flow=flow)

    def _blocked(self, fault: Fault, cycle: Cycle, t: float) -> Cycle:
        """Read by the pressure that is shut up in the tube: it grows as the vehicle climbs."""
        first = self._first(fault, cycle)
        if first.airspeed is None:
            return cycle
        trapped = 0.5 * 1.225 * first.airspeed * abs(first.airspeed)
        trapped += 100.0 * (pressure(first.truth.alt) - pressure(cycle.truth.alt))
        read = math.copysign(math.sqrt(abs(trapped) / (0.5 * 1.225)), trapped)
        noise = 0.05 * np.random.default_rng(cycle.number).standard_normal()
        return cycle._replace(airspeed=read + float(noise))

    def _wheel_scale(self, fault: Fault, cycle: Cycle, t: float) -> Cycle:
        """Turn the wheels further than the vehicle moves, from the begin on."""
        begin = self._first(fault, cycle).wheel_m
        if begin is None or cycle.wheel_m is None:
            return cycle
        way = fault.number("factor") * (cycle.wheel_m - begin)
        return cycle._replace(wheel_m=begin + way)


def _on(name: str, change: Callable[[Fault, float, float], float]) -> OnCycle:
    """Return a fault that changes each reading of a field, given the time since its begin, s."""

    def act(fault: Fault, cycle: Cycle, t: float) -> Cycle:
        read = getattr(cycle, name)
        if read is None:
            return cycle
        changed: dict[str, Any] = {name: change(fault, read, t)}
        return cycle._replace(**changed)

    return act


def _scale(fault: Fault, read: float, t: float) -> float:
    return fault.number("factor") * read


def _drift(fault: Fault, read: float, t: float) -> float:
    return read + fault.number("speed") * t


def _outage(fault: Fault, fix: Fix, t: float) -> Fix | None:
    return None if fault.values["how"] == "silent" else fix._replace(fix_type=0)


def _jump(fault: Fault, fix: Fix, t: float) -> Fix:
    return _moved(fix, fault.number("north"), fault.number("east"), fault.number("down"))


def _drag(fault: Fault, fix: Fix, t: float) -> Fix:
    speed, course = fault.number("speed"), math.radians(fault.number("course"))
    north, east = speed * math.cos(course), speed * math.sin(course)
    vel_north, vel_east, vel_down = fix.vel_n
    fix = _moved(fix, north * t, east * t, 0.0)
    return fix._replace(vel_n=(vel_north + north, vel_east + east, vel_down))


def _saturation(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    return cycle._replace(
        gyro_b=_clipped(cycle.gyro_b, fault.number("gyro")),
        accel_b=_clipped(cycle.accel_b, fault.number("accel")),
    )


def _disturbance(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.mag_b is None:
        return cycle
    added = fault.number("forward"), fault.number("right"), fault.number("down")
    spares = cycle.spare_mag_b
    if fault.values["compass"] == "all":
        spares = tuple(_sum(one, added) for one in spares)
    return cycle._replace(mag_b=_sum(cycle.mag_b, added), spare_mag_b=spares)


def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _step(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.baro is None:
        return cycle
    alt = cycle.baro[1] + fault.number("height")
    return cycle._replace(baro=(pressure(alt), alt))


def _bounce(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if cycle.range_m is None:
        return cycle
    found = np.random.default_rng(cycle.number).uniform(
        fault.number("lowest"), fault.number("highest")
    )
    return cycle._replace(range_m=float(found))


def _blind(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if (flow := cycle.flow) is None:
        return cycle
    if fault.values["how"] == "dark":
        return cycle._replace(flow=flow._replace(rate=(0.0, 0.0), quality=0.0))
    return cycle._replace(flow=flow._replace(rate=(0.0, 0.0)))


def _flow_scale(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if (flow := cycle.flow) is None:
        return cycle
    x, y = (fault.number("by") * one for one in flow.rate)
    return cycle._replace(flow=flow._replace(rate=(x, y)))


def _flow_drift(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if (flow := cycle.flow) is None:
        return cycle
    x, y = flow.rate
    return cycle._replace(flow=flow._replace(rate=(x + fault.number("x"), y + fault.number("y"))))


def _flow_turned(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if (flow := cycle.flow) is None:
        return cycle
    angle = math.radians(fault.number("yaw"))
    c, s = math.cos(angle), math.sin(angle)
    rate, gyro = ((c * x + s * y, c * y - s * x) for x, y in (flow.rate, flow.gyro))
    return cycle._replace(flow=flow._replace(rate=rate, gyro=gyro))


def _flow_jitter(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    if (flow := cycle.flow) is None:
        return cycle
    off = fault.number("std") * np.random.default_rng(cycle.number).standard_normal()
    return cycle._replace(flow=flow._replace(t_ns=flow.t_ns + round(off * 1e6) * 1000))


def _mounting(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    """Turn all that the board measures, and what the autopilot makes of it."""
    angles = (math.radians(fault.number(key)) for key in ("roll", "pitch", "yaw"))
    q_vb = so3.from_euler(*angles)
    estimate = cycle.estimate
    q_nb = so3.multiply(np.array(estimate.q_nb), q_vb)
    return cycle._replace(
        gyro_b=_turned(q_vb, cycle.gyro_b),
        accel_b=_turned(q_vb, cycle.accel_b),
        mag_b=None if cycle.mag_b is None else _turned(q_vb, cycle.mag_b),
        estimate=estimate._replace(
            q_nb=tuple(q_nb.tolist()),
            euler=tuple(so3.to_euler(q_nb).tolist()),
            rate_b=_turned(q_vb, estimate.rate_b),
            accel_b=_turned(q_vb, estimate.accel_b),
        ),
    )


def _turned(q_vb: Array, vector: Vector) -> Vector:
    """Return a vector of the vehicle in the axes of the board."""
    x, y, z = so3.rotate(so3.conjugate(q_vb), np.array(vector)).tolist()
    return x, y, z


def _own_estimate(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    own = cycle.estimate
    north, east, down = (fault.number(key) for key in ("north", "east", "down"))
    roll, pitch, yaw = own.euler
    euler = (roll, pitch, float(so3.wrap(yaw + math.radians(fault.number("heading")))))
    meridian, transverse = radii(own.lat)
    moved = own._replace(
        lat=own.lat + north / (float(meridian) + own.alt),
        lon=own.lon + east / ((float(transverse) + own.alt) * math.cos(own.lat)),
        alt=own.alt - down,
        pos_n=(own.pos_n[0] + north, own.pos_n[1] + east, own.pos_n[2] + down),
        euler=euler,
        q_nb=tuple(so3.from_euler(*euler).tolist()),
    )
    return cycle._replace(estimate=moved)


def _accel_drift(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    x, y, z = cycle.accel_b
    return cycle._replace(
        accel_b=(x + fault.number("forward") * t, y + fault.number("right") * t, z)
    )


def _imu_step(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    (x, y, z), (p, q, r) = cycle.accel_b, cycle.gyro_b
    return cycle._replace(
        accel_b=(x + fault.number("forward"), y, z + fault.number("down")),
        gyro_b=(p, q, r + fault.number("yaw")),
    )


def _imu_noise(fault: Fault, cycle: Cycle, t: float) -> Cycle:
    drawn = np.random.default_rng(cycle.number).standard_normal((2, 3))
    gyro = np.array(cycle.gyro_b) + fault.number("gyro") * drawn[0]
    accel = np.array(cycle.accel_b) + fault.number("accel") * drawn[1]
    return cycle._replace(gyro_b=tuple(gyro.tolist()), accel_b=tuple(accel.tolist()))


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
