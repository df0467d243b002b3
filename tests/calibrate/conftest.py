from collections.abc import Callable
from pathlib import Path

import pytest

from tests.paths import DATA


@pytest.fixture(scope="session")
def flight() -> Callable[[str], Path]:
    """Give the path of a recorded flight, or skip the test where the recordings are not."""

    def find(name: str) -> Path:
        if not (DATA / name).is_file():
            pytest.skip(f"the recorded flight {name} is not on this machine")
        return DATA / name

    return find
