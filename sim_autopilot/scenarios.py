"""The motions that can be flown: a path, and the attitude along it.

All begin with ``REST`` seconds at exact rest, so that a filter can level, on ground that is not
level itself (``SLOPE``). All can have any duration: at its end a motion is repeated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import STANDARD_GRAVITY, LocalFrame
from sim_autopilot.truth import Trajectory, spline

REST = 5.0
"""Rest at the start of every scenario, at least, s."""
SLOPE = np.radians([1.2, -1.7, 0.0])
"""Roll and pitch that are added to every attitude, rad: no vehicle stands or trims level."""
ATTITUDE_STEP = 0.05
"""Between the control points of a flying vehicle's attitude, s."""
MARGIN = 1.0
"""The path continues for so long after the end, s: control points of the attitude look ahead."""


Wind = tuple[float, float]
"""Where the air moves to, north and east, m/s."""
CALM: Wind = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A motion by its name."""

    name: str
    summary: str
    duration: float
    """Of a flight by default, s."""
    is_airborne: bool
    """It arms and takes off, or drives off."""
    is_wing: bool
    """A fixed wing; else a multicopter, or nothing that flies."""
    build: Callable[..., Trajectory]
    """From the frame, whose origin is the start, and the duration, s; of a fixed wing the wind,
    north and east, m/s."""
    is_rolling: bool = False
    """A ground vehicle."""


def _static(frame: LocalFrame, duration: float) -> Trajectory:
    still = spline(lambda t: np.zeros((len(t), 3)), duration, 1.0)
    heading = SLOPE + np.radians([0.0, 0.0, 35.0])
    attitude = spline(lambda t: np.tile(heading, (len(t), 1)), duration, 1.0)
    return Trajectory(frame, duration, still, attitude)


def _hover(frame: LocalFrame, duration: float) -> Trajectory:
    def path(t: Array) -> Array:
        up = _smoothstep((t - 6.0) / 5.0)
        wander = [
            0.30 * np.sin(0.83 * t) + 0.15 * np.sin(1.91 * t),
            0.25 * np.sin(0.67 * t + 1.0) + 0.12 * np.sin(2.17 * t),
            0.15 * np.sin(0.41 * t) - 5.0,
        ]
        return np.stack([up * axis for axis in wander], axis=-1)

    def yaw(t: Array) -> Array:
        return np.asarray(np.radians(20.0 + _smoothstep((t - 8.0) / 4.0) * 6.0 * np.sin(0.31 * t)))

    return _quad(frame, duration, path, yaw)


def _figure_eight(frame: LocalFrame, duration: float) -> Trajectory:
    """Fly eights of 24 m by 12 m, a lap in 11.6 s: 9 m/s in the middle, 40 degrees in the turns."""

    def path(t: Array) -> Array:
        phase = 0.54 * _ramp(t - 9.0, 4.0)
        return np.stack(
            [
                12.0 * np.sin(phase),
                6.0 * np.sin(2.0 * phase),
                -8.0 * _smoothstep((t - 5.3) / 5.0) - 1.5 * (1.0 - np.cos(0.7 * phase)),
            ],
            axis=-1,
        )

    def yaw(t: Array) -> Array:
        phase = _ramp(t - 9.0, 4.0)
        return np.asarray(np.radians(40.0) + 0.12 * phase + 0.7 * np.sin(0.45 * phase))

    return _quad(frame, duration, path, yaw)


def _loiter(frame: LocalFrame, duration: float, wind: Wind = CALM) -> Trajectory:
    """Circle at 16 m/s, radius 80 m, after a take-off to the north; climb to 100 m and undulate."""
    speed, radius, run = 16.0, 80.0, 200.0
    step = 2.0

    def path(t: Array) -> Array:
        s = speed * np.maximum(t - REST - 3.0 * step, 0.0)
        angle = np.maximum(s - run, 0.0) / radius
        climb = np.maximum(s - 80.0, 0.0)
        height = 100.0 * (1.0 - np.exp(-climb / 900.0)) + 15.0 * (1.0 - np.cos(climb / 700.0))
        return np.stack(
            [np.minimum(s, run) + radius * np.sin(angle), radius * (1.0 - np.cos(angle)), -height],
            axis=-1,
        )

    return _wing(frame, duration, path, step, wind)


_ROUTE = np.array(
    [
        (0.0, 0.0, 0.0, 16.0),
        (-160.0, -27.0, 0.0, 18.0),
        (-560.0, -93.0, 110.0, 16.0),
        (-900.0, -150.0, 110.0, 18.5),
        (-770.0, -1020.0, 110.0, 15.0),
        (-640.0, -1090.0, 160.0, 18.0),
        (-300.0, -1020.0, 160.0, 18.0),
        (150.0, -900.0, 160.0, 18.2),
        (30.0, -500.0, 160.0, 24.0),
        (-30.0, -70.0, 160.0, 19.5),
        (-400.0, -180.0, 160.0, 16.5),
        (-800.0, -240.0, 160.0, 16.5),
        (-690.0, -930.0, 160.0, 13.2),
        (-480.0, -980.0, 210.0, 15.0),
        (20.0, -860.0, 210.0, 16.2),
        (-60.0, -560.0, 210.0, 20.9),
        (-110.0, -240.0, 210.0, 18.5),
        (-540.0, -310.0, 210.0, 14.6),
        (-760.0, -345.0, 170.0, 16.0),
        (-720.0, -600.0, 130.0, 16.0),
        (-480.0, -560.0, 110.0, 16.0),
        (-440.0, -200.0, 110.0, 16.0),
        (-560.0, -93.0, 110.0, 16.0),
    ]
)
"""North, east, height, m; speed there, m/s."""
_LAP_START = 2
"""The route begins again at this waypoint, which is also its last."""


def _square_spiral(frame: LocalFrame, duration: float, wind: Wind = CALM) -> Trajectory:
    """Fly two rounds of a shrinking square through waypoints, like the seed article's fixed wing.

    A spline of control points every 80 m rounds the corners; the speed is set along its length.
    """
    spacing, step = 80.0, 1.5
    legs = np.linalg.norm(np.diff(_ROUTE[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(legs)])

    def polygon(s: Array) -> Array:
        return np.stack([np.interp(s, along, column) for column in _ROUTE.T], axis=-1)

    lead = 3.0 * spacing
    curve = spline(lambda s: polygon(s - lead), lead + along[-1], spacing)
    s = np.linspace(0.0, lead + along[-1], 20000)
    points = np.asarray(curve(s))
    arc = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1)
    when = np.concatenate([[0.0], np.cumsum(arc / points[1:, 3])]) + REST + 3.5 * step
    lap_start, end = np.interp(lead + along[[_LAP_START, -1]], s, when)

    def path(t: Array) -> Array:
        t = np.where(t < end, t, lap_start + np.mod(t - lap_start, end - lap_start))
        return np.asarray(curve(np.interp(t, when, s)))[:, :3] * [1.0, 1.0, -1.0]

    return _wing(frame, duration, path, step, wind)


def _walk(frame: LocalFrame, duration: float) -> Trajectory:
    """Walk in a circle of 24 strides, the sensor on one foot: 0.5 s still, 0.7 s swinging."""
    cycle, swing, strides, length = 1.2, 0.7, 24, 1.4
    radius = strides * length / (2.0 * np.pi)
    step = 0.02

    def gait(t: Array) -> tuple[Array, Array]:
        """Return strides done, and the phase of the foot's swing, 0 to 1."""
        count, within = np.divmod(np.maximum(t - REST - 1.0, 0.0), cycle)
        through = np.clip(within / swing, 0.0, 1.0)
        return count + _smoothstep(through), through

    def path(t: Array) -> Array:
        done, through = gait(t)
        angle = 2.0 * np.pi * done / strides
        lift = 0.12 * (16.0 * (through * (1.0 - through)) ** 2)
        return np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), -lift], axis=-1)

    def attitude(t: Array) -> Array:
        done, through = gait(t)
        # The heel lifts (toes down), then the toes lift before the heel strikes
        flank = 16.0 * (through * (1.0 - through)) ** 2
        pitch = np.radians(-50.0) * flank * np.cos(np.pi * through) - np.radians(8.0) * flank
        roll = np.radians(6.0) * flank
        return np.asarray(SLOPE + np.stack([roll, pitch, 2.0 * np.pi * done / strides], axis=-1))

    return Trajectory(
        frame, duration, spline(path, duration, step), spline(attitude, duration, step)
    )


def _drive(frame: LocalFrame, duration: float) -> Trajectory:
    """Roll along a road that winds, at 3 to 9 m/s, and stop every 40 s."""
    fine = np.arange(0.0, duration + 20.0, 0.02)
    begin = REST + 1.0  # the path is smoothed over some of its points
    stop = _smoothstep(np.abs((fine - begin) % 40.0 - 20.0) / 6.0)
    speed = _smoothstep((fine - begin) / 6.0) * stop * (6.0 + 3.0 * np.sin(0.11 * fine))
    way = np.cumsum(speed) * 0.02
    heading = 0.6 + 1.1 * np.sin(way / 35.0) + way / 70.0
    north, east = (np.cumsum(speed * part) * 0.02 for part in (np.cos(heading), np.sin(heading)))
    height = -1.5 * (1.0 - np.cos(way / 60.0))

    def path(t: Array) -> Array:
        return np.stack([np.interp(t, fine, one) for one in (north, east, height)], axis=-1)

    def attitude(t: Array) -> Array:
        slope = np.arctan(np.interp(t, fine, 1.5 / 60.0 * np.sin(way / 60.0)))
        course = np.interp(t, fine, heading)
        return np.asarray(SLOPE + np.stack([0.0 * t, slope, course], axis=-1))

    position = spline(path, duration + MARGIN, 0.1)
    return Trajectory(frame, duration, position, spline(attitude, duration, ATTITUDE_STEP))


def _quad(
    frame: LocalFrame,
    duration: float,
    path: Callable[[Array], Array],
    yaw: Callable[[Array], Array],
) -> Trajectory:
    """Tilt the thrust along the specific force of the path; the yaw is a function of time."""
    position = spline(path, duration + MARGIN, 0.1)

    def attitude(t: Array) -> Array:
        force = np.asarray(position(np.maximum(t, 0.0), 2))
        force = force - np.array([0.0, 0.0, STANDARD_GRAVITY])
        heading = yaw(t)
        forward = np.cos(heading) * force[:, 0] + np.sin(heading) * force[:, 1]
        right = np.cos(heading) * force[:, 1] - np.sin(heading) * force[:, 0]
        roll = np.arcsin(right / np.linalg.norm(force, axis=1))
        pitch = np.arctan2(-forward, -force[:, 2])
        return np.asarray(SLOPE + np.stack([roll, pitch, heading], axis=-1))

    return Trajectory(frame, duration, position, spline(attitude, duration, ATTITUDE_STEP))


def _wing(
    frame: LocalFrame,
    duration: float,
    path: Callable[[Array], Array],
    step: float,
    wind: Wind = CALM,
) -> Trajectory:
    """Point 3 degrees above the path through the air, and bank as in a coordinated turn."""
    position = spline(path, duration + MARGIN, step)

    def attitude(t: Array) -> Array:
        t = np.maximum(t, 0.0)
        velocity, accel = np.asarray(position(t, 1)), np.asarray(position(t, 2))
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        if wind != CALM:  # on the wheels it points where it rolls to
            velocity = velocity - _smoothstep(speed / 12.0)[:, None] * np.array([*wind, 0.0])
            speed = np.hypot(velocity[:, 0], velocity[:, 1])
        # At rest the course is that of the first motion
        is_moving = speed > 0.5
        if not is_moving.any():
            return np.tile(SLOPE, (len(t), 1))
        course = np.unwrap(np.arctan2(velocity[is_moving, 1], velocity[is_moving, 0]))
        course = np.interp(t, t[is_moving], course)
        climb = np.arctan2(-velocity[:, 2], np.maximum(speed, 10.0))
        lateral = np.cos(course) * accel[:, 1] - np.sin(course) * accel[:, 0]
        roll = np.arctan2(lateral, STANDARD_GRAVITY - accel[:, 2])
        incidence = np.radians(3.0) * _smoothstep(speed / 12.0)
        return np.asarray(SLOPE + np.stack([roll, climb + incidence, course], axis=-1))

    return Trajectory(frame, duration, position, spline(attitude, duration, ATTITUDE_STEP))


def _smoothstep(x: Array) -> Array:
    """Go from 0 to 1 with three derivatives zero at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


def _ramp(t: Array, rise: float) -> Array:
    """Return the time of a clock whose rate goes from 0 (at 0) to 1 within ``rise``."""
    x = np.clip(t / rise, 0.0, 1.0)
    integral = x**5 * (7.0 - 14.0 * x + 10.0 * x**2 - 2.5 * x**3)
    return rise * integral + np.maximum(t - rise, 0.0)


SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        Scenario("static", "lies still", 60.0, False, False, _static),
        Scenario("hover", "multicopter: wanders by decimetres, 5 m up", 60.0, True, False, _hover),
        Scenario(
            "figure-eight",
            "aggressive multicopter: 9 m/s, tilts to 40 degrees, turning nose",
            60.0,
            True,
            False,
            _figure_eight,
        ),
        Scenario(
            "loiter", "fixed wing: circles of 80 m at 16 m/s, climbing", 120.0, True, True, _loiter
        ),
        Scenario(
            "square-spiral",
            "fixed wing: a shrinking square of 1.1 km, 13 to 23 m/s, 110 to 210 m up",
            400.0,
            True,
            True,
            _square_spiral,
        ),
        Scenario(
            "drive",
            "ground vehicle: a winding road at 3 to 9 m/s, with stops",
            120.0,
            True,
            False,
            _drive,
            is_rolling=True,
        ),
        Scenario(
            "walk", "on a foot: 0.5 s still, 0.7 s swinging, in a circle", 90.0, False, False, _walk
        ),
    )
}
"""By name."""
