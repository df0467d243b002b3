"""The rows of measurements that are read in blocks (compiled)."""

from __future__ import annotations

import math

import cython

from ekf_companion.mavlink.decode.context import Measurements
from ekf_companion.mavlink.decode.trim import Trim
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.buffer import EventBuffer
from ekf_companion.nav.measurements import (
    GNSS_DECLINATION,
    GNSS_FIELD,
    GNSS_FLAGS,
    GNSS_INCLINATION,
    GnssFlag,
    HeadingSource,
    Kind,
)

IMU_KIND = cython.declare(cython.longlong, int(Kind.IMU))
MAG_KIND = cython.declare(cython.longlong, int(Kind.MAG))
BARO_KIND = cython.declare(cython.longlong, int(Kind.BARO))
HEADING_KIND = cython.declare(cython.longlong, int(Kind.HEADING))
HEADING_SOURCE = cython.declare(cython.double, float(HeadingSource.AUTOPILOT))
GNSS_KIND = cython.declare(cython.longlong, int(Kind.GNSS))
OWN_POSITION = cython.declare(cython.double, float(GnssFlag.DERIVED))
FLAGS = cython.declare(cython.Py_ssize_t, GNSS_FLAGS)
DECLINATION = cython.declare(cython.Py_ssize_t, GNSS_DECLINATION)
INCLINATION = cython.declare(cython.Py_ssize_t, GNSS_INCLINATION)
STRENGTH = cython.declare(cython.Py_ssize_t, GNSS_FIELD)
UNKNOWN = cython.declare(cython.double, math.nan)
DEGREE = cython.declare(cython.double, math.pi / 180.0)


class RowWriter:
    """Writes rows into the arrays of a buffer."""

    def __init__(self, trim: Trim) -> None:
        """Begin without a buffer; ``trim`` turns the board's axes into the vehicle's."""
        self.trim = trim
        self.values_of: Array | None = None

    def use(self, buffer: EventBuffer) -> None:
        """Write rows into a buffer."""
        if self.values_of is not buffer.values:
            self.values_of = buffer.values
            self.out_t, self.out_kind, self.out = buffer.t_ns, buffer.kind, buffer.values
        self.buffer, self.n = buffer, buffer.size
        self.limit = buffer.limit

    def begin_row(self, t_ns: int, kind: int) -> None:
        """Begin a row of zeros."""
        self.out_t[self.n] = t_ns
        self.out_kind[self.n] = kind
        for j in range(self.out.shape[1]):
            self.out[self.n, j] = 0.0

    def put_rows(self, measurements: Measurements) -> None:
        """Write the rows of measurements that the decoder has made."""
        self.buffer.size = self.n
        for measurement in measurements:
            self.buffer.append(measurement.row())
        self.use(self.buffer)

    def put_vector(self, x: float, y: float, z: float, first: int) -> None:
        """Write a vector of the board into the row, in the vehicle's axes."""
        if self.trim.rows is not None:
            x, y, z = self.trim.to_vehicle(x, y, z)
        self.out[self.n, first] = x
        self.out[self.n, first + 1] = y
        self.out[self.n, first + 2] = z

    def put_sample(self, t_ns: int, row: Array) -> None:
        """Write an inertial sample: angular rate and specific force of the board."""
        self.begin_row(t_ns, IMU_KIND)
        self.put_vector(row[0], row[1], row[2], 0)
        self.put_vector(row[3], row[4], row[5], 3)
        self.n += 1

    def put_field(self, t_ns: int, row: Array) -> None:
        """Write the magnetic field that came with a sample."""
        self.begin_row(t_ns, MAG_KIND)
        self.put_vector(row[6], row[7], row[8], 0)
        self.n += 1

    def put_height(self, t_ns: int, alt: float) -> None:
        """Write a height of the barometer, m."""
        self.begin_row(t_ns, BARO_KIND)
        self.out[self.n, 0] = alt
        self.n += 1

    def put_heading(self, t_ns: int, heading: float, std: float) -> None:
        """Write a heading of the autopilot's, rad."""
        self.begin_row(t_ns, HEADING_KIND)
        self.out[self.n, 0] = heading
        self.out[self.n, 1] = std
        self.out[self.n, 2] = HEADING_SOURCE
        self.n += 1

    def put_position(self, t_ns: int, place: Array, std: tuple[float, ...]) -> None:
        """Write an autopilot's own position: degE7, degE7, mm and cm/s, and its one sigma."""
        self.begin_row(t_ns, GNSS_KIND)
        row = self.out[self.n]
        row[0] = radians(place[0] * 1e-7)
        row[1] = radians(place[1] * 1e-7)
        row[2] = place[2] * 1e-3
        for j in range(3):
            row[3 + j] = place[3 + j] * 1e-2
        row[6], row[7], row[8] = std
        row[FLAGS] = OWN_POSITION
        row[DECLINATION] = row[INCLINATION] = row[STRENGTH] = UNKNOWN
        self.n += 1


def radians(degrees: float) -> float:
    """Return what ``math.radians`` returns."""
    return float(degrees * DEGREE)
