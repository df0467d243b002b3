"""Missions: what is uploaded for AUTO."""

from __future__ import annotations

import numpy as np

from benchmarks.sitl.place import HOME, by_ardupilot

Item = tuple[int, tuple[float, float, float, float], tuple[float, float, float]]
"""Command, its first four parameters; latitude and longitude, deg, and height above home, m."""
_WAYPOINT, _LOITER, _RETURN, _TAKEOFF, _SPEED = 16, 17, 20, 22, 178


def _item(command: int, north: float, east: float, height: float, *values: float) -> Item:
    place = by_ardupilot(np.array([[north, east, 0.0]]), HOME)
    four = (*values, 0.0, 0.0, 0.0, 0.0)
    here = float(place.lat[0]), float(place.lon[0]), height
    return command, (four[0], four[1], four[2], four[3]), here


def wing() -> list[Item]:
    """Return a take-off, a box of four waypoints and circles of 60 m."""
    corners = ((250.0, 0.0), (250.0, 200.0), (-50.0, 200.0), (0.0, -50.0))
    return [
        _item(_WAYPOINT, 0.0, 0.0, 0.0),
        _item(_TAKEOFF, 120.0, 0.0, 50.0, 12.0),
        *(_item(_WAYPOINT, north, east, 80.0) for north, east in corners),
        _item(_LOITER, 0.0, 0.0, 80.0, 0.0, 0.0, 60.0),
    ]


def legs() -> list[Item]:
    """Return a take-off, 600 m out and 200 m across at 13 m/s; RTL is ordered at the end."""
    return [
        _item(_WAYPOINT, 0.0, 0.0, 0.0),
        _item(_TAKEOFF, 0.0, 0.0, 20.0),
        _item(_SPEED, 0.0, 0.0, 0.0, 1.0, 13.0, -1.0),
        _item(_WAYPOINT, 600.0, 0.0, 20.0),
        _item(_WAYPOINT, 600.0, 200.0, 20.0),
    ]
