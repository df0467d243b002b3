"""Metres as the autopilots count them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.projection import ARDUPILOT, PX4

ZURICH = math.radians(47.397743), math.radians(8.545594)
places = st.floats(-70.0, 70.0).map(math.radians), st.floats(-180.0, 179.99).map(math.radians)
metres = st.floats(-50e3, 50e3)


@pytest.mark.parametrize("projection", [ARDUPILOT, PX4])
@given(lat=places[0], lon=places[1], north=metres, east=metres)
def test_there_and_back_is_the_same_place(projection, lat, lon, north, east):
    there = projection.to_geodetic(north, east, lat, lon)
    assert projection.to_metres(*there, lat, lon) == pytest.approx((north, east), abs=1e-4)


def test_ardupilots_degree_of_latitude_has_111318845_millimetres():
    """``LOCATION_SCALING_FACTOR`` is 0.011131884502145034 m for 1e-7 deg."""
    north, east = ARDUPILOT.to_metres(ZURICH[0] + math.radians(1e-3), ZURICH[1], *ZURICH)
    assert north == pytest.approx(1e4 * 0.011131884502145034, rel=1e-9)
    assert east == 0.0


def test_px4s_metres_are_those_of_the_great_circle():
    """Haversine formula on 6371 km, from the source of neither."""
    lat, lon = ZURICH[0] + 4e-4, ZURICH[1] - 7e-4
    h = math.sin(2e-4) ** 2 + math.cos(ZURICH[0]) * math.cos(lat) * math.sin(3.5e-4) ** 2
    distance = 2.0 * 6371000.0 * math.asin(math.sqrt(h))
    assert math.hypot(*PX4.to_metres(lat, lon, *ZURICH)) == pytest.approx(distance, rel=1e-9)


@pytest.mark.parametrize("projection", [ARDUPILOT, PX4])
def test_over_the_date_line_the_way_is_short(projection):
    edge = math.radians(-17.0), math.radians(179.9999)
    _, east = projection.to_metres(edge[0], math.radians(-179.9999), *edge)
    assert 0.0 < east < 30.0


def test_on_the_ellipsoid_the_spheres_are_off_by_metres_at_600_m():
    lat, lon, _ = (
        np.asarray(x).item()
        for x in LocalFrame(*ZURICH, 489.4).to_geodetic(np.array([600.0, 600.0, 0.0]))
    )
    for projection in (ARDUPILOT, PX4):
        off = np.subtract(projection.to_metres(lat, lon, *ZURICH), 600.0)
        assert 0.5 < np.abs(off).max() < 3.0
