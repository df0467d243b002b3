"""An independent truth: simulated flights with faults that lead an estimator astray, and a judge.

The generator shares no code with the estimator or with `sim_autopilot`: `earth` is its own WGS-84,
`motion` turns a path into exact inertial increments, `paths` draws the paths, `sensors` adds errors
and `log` writes what a logger would have written. `cases` names the flights, `judge` scores an
estimate. Only `__main__` knows the estimator, by its converter.

Frames: e is ECEF; t the tangent plane at the start (north, east, down there); n the local north,
east, down; b the body, forward, right, down. `C_nb` turns b into n. SI units and radians; times are
in s since the log's first moment, stamps in us.
"""
