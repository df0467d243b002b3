"""What the daemon knows of itself: one Snapshot, and its verdict, metrics and JSON.

Whoever reports the daemon's state (status, metrics, doctor, tests) reads it here; nothing here acts
on the estimator.
"""
