"""Property tests repeat the same examples, so that a checkout passes or fails for good.

``make explore`` looks for new ones.
"""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

from tests.paths import DATA

# Before NumPy is imported, here and in every child: its threads gain nothing on our small
# matrices, and beside other work they spin away two thirds of the processor's time.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

settings.register_profile("repeat", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=2000, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeat"))


@pytest.fixture(scope="session")
def flight() -> Callable[[str], Path]:
    """Return a function from a name to a recorded flight; it skips the test where there is none."""

    def find(name: str) -> Path:
        if not (DATA / name).is_file():
            pytest.skip(f"the recorded flight {name} is not on this machine")
        return DATA / name

    return find
