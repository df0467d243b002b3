"""The estimator: what depends on probability, and the order of time. Compiled ahead of time."""
