"""A real flight with a visual-inertial estimate and truth, and fixes made from that.

EuRoC MAV, MH_01_easy: Burri et al. 2016. The world's axes become north, west, up.
"""

from functools import cached_property

import numpy as np

from ekf_companion.core.memory.enums import SLOW_ERRORS
from ekf_companion.core.settings.settings import (
    BaroSettings,
    FilterSettings,
    GnssSettings,
    ImuSettings,
    VisualOdometrySettings,
)
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind, merge
from tests.paths import DATA

FOLDER = DATA / "euroc-mh01-vio"
DOWN = np.diag([1.0, -1.0, -1.0])
"""From a world whose z points up."""
BODY = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Forward, right, down in the axes of the inertial sensor, in columns."""
FRAME = LocalFrame(np.deg2rad(47.0), np.deg2rad(8.0), 400.0)
LATE_NS = 120_000_000
"""By which fixes are late."""
WALK_TIME = 60.0
"""Correlation time of the slow error of fixes, s."""


def yaw_of(C):
    return np.arctan2(C[:, 1, 0], C[:, 0, 0])


def turned(yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Flight:
    """The recording; times are ns since a begin of its own."""

    def __init__(self):
        table = np.genfromtxt(FOLDER / "imu0.csv", delimiter=",", skip_header=1)
        stamps = np.loadtxt(FOLDER / "imu0.csv", delimiter=",", skiprows=1, usecols=0, dtype=int)
        self._begin = stamps[0] * 1e-9
        self.imu_ns = stamps - stamps[0] + 10**10
        self.gyro, self.accel = table[:, 1:4] @ BODY, table[:, 4:7] @ BODY
        self.true_ns, self.true, C = self._read("truth.tum", 0)
        self.true_yaw = np.unwrap(yaw_of(C))
        self.vio_ns, self.vio, C = self._read("vio_mono.tum", 1)
        self.vio_yaw = yaw_of(C)

    def _read(self, name, skip):
        rows = np.loadtxt(FOLDER / name)[skip:]
        t_ns = (np.round((rows[:, 0] - self._begin) * 1e6) * 1000).astype(int) + 10**10
        q = np.column_stack([rows[:, 7], rows[:, 4:7]])
        return t_ns, rows[:, 1:4] @ DOWN, DOWN @ so3.to_matrix(q) @ BODY

    @cached_property
    def imu(self):
        return Events.from_columns(self.imu_ns, Kind.IMU, *self.gyro.T, *self.accel.T)

    def place(self, t_ns):
        return np.stack([np.interp(t_ns, self.true_ns, one) for one in self.true.T], axis=1)

    def fixes(self, seed, cut=(0.0, 0.0), false=(0.0, 0.0), rate=5.0):
        """Return fixes: 1 m white, 1 m slow, velocities of 0.1 m/s; none, or 300 m off, at times.

        Args:
            seed: Of the errors.
            cut: From when until when there are none, s.
            false: From when until when they are off.
            rate: Hz.
        """
        rng = np.random.default_rng(seed)
        t_ns = np.arange(self.true_ns[0], self.true_ns[-1], int(1e9 / rate))
        t = (t_ns - t_ns[0]) * 1e-9
        share, slow = np.exp(-1.0 / rate / WALK_TIME), rng.normal(size=3)
        pos_n = self.place(t_ns) + rng.normal(size=(len(t), 3))
        for row in pos_n:
            slow = share * slow + np.sqrt(1.0 - share * share) * rng.normal(size=3)
            row += slow
        pos_n[(t >= false[0]) & (t < false[1])] += [300.0, 0.0, 0.0]
        vel_n = np.gradient(self.true, self.true_ns * 1e-9, axis=0)
        vel_n = np.stack([np.interp(t_ns, self.true_ns, one) for one in vel_n.T], axis=1)
        vel_n = vel_n + rng.normal(0.0, 0.1, vel_n.shape)
        stds = [np.full(len(t), std) for std in (2.0**0.5, 2.0**0.5, 0.1)]
        unknown, none = np.full(len(t), np.nan), np.zeros(len(t))
        columns = (*FRAME.to_geodetic(pos_n), *vel_n.T, *stds, unknown, none)
        events = Events.from_columns(t_ns + LATE_NS, Kind.GNSS, *columns)
        return events.take((t < cut[0]) | (t >= cut[1]))

    def poses(self, delay=0.0, scale=1.0, yaw=0.0, reset=None, is_told=True, change=None):
        """Return the visual odometry's poses, with what is done to them.

        Args:
            delay: By which their stamps are late, s.
            scale: By which its places are stretched.
            yaw: By which its frame is turned, rad.
            reset: When it begins a new frame, s, moved by how much, m, and turned, deg.
            is_told: Whether its counter moves then.
            change: Changes times (s), places and yaws.
        """
        t = (self.vio_ns - self.vio_ns[0]) * 1e-9
        pos, yaws, counter = scale * self.vio @ turned(yaw).T, self.vio_yaw + yaw, np.zeros(len(t))
        if reset is not None:
            after = t >= reset[0]
            pos[after] = pos[after] @ turned(np.deg2rad(reset[2])).T + [reset[1], 0.0, 0.0]
            yaws = yaws + after * np.deg2rad(reset[2])
            counter = counter + (after if is_told else np.nan)
        if change is not None:
            t, pos, yaws = change(t, pos, yaws)
        unknown = np.full(len(t), np.nan)
        columns = (*pos.T, so3.wrap(yaws), unknown, unknown, counter)
        late = np.round((t + delay) * 1e9).astype(int)
        return Events.from_columns(self.vio_ns[0] + late, Kind.POSE, *columns)

    def fly(self, *events, **settings):
        """Return what the estimator makes of it: :class:`Flown`."""
        chosen = FilterSettings(
            imu=ImuSettings(gyro_bias=0.1),  # nobody has calibrated it: 0.08 about one axis
            gnss=GnssSettings(delay=LATE_NS * 1e-9),
            baro=BaroSettings(use=False),
            visual_odometry=VisualOdometrySettings(**{"use": True, **settings}),
        )
        pipeline = Pipeline(chosen, "unknown", None)
        return Flown(self, pipeline, pipeline.run(merge(*events, self.imu)))


class Flown:
    """An estimate of the flight, beside the truth."""

    def __init__(self, flight, pipeline, table):
        keep = (table.stamp_ns > flight.true_ns[0]) & (table.stamp_ns < flight.true_ns[-1])
        t_ns = table.stamp_ns[keep]
        self.t = (t_ns - flight.true_ns[0]) * 1e-9
        self.local = table.columns(["pos_n", "pos_e", "pos_d"])[keep]
        self.std = table.columns(["sd_pos_n", "sd_pos_e", "sd_pos_d"])[keep]
        self.status, self.resets = table.column("status")[keep], table.column("reset_count")[keep]
        self.true, self.state = flight.place(t_ns), pipeline.filter_state
        self.true_yaw = np.interp(t_ns, flight.true_ns, flight.true_yaw)
        self.yaw = table.column("yaw")[keep]
        lat, lon = (np.deg2rad(table.column(one)[keep]) for one in ("lat_deg", "lon_deg"))
        self.error = FRAME.to_ned(lat, lon, table.column("alt_m")[keep]) - self.true
        first = SLOW_ERRORS["visual_odometry"]
        self.learnt_std = [float(self.state.P[first + i][first + i]) ** 0.5 for i in (3, 4, 5)]

    def aligned(self):
        """Return position errors of the local frame, moved and turned about down to fit best."""
        known = np.isfinite(self.local[:, 0])
        ours, true = (one[known] - one[known].mean(axis=0) for one in (self.local, self.true))
        cross = (ours[:, 0] * true[:, 1] - ours[:, 1] * true[:, 0]).sum()
        yaw = np.arctan2(cross, (ours[:, :2] * true[:, :2]).sum())
        return ours @ turned(yaw).T - true


def rms(error):
    """Return the root of the mean square length of vectors."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))
