"""The estimator: an error-state Kalman filter over a window of events. Compiled ahead of time.

``state`` and ``scratch`` declare its memory; ``timeline`` keeps the order of events, ``kernel``
takes one step: ``propagate``, then each event by its aid (``gnss``, ``heading``, ``baro``,
``rest``), through ``observe`` (innovation, H, R), ``gate`` and ``correct``. No I/O, no clock, no
MAVLink.
"""

from importlib.util import find_spec

_kernel = find_spec("ekf_companion.core.kernel")
if _kernel is not None and (_kernel.origin or "").endswith(".py"):
    from ekf_companion.core import uncompiled

    uncompiled.install()
