"""How long things take on this machine: ``python -m benchmarks.speed [PART ...] [--json FILE]``.

steps      microseconds per inertial sample: whole recordings, live, late; beside a plain NumPy
           filter (reference) on the same simulated flight (flights)
logs       a telemetry log to CSV
daemon     the real daemon on loopback: latency, load, start
"""
