"""Rivals of our own estimator, each as its authors meant it, over the same events.

What all share
    solution     what every one of them gives: a table of estimates, covariances, what it fused
    strapdown    the motion: state, mechanisation, its Jacobian
    observation  what a sensor should read, and the Jacobian of that
    gate         whom to believe
    aiding       rows of a recording as observations
    course       events in order of the time when they were true, cut into intervals
    start        level, north and a fix to begin from
    consistency  errors measured by a filter's own covariance

The filters
    euler        the seed article's direct filter (euler_motion); as published (euler_article)
    iterated     LINS and FAST-LIO: gauss_newton on manifold, robocentric by anchored
    ukf          sigma points (cloud) on the manifold
    zupt         by zero velocity: detector, the first rest, closure of a walk
    ahrs         attitude alone, our own (ahrs_estimator, plumb, compass, gyroframe on readings);
                 the article's (ahrs_article), mahony, and vqf_adapter for the published package

What a flight shows of the state: observability (observability_walk, _motion, _report).

All are written for clarity, in NumPy, and run over a recording only; the estimator that flies is
:mod:`ekf_companion.core`. :mod:`ekf_companion.replay.filters_by_name` knows them by name.
"""
