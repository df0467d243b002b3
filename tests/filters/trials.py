"""The recorded trials of BROAD, where they are."""

from functools import cache

import pytest

from ekf_companion.logs import broad
from tests.paths import DATA

FOLDER = DATA / "broad-attitude"
TRIALS = ("01_undisturbed_slow_rotation_A", "15_undisturbed_fast_translation_A")


@cache
def _read(path):
    return broad.read(path)


def trial(name):
    path = FOLDER / f"{name}.mat"
    if not path.is_file():
        pytest.skip(f"the recorded trial {name} is not on this machine")
    return _read(path)
