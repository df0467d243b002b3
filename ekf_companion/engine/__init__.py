"""One vehicle's estimator on one link: measurements in, estimates and messages out.

Neither I/O nor a clock: bytes, events and ``now_ns`` come from the daemon, a log or a test.
"""
