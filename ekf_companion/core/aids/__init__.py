"""What each sensor should read, and the states that come with it; one file a sensor.

An aid decides nothing of others: order and verdicts are of ``order``.
"""
