"""The estimator: an error-state Kalman filter over a window of events. Compiled ahead of time.

``state`` and ``scratch`` declare its memory; ``timeline`` keeps the order of events, ``kernel``
takes one step: ``propagate``, then each event by its aid (``gnss``, ``heading``, ``baro``,
``rest``), through ``observe`` (innovation, H, R), ``gate`` and ``correct``. No I/O, no clock, no
MAVLink.
"""

import warnings

from ekf_companion.errors import how_to_compile, is_compiled

if not is_compiled("ekf_companion.core.kernel"):
    from ekf_companion.core import uncompiled

    warnings.warn(f"{how_to_compile()}; interpreted, it is some hundred times slower", stacklevel=2)
    uncompiled.install()
