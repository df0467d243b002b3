"""How long things take on this machine: ``make bench``. Not a test; ``accuracy`` is the other half.

flights    the data, from our own simulator
reference  a plain NumPy filter: what the compiled one is compared with
steps      microseconds per inertial sample: whole recordings, live, late
daemon     the real daemon on loopback: latency, load, start
logs       a telemetry log to CSV

How good the estimate is: ``make accuracy``, the tables of docs/ACCURACY.md.

accuracy     runs the parts; cases, evidence, copter: recorded flights
campaign     many seeded flights in pieces, and their errors by block; matched: their settings
consistency  NEES and NIS over flights
seed         the seed article's flight (seed_flight), its bound and a reference (seed_reference)
outages      drift without GNSS, and whether sigma covers it
lies         receivers that are wrong
arrival      order, number and delay of messages
compassless  flight without a compass, or with a wrong one

What it withstands: ``make soak``, the tables of docs/RELIABILITY.md.

soak         hours of flight with all that goes wrong
soak_flight  one of them, and what the process kept; soak_daemon: the daemon, in real time

How the rival filters do beside ours: ``make filters``, the tables of docs/FILTERS.md.

filters      the parts: recorded, seed, campaign, attitude, walks
convergence, room, filter_consistency   the iterated filter: bad starts, a lidar, NEES
unscented    the unscented filter beside the linear one, bad starts too
steep, euler_slips                      the Euler filter: pitch, the article's two slips
observability                           the seed's flight
"""
