"""A map under a track: tiles of a server in the web's Mercator projection.

Source: https://wiki.openstreetmap.org/wiki/Slippy_map_tilenames.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import asinh, atan, ceil, degrees, floor, log2, pi, radians, sinh, tan
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import Trajectory

NORTHERNMOST = 85.0
"""deg; the map ends at 85.05."""
FINEST = 18
"""Most servers have no finer tiles."""
ACROSS = 3
"""Approximate number of tiles along a track's longer side: 256 pixels each."""
MARGINS = 0.8, 0.35
"""Shares of the longer side that are added to the track at its sides, and above and below it."""


class Tile(NamedTuple):
    """One picture, and its extent, deg."""

    url: str
    south: float
    west: float
    north: float
    east: float


def tiles(address: str, south: float, west: float, north: float, east: float) -> list[Tile]:
    """Return the tiles under a rectangle and its margins, deg; none beyond the map.

    Args:
        address: Of a tile, with {z}, {x} and {y} for its zoom, column and row.
        south: Of the rectangle, deg; likewise the others.
        west: A rectangle over the antimeridian has no tiles.
        north: Likewise.
        east: Likewise.
    """
    if not -NORTHERNMOST < south <= north < NORTHERNMOST or east - west > 180.0:
        return []
    left, right = _column(west), _column(east)
    upper, lower = _row(north), _row(south)
    size = max(right - left, lower - upper, 1e-9)
    zoom = max(min(FINEST, floor(log2(ACROSS / size))), 0)
    count = 2**zoom
    beside, above = (margin * max(size, 1.0 / count) for margin in MARGINS)
    columns = _numbers(left - beside, right + beside, count)
    rows = _numbers(upper - above, lower + above, count)
    return [
        Tile(
            url=address.replace("{z}", str(zoom)).replace("{x}", str(x)).replace("{y}", str(y)),
            south=_lat((y + 1) / count),
            west=360.0 * x / count - 180.0,
            north=_lat(y / count),
            east=360.0 * (x + 1) / count - 180.0,
        )
        for x in columns
        for y in rows
    ]


def draw(
    plot: Any, address: str, credit: str, frame: LocalFrame, tracks: Sequence[Trajectory]
) -> None:
    """Draw a map below tracks in a Bokeh figure of metres; the browser fetches its pictures."""
    from bokeh.models import Title

    # Not as far as a single position that leapt away
    lat = np.rad2deg(np.concatenate([np.percentile(one.lat, (1, 99)) for one in tracks]))
    lon = np.rad2deg(np.concatenate([np.percentile(one.lon, (1, 99)) for one in tracks]))
    found = tiles(address, lat.min(), lon.min(), lat.max(), lon.max())
    if not found:
        return
    corners = np.deg2rad([[one.south, one.west, one.north, one.east] for one in found])
    level = np.zeros(len(found))
    south_west = frame.to_ned(corners[:, 0], corners[:, 1], level)
    north_east = frame.to_ned(corners[:, 2], corners[:, 3], level)
    # The axes show the tracks, not all of the map
    for span in (plot.x_range, plot.y_range):
        span.renderers = list(plot.renderers)
    plot.image_url(
        url=[one.url for one in found],
        x=south_west[:, 1],
        y=south_west[:, 0],
        w=north_east[:, 1] - south_west[:, 1],
        h=north_east[:, 0] - south_west[:, 0],
        anchor="bottom_left",
        global_alpha=0.7,
        level="image",
    )
    words = credit or urlsplit(address).hostname
    plot.add_layout(Title(text=f"map: {words}", text_font_size="8pt", align="right"), "below")


def _numbers(begin: float, end: float, count: int) -> range:
    """Return the numbers of the tiles between two positions on the map, of which 1 is the end."""
    return range(max(floor(begin * count), 0), min(ceil(end * count), count))


def _column(lon: float) -> float:
    return lon / 360.0 + 0.5


def _row(lat: float) -> float:
    return 0.5 - asinh(tan(radians(lat))) / (2.0 * pi)


def _lat(row: float) -> float:
    return degrees(atan(sinh(pi * (1.0 - 2.0 * row))))
