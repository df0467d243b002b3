"""A follower with geographic positions: an origin, a receiver, a barometer, texts for the pilot.

It has what both autopilots have in common; the selection of sources is in each one's own module
(:mod:`sim_autopilot.ekf3`, :mod:`sim_autopilot.ekf2`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.nav.arrays import Array
from sim_autopilot.arrival import Arrival
from sim_autopilot.flight import Fix
from sim_autopilot.follower import NEVER, POS, VEL, Follower, Motion, Tuning
from sim_autopilot.local_frame import LocalFrame
from sim_autopilot.personality import Kind

INFO, WARNING, CRITICAL = 6, 4, 2
"""MAV_SEVERITY."""
_GOOD_AFTER = 10.0
"""s of good fixes until a receiver is used (``calcGpsGoodToAlign``; EKF2_REQ_GPS_H)."""
_FIX_LOST = 1.0
"""s."""
_BARO_GAIN, _BARO_LIMIT = 0.1, 5.0
"""Of the barometer's offset while another source of height is used (``calcFiltBaroOffset``), m."""
_BARO_STD = 2.0
"""m (EK3_ALT_M_NSE; EKF2_BARO_NOISE is 3.5)."""
_NO_AID_STD = 10.0
"""m; of the position that is held while nothing aids (EK3_NOAID_M_NSE, EKF2_NOAID_NOISE)."""


class Text(NamedTuple):
    """A text for the pilot."""

    severity: int
    text: str


class Navigator(Follower):
    """One autopilot's filter with all that it needs for a geographic position."""

    kind: Kind
    is_external: bool
    """Whether it flies on ODOMETRY."""
    arrival: Arrival

    def __init__(self, tuning: Tuning, parameters: Mapping[str, float]) -> None:
        """Begin without an origin; parameters are read each time."""
        super().__init__(tuning)
        self.parameters = parameters
        self.origin: LocalFrame | None = None
        self.home: Array | None = None
        """In metres of the local frame; None: it was never armed."""
        self.last_fix: Fix | None = None
        self.shift_n = np.zeros(3)
        """Sum of all resets of the position, m: a controller moves its target along, or not."""
        self.is_origin_new = False
        """Whether the origin is to be told unasked."""
        self.misplaced = 0
        """Origins that came while positions of ODOMETRY were fused (PX4)."""
        self._texts: list[Text] = []
        self._good_since: float | None = None
        self._fix_t = self._vertical_t = NEVER
        self._ground: float | None = None
        """Altitude by the barometer at the start, m."""
        self._baro_offset = 0.0
        self._held_n = np.zeros(3)
        """Position that is held while nothing aids, m."""

    def texts(self) -> list[Text]:
        """Return the texts for the pilot, once."""
        texts, self._texts = self._texts, []
        return texts

    def send_text(self, severity: int, text: str) -> None:
        """Send the pilot a text with the next messages."""
        self._texts.append(Text(severity, text))

    def place(self, motion: Motion) -> tuple[float, float, float] | None:
        """Return latitude, longitude (rad) and altitude (m) of a motion; None: not known."""
        return None if self.origin is None else self.origin.to_geodetic(motion.pos_n)

    def set_home(self) -> None:
        """Set home to the present position."""
        self.home = self.motion().pos_n

    def set_origin(self, lat: float, lon: float, alt: float) -> bool:
        """Take an origin, rad and m; return whether it is accepted."""
        raise NotImplementedError

    def vision(self, m: Any, stamp: float) -> None:
        """Take a VISION_POSITION_ESTIMATE."""
        raise NotImplementedError

    def take_position(self, lat: float, lon: float, std: float) -> bool:
        """Move to a position from outside, rad, of one sigma, m; return whether it did."""
        return False

    def select(self, number: int) -> bool:
        """Switch to a set of sources; return whether there is such a set."""
        return False

    def status(self) -> dict[str, float] | None:
        """Return the fields of EKF_STATUS_REPORT; None: it sends none."""
        return None

    # Its own sensors

    def receiver(self, t: float, fix: Fix, stds: tuple[float, float, float]) -> None:
        """Fuse a fix that was true at t: sigmas of the horizontal, the height and the velocity."""
        self.last_fix = fix
        if fix.fix_type < 3:
            self._good_since = None
            return
        self._good_since = t if self._good_since is None else self._good_since
        self._fix_t = t
        if self.has_good_fix and self.origin is None:
            self._begin_at(fix)
        if self.origin is not None:
            at = max(t - 0.5 * self.tuning.step, self._horizon_t)
            pos_n = self.origin.to_ned(fix.lat, fix.lon, fix.alt)
            self._later(at, lambda: self._fuse_fix(pos_n, np.array(fix.vel_n), stds))

    def baro(self, t: float, alt: float) -> None:
        """Fuse an altitude of the barometer, m."""
        self._ground = alt if self._ground is None else self._ground
        height = alt - self._ground
        self._later(max(t, self._horizon_t), lambda: self._fuse_baro(height))

    @property
    def has_good_fix(self) -> bool:
        """Whether the receiver has been good for long enough, and still is."""
        now = self._t or 0.0
        is_good = self._good_since is not None and now - self._good_since >= _GOOD_AFTER
        return is_good and now - self._fix_t < _FIX_LOST

    def _begin_at(self, fix: Fix) -> None:
        """Set the origin by the receiver, so that the present position agrees with it."""
        raise NotImplementedError

    def _fuse_fix(self, pos_n: Array, vel_n: Array, stds: tuple[float, float, float]) -> None:
        raise NotImplementedError

    def _fuse_baro(self, height: float) -> None:
        raise NotImplementedError

    # What they do with it

    def _follow_baro(self, height: float) -> None:
        """Learn the barometer's offset, so that it can take over without a step."""
        apart = height + float(self.pos_n[2]) - self._baro_offset
        self._baro_offset += _BARO_GAIN * float(np.clip(apart, -_BARO_LIMIT, _BARO_LIMIT))

    def _fuse_baro_height(self, height: float) -> None:
        self._fuse_rows([POS.start + 2], np.array([-height - self.pos_n[2]]), _BARO_STD**2, 1e9)

    def _hold(self) -> None:
        """Hold the position, as there is no aid."""
        rows = [POS.start, POS.start + 1]
        self._fuse_rows(rows, self._held_n[:2] - self.pos_n[:2], _NO_AID_STD**2, 1e9)

    def _fuse_rows(self, rows: list[int], z: Array, R: float | Array, gate: float) -> float:
        """Fuse some states' errors together; return the squared test ratio, above 1: refused."""
        R = np.broadcast_to(np.asarray(R, dtype=float), (len(rows),))
        variance = self.P[rows, rows] + R
        ratio = float(np.sum(np.square(z)) / (gate**2 * np.sum(variance)))
        if ratio > 1.0:
            self.rejected += 1
            return ratio
        z = np.array(z, dtype=float)
        for k, row in enumerate(rows):
            H = np.zeros(15)
            H[row] = 1.0
            self._fuse_row(float(z[k]), H, float(R[k]))
            z -= self._dx[rows]
        return ratio

    def _set(self, rows: list[int], values: Array, variance: float | Array) -> None:
        """Set states of position or velocity, and their correlations to zero."""
        self.pos_n, self.vel_n = self.pos_n.copy(), self.vel_n.copy()
        for k, row in enumerate(rows):
            if row >= POS.start:
                self.shift_n[row - POS.start] += values[k] - self.pos_n[row - POS.start]
                self.pos_n[row - POS.start] = values[k]
            else:
                self.vel_n[row - VEL.start] = values[k]
        self.P[rows, :] = 0.0
        self.P[:, rows] = 0.0
        self.P[rows, rows] = variance
