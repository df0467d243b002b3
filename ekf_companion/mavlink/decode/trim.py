"""ArduPilot's board trim: its inertial sensors and magnetometer come in the axes of the board.

Its own attitude is that of the vehicle, by AHRS_TRIM_X and AHRS_TRIM_Y, and so is ours once they
are known. A mounting that changed in flight would look like a tilt of the vehicle, so that what
comes late counts from the next start only.
"""

from __future__ import annotations

import math

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Family, Measurements
from ekf_companion.mavlink.decode.state import TrimState
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.mounting import LARGEST_TRIM, trim_matrix

NAMES = ("AHRS_TRIM_X", "AHRS_TRIM_Y")
LATEST_NS = 3 * SECOND_NS
"""After the first inertial sample: the answer to a request takes 0.1 s."""


class Trim(TrimState):
    """Rotates vectors from the board to the vehicle, as far as the autopilot says how."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._values: dict[str, float] = {}
        self.rows: list[list[float]] | None = None
        self.first_ns: int | None = None
        """When the first inertial sample was taken: from then on there is an estimate."""

    def forget(self) -> None:
        """Begin with a clock that began anew; the mounting is still the same."""
        self.first_ns = None

    @property
    def missing(self) -> tuple[str, ...]:
        """The parameters that an ArduPilot has not said yet."""
        if self._context.family is not Family.ARDUPILOT:
            return ()
        return tuple(name for name in NAMES if name not in self._values)

    def param_value(self, frame: Frame) -> Measurements:
        """Read PARAM_VALUE."""
        m = unpack(frame)
        name = m.param_id.decode("ascii", "replace")
        if self._context.family is not Family.ARDUPILOT or name not in NAMES:
            return []
        if not (math.isfinite(m.param_value) and abs(m.param_value) <= LARGEST_TRIM):
            return self._context.refuse(f"{name}: no trim")
        was, self._values[name] = self._values.get(name, 0.0), float(m.param_value)
        if was != self._values[name]:
            self._apply()
        return []

    def _apply(self) -> None:
        """Rotate by the values from now on, if nothing has been estimated without them."""
        latest_ns, first_ns = self._context.clock.latest_ns, self.first_ns
        if first_ns is not None and latest_ns is not None and latest_ns - first_ns > LATEST_NS:
            self._context.note_once(
                "AHRS_TRIM is told too late to count: roll and pitch are of the board until the "
                "next start, not of the vehicle"
            )
            return
        angles = [self._values.get(name, 0.0) for name in NAMES]
        self.rows = trim_matrix(*angles).tolist() if any(angles) else None
        if not self.missing and self.rows is not None:
            roll, pitch = map(math.degrees, angles)
            self._context.note_once(
                f"The board is mounted at roll {roll:.1f} and pitch {pitch:.1f} deg (AHRS_TRIM): "
                "its samples are turned into the axes of the vehicle"
            )

    def to_vehicle(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Return a vector of the board in the vehicle's axes."""
        if self.rows is None:
            return x, y, z
        a, b, c = ((row[0] * x + row[1] * y) + row[2] * z for row in self.rows)
        return a, b, c
