"""Many logs: where they are, who runs the estimator over each, the tables of results, questions.

A log is a file or an object of a store; a task on one log depends on its content, the version and
the configuration alone. What one asks of one log is :mod:`ekf_companion.analysis`.
"""
