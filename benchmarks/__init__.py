"""How long things take on this machine: ``make bench``. Not a test; ``accuracy`` is the other half.

flights    the data, from our own simulator
reference  a plain NumPy filter: what the compiled one is compared with
steps      microseconds per inertial sample: whole recordings, live, late
daemon     the real daemon on loopback: latency, load, start
logs       a telemetry log to CSV
"""
