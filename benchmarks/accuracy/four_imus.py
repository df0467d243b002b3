"""Drift of four low-cost inertial units on one real quadrotor, against its RTK track.

The data are those of Hurwitz and Klein, "Quadrotor Dead Reckoning with Multiple Inertial Sensors",
arXiv 2310.13452.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from benchmarks.accuracy.outages import COVERED, Drift, cut, drift
from benchmarks.campaign import pieces
from benchmarks.document import is_there, table
from ekf_companion.core.memory.enums import E_POS
from ekf_companion.core.settings.settings import FilterSettings, ImuSettings
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, HeadingSource, Kind, merge

FOLDER = "p4-rtk-four-imus"
FLIGHTS = ("horizontal-path_2", "horizontal-path_9", "vertical-path_1")
UNITS = (1, 2, 3, 4)
LENGTHS = (10.0, 30.0)
"""Of the outages, s."""
SETTLED = 12.0
"""No outage begins so soon after the first fix, s."""
STEP = 2.0
"""Between the outages tried, s."""
HEAD = (
    "settings | unit | outage, s | cases | horizontal: median, m | 95 % | own 95 % | covered"
    " | vertical: median, m | 95 % | own 95 % | covered"
)
KINDS = {
    "default": FilterSettings(),
    "imu.learn_noise: false": FilterSettings(imu=ImuSettings(learn_noise=False)),
}
"""The second settings take no noise from the vibration."""

FIRST_NS = 2_000_000_000
"""Stamp of a unit's time 0: no stamp is negative."""
ROW = 0.1
"""Between the rows of the track, s."""
POSITION_LEADS = 0.05
"""A row's position is newer than its attitude by this, s: where the accelerations of track and
units fit best on both horizontal flights. The filter's own delay then stays within 0.01 s."""
HEIGHT_LAGS = 0.05
"""A row's height is older than its attitude by this, s: likewise, on the vertical flight."""
ORIGIN = LocalFrame(np.radians(32.8), np.radians(35.0), 0.0)
"""The track is relative; this is near Haifa."""

EVERY = 2
"""Every second row becomes a fix: 5 Hz."""
STD_H, STD_V = 0.05, 0.08
"""Stated of a fix, m: NOISE_H, NOISE_V, and the steps of 0.1 m in the heights."""
NOISE_H, NOISE_V, NOISE_VEL = 0.03, 0.05, 0.1
"""White noise that is added to a fix, m and m/s."""
STD_VEL = 0.2
"""Stated of its velocity, m/s: NOISE_VEL, and what differentiation over five rows leaves, which
differs from the recorded speed by 0.12 to 0.18 m/s RMS on the horizontal flights."""
STD_HEADING = 0.035
"""Stated of a heading, rad; on the horizontal flights it fits the accelerations to 1.5 deg."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One outage's end."""

    drift: Drift
    reach: tuple[float, float]
    """Of the filter's own 95 %, m: half the ellipse's long axis, and half the interval."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What the vehicle itself recorded, by rows."""

    t: Array
    """s from the first row."""
    pos_n: Array
    """From the RTK receiver, m; the height in steps of 0.1 m. Shape (n, 3)."""
    euler: Array
    """Roll, pitch, yaw, rad, shape (n, 3)."""

    @classmethod
    def read(cls, path: Path) -> Track:
        """Read GT.csv, and bring the heights to the time of the positions."""
        rows = np.genfromtxt(path, delimiter=",", skip_header=1)
        t, pos_n = rows[:, 0], rows[:, 7:10]
        later = t + POSITION_LEADS + HEIGHT_LAGS
        pos_n[:, 2] = np.interp(later, t, pos_n[:, 2])
        return cls(t, pos_n, np.radians(rows[:, [5, 4, 3]]))


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """The samples of one inertial unit, in its own axes."""

    t: Array
    """s on its own clock."""
    accel: Array
    """m/s^2, shape (n, 3)."""
    gyro: Array
    """rad/s, shape (n, 3)."""

    @classmethod
    def read(cls, path: Path) -> Unit:
        """Read IMU_n.csv; a sample with the stamp of the one before it is left out."""
        rows = np.genfromtxt(path, delimiter=",", skip_header=1)
        rows = rows[np.diff(rows[:, 0], prepend=-1.0) > 0.0]
        return cls(rows[:, 0], rows[:, 4:7], np.radians(rows[:, 7:10]))


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """Where a unit is on the vehicle, and when its clock began."""

    offset: float
    """The unit's time of the track's time 0, s."""
    C_bu: Array
    """Turns the unit's axes into forward, right, down."""
    misfit: float
    """RMS difference of the rates, rad/s."""


def mounting(track: Track, unit: Unit) -> Mounting:
    """Find the rotation and offset that bring the unit's rates closest to the vehicle's.

    The vehicle's are the differences of the attitude that it recorded. Means are removed: they
    are the unit's bias.
    """
    q_nb = Rotation.from_euler("ZYX", track.euler[:, ::-1])
    rate_b = (q_nb[:-1].inv() * q_nb[1:]).as_rotvec() / ROW
    rate_b -= rate_b.mean(axis=0)
    middle = track.t[:-1] + 0.5 * ROW
    per_row = round(ROW / float(np.median(np.diff(unit.t))))
    mean_u = uniform_filter1d(unit.gyro - unit.gyro.mean(axis=0), per_row, axis=0)
    best = Mounting(0.0, np.eye(3), np.inf)
    for offset in np.arange(-1.0, 1.0, 0.01).tolist():
        is_in = (middle + offset > unit.t[0]) & (middle + offset < unit.t[-1])
        rate_u = _at(middle[is_in] + offset, unit.t, mean_u)
        C_bu, distance = Rotation.align_vectors(rate_b[is_in], rate_u)
        misfit = distance / np.sqrt(np.count_nonzero(is_in))
        if misfit < best.misfit:
            best = Mounting(offset, C_bu.as_matrix(), float(misfit))
    return best


def events(track: Track, unit: Unit, mounted: Mounting, rng: np.random.Generator) -> Events:
    """Make inertial samples, fixes and headings, on the unit's clock."""
    offset = mounted.offset
    vel_n = savgol_filter(track.pos_n, 5, 2, deriv=1, delta=ROW, axis=0)[::EVERY]
    draw = rng.standard_normal((2, len(vel_n), 3))
    place = ORIGIN.to_geodetic(track.pos_n[::EVERY] + draw[0] * [NOISE_H, NOISE_H, NOISE_V])
    velocity = (vel_n + NOISE_VEL * draw[1]).T
    fix_t = track.t[::EVERY] + offset + POSITION_LEADS
    rest = (np.nan, 0.0, np.nan, np.nan)  # no magnetic field, no flag
    fixes = Events.from_columns(
        _ns(fix_t), Kind.GNSS, *place, *velocity, STD_H, STD_V, STD_VEL, *rest
    )
    source = float(HeadingSource.AUTOPILOT)
    headings = Events.from_columns(
        _ns(track.t + offset), Kind.HEADING, so3.wrap(track.euler[:, 2]), STD_HEADING, source
    )
    rates, forces = unit.gyro @ mounted.C_bu.T, unit.accel @ mounted.C_bu.T
    samples = Events.from_columns(_ns(unit.t), Kind.IMU, *rates.T, *forces.T)
    return merge(fixes, headings, samples)


def cases(folder: Path, unit: int, settings: FilterSettings, seed: int) -> dict[float, list[Case]]:
    """Cut outages into one flight of one unit, one at a time; cases by length."""
    track, one = Track.read(folder / "GT.csv"), Unit.read(folder / f"IMU_{unit}.csv")
    mounted = mounting(track, one)
    made = events(track, one, mounted, np.random.default_rng(seed))
    truth_t = track.t + mounted.offset + POSITION_LEADS
    begin = max(truth_t[0], one.t[0]) + SETTLED
    end = min(truth_t[-1], one.t[-1]) - ROW  # no height is known for the last row's position
    found: dict[float, list[Case]] = {length: [] for length in LENGTHS}
    for start in np.arange(begin, end - min(LENGTHS), STEP).tolist():
        lengths = [length for length in LENGTHS if start + length < end]
        start_ns = int(_ns(start))
        silent = cut(made, start_ns, max(lengths))
        ends = [start_ns + round(length * 1e9) for length in lengths]
        for length, piece in zip(lengths, pieces(settings, silent, ends), strict=False):
            at_end = piece.snapshot
            assert at_end.is_navigating, f"{folder.name}: no position {SETTLED} s after the first"
            t = (at_end.t_ns - FIRST_NS) * 1e-9
            place = ORIGIN.to_geodetic(_at(np.array([t]), truth_t, track.pos_n)[0])
            P = at_end.covariance(E_POS, 3)
            drifted = drift(at_end.frame.to_ned(*place) - at_end.x.pos_n, P)
            found[length].append(Case(drifted, _reach(P)))
    return found


def tables(data: Path) -> Iterator[str]:
    """Yield drift and coverage of each unit, all flights together."""
    flights = [name for name in FLIGHTS if is_there(data, f"{FOLDER}/{name}/GT.csv")]
    rows = []
    for kind, settings in KINDS.items():
        for unit in UNITS:
            found = [
                cases(data / FOLDER / name, unit, settings, FLIGHTS.index(name)) for name in flights
            ]
            for length in LENGTHS:
                if pooled := [case for flight in found for case in flight[length]]:
                    rows.append(_row(f"{kind} | {unit}", length, pooled))
    return table(HEAD, rows)


def _row(title: str, length: float, pooled: Sequence[Case]) -> str:
    horizontal, vertical, *covered = zip(*(case.drift for case in pooled), strict=True)
    reaches = zip(*(case.reach for case in pooled), strict=True)
    cells = [title, f"{length:.0f}", str(len(pooled))]
    for errors, reach, is_covered in zip((horizontal, vertical), reaches, covered, strict=True):
        cells += [f"{np.median(errors):.1f}", f"{np.percentile(errors, 100.0 * COVERED):.1f}"]
        cells += [f"{np.median(reach):.1f}", f"{100.0 * float(np.mean(is_covered)):.0f} %"]
    return " | ".join(cells)


def _reach(P: Array) -> tuple[float, float]:
    largest = float(np.linalg.eigvalsh(P[:2, :2])[-1])
    return (
        float(np.sqrt(chi2.ppf(COVERED, 2) * largest)),
        float(np.sqrt(chi2.ppf(COVERED, 1) * P[2, 2])),
    )


def _ns(t: npt.ArrayLike) -> Stamps:
    return np.rint(np.asarray(t) * 1e9).astype(np.int64) + FIRST_NS


def _at(t: Array, of: Array, values: Array) -> Array:
    return np.column_stack([np.interp(t, of, axis) for axis in values.T])
