"""The estimator: what depends on probability, and the order of time. Compiled ahead of time.

``state`` and ``scratch`` declare its memory; ``timeline`` keeps the order of events, ``kernel``
takes one step; ``observe`` says what a sensor should read, ``gate`` whom to believe, ``correct``
what follows. No I/O, no clock, no MAVLink.
"""

from importlib.util import find_spec

_kernel = find_spec("ekf_companion.core.kernel")
if _kernel is not None and (_kernel.origin or "").endswith(".py"):
    from ekf_companion.core import uncompiled

    uncompiled.install()
