"""Numbers of the configuration, measured from the user's own logs: noise, delay, magnetism.

Each calibration takes a log's events and gives a :class:`ekf_companion.calibrate.report.Result`,
or says in a sentence why this log cannot tell.
"""
