"""The daemon's state: one Snapshot, and the verdict, metrics and JSON made from it.

Whatever reports the daemon's state (status, metrics, doctor, tests) reads it here; nothing here
acts on the estimator.
"""
