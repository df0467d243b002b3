"""What the estimator says: an estimate with its status and reasons, and ODOMETRY's numbers.

It reads the state and changes nothing of it.
"""
