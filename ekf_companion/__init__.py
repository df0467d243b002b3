"""State estimation on a drone's companion computer: MAVLink in, ODOMETRY out.

Conventions, stated once
    Frames: ``n`` is north-east-down at the vehicle, ``b`` the body (forward-right-down),
    ``e`` earth-centred earth-fixed. A vector carries its frame: ``vel_n``, ``accel_b``.
    ``C_nb`` and ``q_nb`` turn b into n. Quaternions are Hamilton, ``(w, x, y, z)``.
    Position is metres north, east and down of a WGS-84 origin, along the radii of curvature
    there (:class:`ekf_companion.nav.earth.LocalFrame`); altitude is above mean sea level.
    Units are SI and radians; a suffix marks the exception, at the border only.
    Time is ``int`` nanoseconds: ``t_ns`` on the autopilot's clock, ``now_ns`` on ours.

Rooms, from the bottom up; imports point down only
    nav        the vocabulary: rotations, the Earth, what a sensor said, what is estimated
    core       the estimator, compiled ahead of time: one step, in order of time
    mavlink    bytes and times in, measurements out, and back; no socket and no clock
    filters    the filters of the articles that this grew from, one file each
    logs       one file per recorded format
    link       serial, UDP and TCP, kept open
    config     YAML in, frozen settings out
    engine     one vehicle's estimator on one link, without I/O
    replay     logs in, estimates out
    status     one Snapshot: what the status, the metrics and the doctor read
    calibrate  numbers of the configuration, measured from logs
    review     what a log is good for: its sensors, its estimate, a verdict
    arrays     arrays or samples of your own in, a trajectory out
    analysis   what one asks of estimates: scores, comparisons, figures
    daemon     the shells of the service: loop, files, HTTP, systemd
    doctor     what is wrong on this link, and what to do
    cli        the commands

As a library
    ``estimate`` takes arrays and returns a trajectory, ``Stream`` takes sample by sample,
    ``Board`` speaks with the daemon on the same board;
    ``open_log`` reads a recording, ``run_filter`` takes a filter through it, ``OwnAid`` is a
    measurement of your own.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ekf_companion.version import __version__

if TYPE_CHECKING:
    from ekf_companion.arrays.board import Board, BoardEstimate
    from ekf_companion.arrays.estimates import Estimates
    from ekf_companion.arrays.run import estimate
    from ekf_companion.arrays.stream import Stream, StreamEstimate
    from ekf_companion.arrays.types import (
        Fixes,
        Headings,
        Heights,
        MagneticField,
        Units,
    )
    from ekf_companion.filters.own_aid import OwnAid
    from ekf_companion.replay.filters_by_name import FilterName, run_filter
    from ekf_companion.replay.pose_aid import with_poses
    from ekf_companion.replay.read import read as open_log

__all__ = [
    "Board",
    "BoardEstimate",
    "Estimates",
    "FilterName",
    "Fixes",
    "Headings",
    "Heights",
    "MagneticField",
    "OwnAid",
    "Stream",
    "StreamEstimate",
    "Units",
    "__version__",
    "estimate",
    "open_log",
    "run_filter",
    "with_poses",
]
_PLACES = {
    "Board": ("arrays.board", "Board"),
    "BoardEstimate": ("arrays.board", "BoardEstimate"),
    "Estimates": ("arrays.estimates", "Estimates"),
    "FilterName": ("replay.filters_by_name", "FilterName"),
    "Fixes": ("arrays.types", "Fixes"),
    "Headings": ("arrays.types", "Headings"),
    "Heights": ("arrays.types", "Heights"),
    "MagneticField": ("arrays.types", "MagneticField"),
    "OwnAid": ("filters.own_aid", "OwnAid"),
    "Stream": ("arrays.stream", "Stream"),
    "StreamEstimate": ("arrays.stream", "StreamEstimate"),
    "Units": ("arrays.types", "Units"),
    "estimate": ("arrays.run", "estimate"),
    "open_log": ("replay.read", "read"),
    "run_filter": ("replay.filters_by_name", "run_filter"),
    "with_poses": ("replay.pose_aid", "with_poses"),
}


def __getattr__(name: str) -> Any:
    """Import what a library's user asks for, and not before: the daemon starts without it."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PLACES[name]
    return getattr(import_module(f"{__name__}.{module}"), attribute)


def __dir__() -> list[str]:
    """Return what a library's user may want, and Tab completes."""
    return __all__
