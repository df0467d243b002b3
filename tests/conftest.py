"""Property tests repeat the same examples, so that a checkout passes or fails for good.

``make explore`` looks for new ones.
"""

import os

from hypothesis import settings

# Before NumPy is imported, here and in every child: its threads gain nothing on our small
# matrices, and beside other work they spin away two thirds of the processor's time.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

settings.register_profile("repeat", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=2000, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeat"))
