"""The estimator: an error-state Kalman filter over a window of events. Compiled ahead of time.

Eight wings, of which each imports only those before it: ``memory`` declares what is kept,
``settings`` what may be set; ``filter`` propagates and corrects, ``trust`` judges, ``aids`` say
what sensors should read; ``start`` levels and begins, ``output`` writes estimates, and ``order``
takes each event at its time. ``rts`` smooths above them all. No I/O, no clock, no MAVLink.
"""

import warnings

from ekf_companion.errors import how_to_compile, is_compiled

if not is_compiled("ekf_companion.core.order.step"):
    from ekf_companion.core import uncompiled

    warnings.warn(f"{how_to_compile()}; interpreted, it is some hundred times slower", stacklevel=2)
    uncompiled.install()
