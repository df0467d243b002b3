"""Arrays or samples of measurements in, a trajectory out: for those with neither a log nor a link.

Reads and refuses what a Python user gives; the estimator is that of ``engine``, the other filters
and the smoother are those of ``replay``, and what is doubtful about the sensors ``review`` says.
"""
