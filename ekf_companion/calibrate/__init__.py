"""Settings of the configuration measured from the user's own logs: noise, delay, magnetism.

Each calibration turns a recording into a :class:`ekf_companion.calibrate.result.Result`, or raises
a sentence that says why this log does not allow it. No figures: :mod:`ekf_companion.analysis`.
"""
