"""Rivals of our own estimator, each as its authors meant it, over the same events.

    solution     what every one of them gives: a table of estimates, covariances, what it fused
    strapdown    the motion that all share: state, mechanisation, its Jacobian
    observation  what a sensor should read, and the Jacobian of that
    gate         whom to believe
    course       events in order of the time when they were true, cut into intervals; the start

One file per filter stands beside them. All are written for clarity, in NumPy, and run over a
recording only; the estimator that flies is :mod:`ekf_companion.core`.
"""
