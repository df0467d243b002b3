"""State estimation on a drone's companion computer: MAVLink in, ODOMETRY out.

Conventions, stated once
    Frames: ``n`` is north-east-down at the vehicle, ``b`` the body (forward-right-down),
    ``e`` earth-centred earth-fixed. A vector carries its frame: ``vel_n``, ``accel_b``.
    ``C_nb`` and ``q_nb`` turn b into n. Quaternions are Hamilton, ``(w, x, y, z)``.
    Position is metres north, east and down of a WGS-84 origin, along the radii of curvature
    there (:class:`ekf_companion.nav.earth.LocalFrame`); altitude is above mean sea level.
    Units are SI and radians; a suffix marks the exception, at the border only.
    Time is ``int`` nanoseconds: ``t_ns`` on the autopilot's clock, ``now_ns`` on ours.

Rooms
    nav       the vocabulary: rotations, the Earth, what a sensor said, what is estimated
    core      the estimator, compiled ahead of time: one step, in order of time
    mavlink   bytes and times in, measurements out, and back; no socket and no clock
    logs      one file per recorded format
    pipeline  the heart: measurement in, estimate out
    smoothing the pipeline over a recording, and back
    calibrate numbers of the configuration, measured from logs
    checkpoint, resumption        the state as bytes, and who may go on from it
    link, keeper, service, convert, cli   the shells, which alone open, await, sleep and print
"""

__version__ = "0.1.0"
