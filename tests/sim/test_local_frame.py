"""Metres from an origin, as each autopilot counts them."""

import math

import pytest

from ekf_companion.nav.earth import LocalFrame as Earth
from sim_autopilot.local_frame import LocalFrame
from sim_autopilot.personality import Kind

HERE = math.radians(47.4), math.radians(8.5), 488.0
KINDS = pytest.mark.parametrize("kind", list(Kind))


def frame(kind):
    return LocalFrame(kind=kind, lat=HERE[0], lon=HERE[1], alt=HERE[2])


@KINDS
@pytest.mark.parametrize("pos_n", [(0.0, 0.0, 0.0), (12.0, -30.0, -8.0), (2000.0, -2500.0, -120.0)])
def test_a_place_is_the_metres_that_it_was_made_of(kind, pos_n):
    own = frame(kind)
    assert own.to_ned(*own.to_geodetic(pos_n)) == pytest.approx(pos_n, abs=1e-4)


@pytest.mark.parametrize(
    ("kind", "pos_n", "off"),
    [
        # The radius of the sphere over that of curvature there
        (Kind.ARDUPILOT, (600.0, 0.0, 0.0), 0.8),
        (Kind.ARDUPILOT, (0.0, 600.0, 0.0), -1.2),
        (Kind.PX4, (600.0, 0.0, 0.0), 0.0),
        (Kind.PX4, (0.0, 3000.0, 0.0), -9.0),
    ],
)
def test_its_metres_are_not_those_of_the_ellipsoid(kind, pos_n, off):
    own, earth = frame(kind), Earth(*HERE)
    axis = 0 if pos_n[0] else 1
    metres = own.to_ned(*(float(value) for value in earth.to_geodetic(pos_n)))
    assert metres[axis] - pos_n[axis] == pytest.approx(off, abs=0.1)


def test_a_degree_is_111319_metres_to_ardupilot():
    own = frame(Kind.ARDUPILOT)
    north = own.to_ned(HERE[0] + math.radians(1e-2), *HERE[1:])[0]
    assert north == pytest.approx(1113.18845, abs=1e-4)


def test_to_px4_a_way_is_as_long_as_the_arc_on_its_sphere():
    own = frame(Kind.PX4)
    metres = own.to_ned(HERE[0], HERE[1] + 1e-3, HERE[2])
    arc = 2.0 * math.asin(math.cos(HERE[0]) * math.sin(0.5e-3))
    assert math.hypot(*metres[:2]) == pytest.approx(6371000.0 * arc, abs=1e-3)
