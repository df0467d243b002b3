import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ekf_companion.nav import earth
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.magnetic import magnetic_field

latitudes = st.floats(-1.4, 1.4)
longitudes = st.floats(-np.pi, np.pi - 1e-9)


def to_ecef(lat: float, lon: float, alt: float) -> np.ndarray:
    _, transverse = earth.radii(lat)
    flat = (float(transverse) + alt) * np.cos(lat)
    up = (float(transverse) * (1.0 - earth.ECCENTRICITY_SQUARED) + alt) * np.sin(lat)
    return np.array([flat * np.cos(lon), flat * np.sin(lon), up])


@given(
    latitudes,
    longitudes,
    st.floats(-100.0, 9000.0),
    st.lists(st.floats(-5e3, 5e3), min_size=3, max_size=3),
)
def test_local_coordinates_come_back(lat, lon, alt, pos):
    frame = LocalFrame(lat, lon, alt)
    back = frame.to_ned(*frame.to_geodetic(np.array(pos)))
    np.testing.assert_allclose(back, pos, atol=1e-6)  # 1e-6 m is 1.6e-13 rad


@given(latitudes, longitudes)
def test_metres_of_the_local_frame_are_metres_on_the_ellipsoid(lat, lon):
    frame = LocalFrame(lat, lon, 200.0)
    here = to_ecef(lat, lon, 200.0)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 10.0
        there = to_ecef(*(float(part) for part in frame.to_geodetic(step)))
        assert np.linalg.norm(there - here) == pytest.approx(10.0, rel=1e-5)


def test_the_date_line_is_no_border():
    frame = LocalFrame(0.1, np.pi - 1e-7, 0.0)
    ned = frame.to_ned(0.1, -np.pi + 1e-7, 0.0)
    assert 0.0 < ned[1] < 2.0


def test_gravity_is_the_published_one():
    # NIMA TR8350.2, table 3.4: normal gravity at the equator and at the pole
    assert earth.gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert earth.gravity(np.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-9)


def test_the_earth_turns_east():
    assert earth.earth_rate_n(0.0).tolist() == [earth.ROTATION_RATE, 0.0, -0.0]
    rate = earth.transport_rate_n(0.5, 0.0, np.array([0.0, 100.0, 0.0]))
    assert rate[0] > 0.0
    assert rate[2] < 0.0


def test_the_field_is_that_of_the_world_magnetic_model():
    # WMM2025 report, test values for 2025.0 are at 0 or 100 km; here the plausible magnitudes
    declination, inclination, strength = magnetic_field(np.radians(47.4), np.radians(8.54), 2026.0)
    assert np.degrees(declination) == pytest.approx(3.5, abs=0.3)
    assert np.degrees(inclination) == pytest.approx(63.5, abs=0.3)
    assert strength == pytest.approx(0.4836, abs=0.003)
