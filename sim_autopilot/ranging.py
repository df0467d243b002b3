"""A radio on the vehicle that ranges anchors in turn: RANGING_BEACON, as of ultra-wideband."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.nav.earth import LocalFrame
from sim_autopilot.component import Component, ComponentFaults
from sim_autopilot.config import HomeConfig
from sim_autopilot.flight import Motion, Vector

_ABOVE_SEA = 1
"""RANGING_BEACON_ALT_TYPE."""
COMPONENT = 25
"""MAV_COMP_ID_USER1: none is of ranging radios."""
PLACES: tuple[Vector, ...] = tuple(
    (north, east, down)
    for north in (-30.0, 30.0)
    for east in (-30.0, 30.0)
    for down in (-1.0, -9.0)
)
"""Of the anchors: north, east, down of home, m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RangingFaults(ComponentFaults):
    """What is wrong with it; each as by default is nothing."""

    frame_n: Vector = (0.0, 0.0, 0.0)
    """All anchors are said to be so far from where they are, m."""
    yaw: float = 0.0
    """They are said to be turned about home by so much, rad."""
    misplaced: Mapping[int, Vector] = field(default_factory=dict)
    """Single ones are said to be so far from where they are, m, by their numbers."""
    scale: float = 1.0
    """By which all ranges are too long."""
    drift: float = 0.0
    """By which they become longer, m/s."""
    hidden: Mapping[int, float] = field(default_factory=dict)
    """Those of single ones are longer by so much, m: something stands between."""
    detours: float = 0.0
    """Share of the ranges that come by a detour, up to 10 m longer."""


class RangingRadio(Component):
    """One such radio, as a peer of a link."""

    def __init__(
        self,
        motion: Callable[[], Motion],
        *,
        rate: float = 40.0,
        noise: float = 0.07,
        bias: float = 0.15,
        home: HomeConfig | None = None,
        faults: RangingFaults | None = None,
        seed: int = 0,
    ) -> None:
        """Range the anchors in turn.

        Args:
            motion: The truth of now.
            rate: Ranges in a second, Hz.
            noise: One sigma of the white error, m: two-way ranges in a room, measured.
            bias: By which all ranges are too long, m: the delay of the electronics.
            home: Where the anchors are about.
            faults: What is wrong with it.
            seed: Of what is random in that.
        """
        self._faults = faults or RangingFaults()
        super().__init__(motion, rate, COMPONENT, self._faults, seed)
        self._noise, self._bias, self._turn = noise, bias, 0
        home = home or HomeConfig()
        self._frame = LocalFrame(math.radians(home.lat), math.radians(home.lon), home.alt)

    def _said(self, number: int) -> Vector:
        """Return where an anchor is said to be: latitude, longitude, rad, and altitude, m."""
        c, s = math.cos(self._faults.yaw), math.sin(self._faults.yaw)
        north, east, down = PLACES[number]
        moved_n = np.add(self._faults.frame_n, self._faults.misplaced.get(number, (0.0, 0.0, 0.0)))
        place_n = np.add(moved_n, (c * north - s * east, s * north + c * east, down))
        lat, lon, alt = (float(one[0]) for one in self._frame.to_geodetic(place_n[None]))
        return lat, lon, alt

    def _say(self, true: Motion, since: float, stamp_us: int) -> bytes:
        faults, number = self._faults, self._turn % len(PLACES)
        self._turn += 1
        far = float(np.linalg.norm(np.subtract(true.pos_n, PLACES[number])))
        read = faults.scale * far + self._bias + faults.drift * since
        read += faults.hidden.get(number, 0.0)
        if true is not self._frozen:
            read += self._noise * self._rng.standard_normal()
            read += self._rng.uniform(0.0, 10.0) * (self._rng.random() < faults.detours)
        lat, lon, alt = self._said(number)
        return self._sender.message(
            "RANGING_BEACON",
            time_usec=stamp_us,
            beacon_id=number,
            range=round(max(read, 0.0) * 1e3),
            lat=round(math.degrees(lat) * 1e7),
            lon=round(math.degrees(lon) * 1e7),
            alt=alt,
            alt_type=_ABOVE_SEA,
            range_accuracy=2**32 - 1,
            sequence=self._turn % 256,
        )
