from collections.abc import Callable
from pathlib import Path

import pytest

FLIGHTS = Path(__file__).parents[3] / "shared" / "data"


@pytest.fixture(scope="session")
def flight() -> Callable[[str], Path]:
    """Give the path of a recorded flight, or skip the test where the recordings are not."""

    def find(name: str) -> Path:
        if not (FLIGHTS / name).is_file():
            pytest.skip(f"the recorded flight {name} is not on this machine")
        return FLIGHTS / name

    return find
