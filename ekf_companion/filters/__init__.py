"""The filters of the articles, as their authors meant them, over the same events as our estimator.

What they share
    inertial      inertial samples: screening, gaps, rest, levelling
    gap           what a gap in the samples hides
    marg          the same with the magnetic field, for attitude alone
    strapdown     the motion: state, integration, transition, noise
    observation   models of position, velocity and azimuth, with their Jacobians
    gate          chi-square gate with time-outs
    aiding        observations from the rows of a recording
    alignment     the first estimate: level, north, a fix
    sequence      a recording as intervals and aids in order of time, and a filter over it
    solution      the result: table of estimates, covariances, counts

The filters
    euler         the seed article's direct filter; with its constants (euler_article)
    iterated      LINS and FAST-LIO: gauss_newton on a manifold; robocentric
    ukf           unscented, by sigma_points on the same manifold
    zupt          zero velocity updates, by zupt_detector
    ahrs          attitude alone, our own (ahrs_sensors); the article's (ahrs_article); mahony;
                  vqf_adapter for the published package

All are written for clarity, in NumPy, and run over a recording only; the estimator that flies is
:mod:`ekf_companion.core`. :mod:`ekf_companion.replay.filters_by_name` selects them by name.
"""
