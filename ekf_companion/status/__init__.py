"""What the daemon knows of itself: one Snapshot, and its verdict, metrics and JSON.

Whoever tells others how we are (status, page, metrics, doctor, tests) reads it here; nothing here
acts on the estimator.
"""
