"""Motion, covariance and correction of the error-state filter: true for any sensor.

No sensor, no decision and no noise learnt: those are of ``aids`` and ``trust``.
"""
