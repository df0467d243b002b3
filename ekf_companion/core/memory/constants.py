"""Numbers that several files of the kernel share; ``setup.py`` makes ``constants.pxd`` from it."""

import math

PI = math.pi
NAN = math.nan
"""What is not known."""
NEVER = -1e18
"""Time of what has not happened, ns; longer ago than any flight."""
EARTH_RATE = 7.292115e-5
"""Rate at which the Earth turns, rad/s (WGS-84)."""
UNKNOWN_ANGLE = 3.29
"""Variance of an angle that may be any: pi^2 / 3, rad^2."""
THREE_SIGMA2 = 9.0
"""Square of three sigma: what is larger is hardly of that variance."""
EVEN = 0.5
"""Probability from which on something is more likely wrong than right."""
UPRIGHT = 0.7071
"""Least cosine of the tilt at which what looks down is taken to meet the ground below: 45 deg, as
both autopilots have it (PX4's ``range_cos_max_tilt``, ArduPilot's ``DCM33FlowMin``)."""
SETTLING = 0.1
"""Rate at which a receiver settles again, 1/s: between the two shorter times in which it may do so
after its first fix, 5 and 17 s."""
FADES = 60.0
"""Time constant with which it is forgotten that a source has failed, s."""
FROZEN = 1e9
"""Repeats of a fix that stand for a receiver that was found to be frozen."""
SHORTEST_GAIN = 0.7e9
"""Between the fixes by which a delay or a lag is learnt, ns: long enough for the velocity to
change."""
SAME_CAUSE = 2.0
"""Time within which the refusals of two measurements of a receiver have one cause, s."""
WITHOUT_FIX = 2.0
"""Time without the receiver after which it neither speaks against an aid nor holds ours, s."""
