"""Arrays of measurements that cannot be meant: another unit, another sign, other axes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_companion.errors import DataError
from ekf_companion.filters.inertial import LARGEST_FORCE, LARGEST_RATE
from ekf_companion.nav.arrays import Array, Mask, Stamps
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.repetition import LEAP

SLOWEST, FASTEST = 1.0, 20_000.0
"""Of inertial samples, Hz."""
FASTEST_TURN = 40.0
"""rad/s: more than any MEMS gyro measures (2000 deg/s is 35)."""
HALF_TURN = np.pi
"""rad: no vehicle tilts so far with its force along gravity all the while."""
WITHIN = 15.0
"""Time in which it would, s: a bias of 12 deg/s, which no gyro has, but any has turned so far in
an hour."""
UNBANKED = 0.3
"""Of gravity, m/s^2: more than an accelerometer's bias, less than a bank of 15 deg adds."""
LARGEST = {"gyro": (LARGEST_RATE, "rad/s"), "accel": (LARGEST_FORCE, "m/s2")}
"""Beyond these no sample is used."""
SPIKE = {"gyro": LEAP, "accel": 80.0}
"""rad/s and m/s^2: no flight but a crash is so rough."""
SPIKES = 5.0
"""Times the size that all but ``SELDOM`` of the samples stay below: a spike is larger."""
SELDOM = 0.005


class Remedies(NamedTuple):
    """What to do about inertial samples that cannot be meant, where they were given."""

    g: str
    """Of a specific force in g."""
    dps: str
    """Of rates in deg/s."""
    meant: str
    """Of axes that are right nevertheless."""


OF_ARRAYS = Remedies("say units={'accel': 'g'}", "say units={'gyro': 'deg/s'}", "check=False")
OF_COLUMNS = Remedies(
    "name the columns accel_x_g, accel_y_g, accel_z_g, or in a map unit: g",
    "name the columns gyro_x_dps, gyro_y_dps, gyro_z_dps, or in a map unit: deg/s",
    "leave them",
)
_COUNTERS = {"us": 1_000, "ms": 1_000_000}
"""Units in which boards count time by 32 bits, ns: these end after 71.6 minutes and 49.7 days."""
FULL_WITHIN = 2.0
"""Largest step, s, over which a counter that began anew is recognised."""
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def check_times(name: str, t_ns: Stamps, given: str, *, is_inertial: bool = False) -> None:
    """Refuse times that do not go on, or that are plainly in another unit.

    Args:
        name: Of the array, for the sentence.
        t_ns: Stamps, shape (n,), ns.
        given: The unit in which they were taken.
        is_inertial: Whether they are those of inertial samples, whose rate is known about.

    Raises:
        DataError: They cannot be meant.
    """
    steps = np.diff(t_ns)
    if len(steps) and (back := np.flatnonzero(steps < 0)).size:
        row = int(back[0]) + 1
        raise DataError(
            f"{name}: goes back at row {row}, from {t_ns[row - 1] * 1e-9:.6f} to "
            f"{t_ns[row] * 1e-9:.6f} s; {_of_going_back(-int(steps[row - 1]))}"
        )
    if is_inertial:
        check_rate(name, t_ns, given, "it looks like {0}: say units={{'time': '{0}'}}")


def _of_going_back(by_ns: int) -> str:
    """Return what to do about times that go back once by so much."""
    for unit, size in _COUNTERS.items():
        lost = size << 32
        if 0 <= lost - by_ns < FULL_WITHIN * 1e9:
            return (
                f"a counter of 32 bits of {unit} has begun anew: add {lost * 1e-9:.6f} s to the "
                "times from there on"
            )
    return "sort the rows, or run each recording by itself"


def check_rate(name: str, t_ns: Stamps, given: str, advice: str) -> None:
    """Refuse times of inertial samples that are plainly in another unit.

    Args:
        name: As above, as the others.
        t_ns: Stamps.
        given: The unit in which they were taken.
        advice: What to do; ``{}`` stands for the unit that they look like.

    Raises:
        DataError: No inertial samples come at this rate.
    """
    if len(t_ns) < 2:
        return
    step = float(np.median(np.diff(t_ns))) * 1e-9 / _UNITS[given]
    if step == 0.0:
        share = float(np.mean(np.diff(t_ns) == 0))
        raise DataError(
            f"{name}: {share:.0%} of the rows have the time of the row before, so the times are "
            "rounded or repeated; give each inertial sample its own time"
        )
    rate = 1.0 / (step * _UNITS[given])
    if SLOWEST <= rate <= FASTEST:
        return
    fits = [unit for unit, size in _UNITS.items() if 10 <= 1 / (step * size) <= 5000]
    raise DataError(
        f"{name}: taken as {given}, inertial samples come at {rate:.3g} Hz, which none do; "
        + (advice.format(fits[0]) if fits else "check them")
    )


def check_known(name: str, values: Array) -> None:
    """Refuse an array without a single finite number.

    Raises:
        DataError: There is none.
    """
    if not np.isfinite(values).any():
        raise DataError(f"{name}: all {len(values)} rows are NaN or infinity; there is no data")


def beyond_sensors(name: str, values: Array) -> Mask:
    """Return which rows of ``gyro`` or ``accel`` hold what no sensor measures, shape (n,)."""
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (np.abs(values) > LARGEST[name][0]).any(axis=1) & ~np.isnan(values).any(1)
        )


def spikes(name: str, values: Array) -> tuple[Mask, float]:
    """Return which rows of ``gyro`` or ``accel`` lie far beyond the others.

    Returns:
        The rows that a sensor can measure, that are larger than in flight, and ``SPIKES`` times as
        large as nearly all others, shape (n,); and the size that those stay below.
    """
    size = np.linalg.norm(values, axis=1)
    known = np.isfinite(size) & ~beyond_sensors(name, values)
    if not known.any():
        return np.zeros(len(size), dtype=np.bool_), 0.0
    usual = float(np.quantile(size[known], 1.0 - SELDOM))
    return known & (size > max(SPIKE[name], SPIKES * usual)), usual


def check_inertial(gyro: Array, accel: Array, t_ns: Stamps, remedies: Remedies = OF_ARRAYS) -> None:
    """Refuse inertial samples in other units, of the other sign of gravity, or along other axes.

    Args:
        gyro: Angular rates, rad/s, forward, right, down, shape (n, 3).
        accel: Specific force, m/s^2, likewise.
        t_ns: Their stamps, ns.
        remedies: What the sentence advises.

    Raises:
        DataError: They cannot be meant; the sentence says what they look like.
    """
    known = np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
    if not known.any():
        raise DataError("gyro, accel: in each row one of the two holds NaN or infinity")
    gyro, accel, t_ns = gyro[known], accel[known], t_ns[known]
    size = np.linalg.norm(accel, axis=1)
    force = float(np.median(size))
    # Without gravity it would be next to nothing at times
    is_steady = float(np.percentile(size, 10.0)) > 0.5 * force
    for unit, one in (("g", 1.0), ("milli-g", 1e3), ("cm/s2", 100.0 * STANDARD_GRAVITY)):
        if 0.7 * one < force < 1.4 * one and is_steady:
            raise DataError(
                f"accel: its median size is {force:.3g} m/s2, where gravity is 9.81: it looks like "
                f"{unit}; " + (remedies.g if unit == "g" else "convert it")
            )
    if not 0.3 * STANDARD_GRAVITY < force < 5.0 * STANDARD_GRAVITY:
        raise DataError(
            f"accel: its median size is {force:.3g} m/s2, where gravity is 9.81; it must be the "
            "specific force (what an accelerometer measures), in m/s2, gravity not removed"
        )
    _check_rates(gyro, accel, t_ns, f"it looks like deg/s; {remedies.dps}")
    _check_axes(accel, force, remedies.meant)


def _check_rates(gyro: Array, accel: Array, t_ns: Stamps, advice: str) -> None:
    """Refuse degrees for radians."""
    size = np.linalg.norm(gyro, axis=1)
    fast = float(np.percentile(size, 99.0))
    if fast > FASTEST_TURN:
        raise DataError(f"gyro: reaches {fast:.3g} rad/s, faster than any sensor turns: {advice}")
    if (tilt := _tilt_at_rest(gyro, accel, t_ns)) > HALF_TURN:
        raise DataError(
            f"gyro: tilts by {tilt:.3g} rad while gravity stands still in the accelerometer: "
            f"{advice}, or the sensor has a bias of many deg/s"
        )
    spread = np.linalg.norm(accel - np.median(accel, axis=0), axis=1)
    if float(np.median(size)) > 3.0 and float(np.median(spread)) < 4.0:
        raise DataError(
            f"gyro: turns at {np.median(size):.3g} rad/s all the time, and the accelerometer does "
            f"not follow: {advice}"
        )


def _tilt_at_rest(gyro: Array, accel: Array, t_ns: Stamps) -> float:
    """Return how far the gyro tilts while gravity stands still in the accelerometer, rad.

    A turn about gravity, as of a hover, moves it nowhere; in a banked turn the force is larger. A
    multicopter's own force tilts with it, so gravity seems to stand still, but it tilts back.
    """
    pieces = max(1, len(gyro) // 100)
    farthest, tilt, since_ns = 0.0, np.zeros(3), t_ns[0]
    for rows in np.array_split(np.arange(len(gyro)), pieces):
        begin_ns, end_ns = t_ns[rows[0]], t_ns[rows[-1]]
        mean = accel[rows].mean(axis=0)
        size = float(np.linalg.norm(mean))
        is_still = accel[rows].std(axis=0).max() < 0.15 and abs(size - STANDARD_GRAVITY) < UNBANKED
        if not is_still or end_ns - since_ns > WITHIN * 1e9:
            tilt, since_ns = np.zeros(3), begin_ns
        if is_still:
            turn = gyro[rows].mean(axis=0) * float(end_ns - begin_ns) * 1e-9
            tilt = tilt + np.cross(turn, mean / size)
            farthest = max(farthest, float(np.linalg.norm(tilt)))
    return farthest


def _check_axes(accel: Array, force: float, meant: str) -> None:
    """Refuse another sign of gravity, and axes that are not forward, right, down."""
    mean = np.median(accel, axis=0) / force
    axis = int(np.argmax(np.abs(mean)))
    if abs(mean[axis]) < 0.8 or (axis == 2 and mean[axis] < 0.0):
        return
    what = f"accel: gravity shows as {mean[axis] * force:+.1f} m/s2 along {'xyz'[axis]}"
    if axis == 2:
        raise DataError(
            f"{what}; a level vehicle measures -9.8 along its down axis. Either the sign is that "
            "of an acceleration (give -accel), or the axes are forward, left, up (give gyro and "
            f"accel times [1, -1, -1]); if the vehicle does hang upside down, {meant}"
        )
    raise DataError(
        f"{what}, so that axis is not level: the axes must be those of the vehicle, forward, "
        "right, down; turn gyro and accel into them, or, if it does stand so, " + meant
    )


def check_place(lat: Array, lon: Array, unit: str) -> None:
    """Refuse latitudes and longitudes, rad, that were given in the other unit.

    Raises:
        DataError: They are no place on the Earth.
    """
    if np.nanmax(np.abs(lat)) > np.pi / 2 + 1e-9 or np.nanmax(np.abs(lon)) > 2.0 * np.pi + 1e-9:
        other = "lat_deg and lon_deg" if unit == "rad" else "other columns"
        raise DataError(f"gnss: lat_{unit}, lon_{unit} are no place on the Earth; is it {other}?")


def check_velocity(t_ns: Stamps, alt: Array, vel_n: Array) -> None:
    """Refuse a vertical velocity that is positive upwards.

    Raises:
        DataError: It contradicts the heights.
    """
    known = np.isfinite(alt) & np.isfinite(vel_n[:, 2])
    if np.count_nonzero(known) < 20:
        return
    seconds, heights, down = t_ns[known] * 1e-9, alt[known], vel_n[known, 2]
    climb = -np.cumsum(0.5 * (down[1:] + down[:-1]) * np.diff(seconds))
    if np.std(climb) < 1.0 or np.std(heights[1:]) < 1.0:
        return
    if float(np.corrcoef(climb, heights[1:])[0, 1]) < -0.7:
        raise DataError(
            "gnss: vel_n: its third column rises with alt; it must be the velocity down, as in "
            "north, east, down, and alt positive upwards"
        )


def check_overlap(imu_ns: Stamps, other_ns: Stamps, name: str) -> None:
    """Refuse another clock or epoch.

    Raises:
        DataError: The times have nothing in common.
    """
    if other_ns[-1] < imu_ns[0] or other_ns[0] > imu_ns[-1]:
        spans = [f"{t[0] * 1e-9:.3f} to {t[-1] * 1e-9:.3f} s" for t in (imu_ns, other_ns)]
        raise DataError(
            f"{name}: its times ({spans[1]}) and those of the inertial samples ({spans[0]}) have "
            "nothing in common; both must be of one clock, in units that are said"
        )
    spans_ns = [float(t[-1] - t[0]) for t in (imu_ns, other_ns)]
    if len(other_ns) < 3 or not all(spans_ns):
        return
    ratio = spans_ns[1] / spans_ns[0]
    for size in (1e3, 1e6, 1e9):
        if 0.7 < ratio / size < 1.4 or 0.7 < ratio * size < 1.4:
            raise DataError(
                f"{name}: its rows span {spans_ns[1] * 1e-9:.5g} s, and the inertial samples "
                f"{spans_ns[0] * 1e-9:.5g} s, by a factor of {size:.0e}: the times of both must be "
                "in one unit"
            )
