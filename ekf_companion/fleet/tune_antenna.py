"""Fixes of an antenna, brought to the inertial sensor by a lever arm that is tried.

The estimator takes what a turn adds to the antenna's velocity from one sample of the rate. That is
good enough to fly by, but its noise passes for turns, and an arm that is fitted to it comes out too
short (errors in variables). A fit has the samples after a fix as well: a parabola through those
around it has a twentieth of the variance of a sample at 100 Hz. What that leaves is known, and
``tune_flight`` takes it out of the likelihood.

Source: Fuller 1987, "Measurement error models", ch. 1; Savitzky and Golay 1964, Analytical
Chemistry 36, 8.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.core.settings.from_settings import has_mean_samples, imu_lag
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, known_rows, median
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.interpolation import between, resample
from ekf_companion.nav.measurements import GNSS_POSITION, GNSS_VELOCITY, Kind
from ekf_companion.nav.state import GYRO_BIAS, QUATERNION, Table

SPAN = 0.4
"""Time about a fix through whose samples the parabola goes, s: it follows a swing of 1 Hz to 3 %,
and averages 41 samples at 100 Hz."""


class Antenna:
    """The attitude and the rate of a flight, by which its fixes are brought to the sensor."""

    def __init__(self, recording: Recording, table: Table, settings: FilterSettings) -> None:
        """Take both from a recording and its estimates."""
        from scipy.signal import savgol_coeffs, savgol_filter

        events = recording.events
        self._values = events.values
        self.fixes = np.flatnonzero(events.kind == Kind.GNSS)
        """Rows of the fixes among the events."""
        self._fix_ns = events.t_ns[self.fixes]
        lat, lon, alt = self._values[self.fixes[0], GNSS_POSITION]
        north, east = LocalFrame(lat, lon, alt).scale
        self._per_metre = np.array([1.0 / north, 1.0 / east, -1.0])

        samples = np.flatnonzero(events.kind == Kind.IMU)
        t_ns = events.t_ns[samples]
        newest = np.maximum.accumulate(t_ns)
        is_new = np.append(True, newest[1:] > newest[:-1])
        samples, t_ns = samples[is_new], t_ns[is_new]
        step = median(np.diff(t_ns)) * 1e-9
        estimated = known_rows(table.columns((*QUATERNION, *GYRO_BIAS)))
        stamps, first = np.unique(table.stamp_ns[estimated], return_index=True)
        q_nb, bias = (table.columns(of)[estimated][first] for of in (QUATERNION, GYRO_BIAS))
        rate_b = self._values[samples, :3] - resample(t_ns, stamps, bias)
        window = 2 * round(0.5 * SPAN / step) + 1
        self.bandwidth = 1.0 / step
        """Variance of the rate over the density of the gyro's noise, Hz."""
        if 3 < window <= len(rate_b):
            rate_b = savgol_filter(rate_b, window, polyorder=2, axis=0)
            # A projection: the sum of the squares of a row is its element on the diagonal
            self.bandwidth *= float(savgol_coeffs(window, 2)[window // 2])
        late = imu_lag(settings, recording.family)
        if has_mean_samples(settings, recording.family):
            late += 0.5 * step
        self._rate_ns, self._rate_b = t_ns - round(late * 1e9), rate_b
        self._attitude_ns, self._q_nb = stamps, q_nb

    def brought(self, arm_b: Array, delay: float) -> Array:
        """Return the values of all events, with each fix as if taken at the inertial sensor.

        Args:
            arm_b: The antenna from the sensor, m, shape (3,).
            delay: By which a fix is older than its stamp, s.
        """
        values: Array = self._values.copy()
        at_ns = self._fix_ns - round(delay * 1e9)
        turns = between(self._rate_ns, at_ns)
        attitudes = between(self._attitude_ns, at_ns[turns.wanted])
        rows = self.fixes[turns.wanted][attitudes.wanted]
        rate_b = turns.values(self._rate_b)[attitudes.wanted]
        C_nb = so3.to_matrix(attitudes.rotations(self._q_nb))
        values[rows, GNSS_POSITION] -= (C_nb @ arm_b) * self._per_metre
        swing_b = np.cross(rate_b, arm_b)
        values[rows, GNSS_VELOCITY] -= np.einsum("nij,nj->ni", C_nb, swing_b)
        return values
