"""Which tiles lie under a track, and where."""

import pytest

from ekf_companion.analysis.map_tiles import FINEST, tiles

ADDRESS = "https://tiles.example.org/{z}/{x}/{y}.png"


def zoom_of(tile):
    return int(tile.url.split("/")[3])


@pytest.mark.parametrize("span", [0.0, 1e-5, 3e-4, 0.01, 0.5, 5.0, 100.0])
@pytest.mark.parametrize(
    ("lat", "lon"), [(47.39, 8.54), (-35.36, 149.16), (0.0, 0.0), (64.0, -179.0)]
)
def test_they_cover_the_track_with_a_handful_of_pictures(lat, lon, span):
    east = min(lon + span, 180.0)
    north = min(lat + 0.2 * span, 84.0)
    found = tiles(ADDRESS, lat, lon, north, east)
    assert 1 <= len(found) <= 80
    assert min(one.south for one in found) <= lat
    assert max(one.north for one in found) >= north
    assert min(one.west for one in found) <= lon
    assert max(one.east for one in found) >= east - 1e-9
    assert {zoom_of(one) for one in found} <= set(range(FINEST + 1))
    assert len({one.url for one in found}) == len(found)


def test_a_tile_is_the_one_that_the_servers_have_there():
    """Column and row by the formula of https://wiki.openstreetmap.org/wiki/Slippy_map_tilenames."""
    found = tiles(ADDRESS, 52.5163, 13.3777, 52.5163, 13.3777)
    (under,) = (
        one for one in found if one.south <= 52.5163 < one.north and one.west <= 13.3777 < one.east
    )
    assert under.url == "https://tiles.example.org/18/140813/85975.png"


@pytest.mark.parametrize("lat", [-89.0, 86.0])
def test_near_a_pole_and_around_the_world_there_is_no_map(lat):
    assert tiles(ADDRESS, lat, 0.0, lat, 0.0) == []
    assert tiles(ADDRESS, 10.0, -179.9, 10.0, 179.9) == []
