import numpy as np
import pytest

from ekf_companion import walk
from ekf_companion.errors import CompanionError
from ekf_companion.filters import zupt
from tests.filters import walks


@pytest.fixture(scope="module")
def solution():
    return zupt.run(walks.make(np.random.default_rng(0), rate=100.0, strides=2).events)


def test_a_walk_is_drawn(tmp_path, solution):
    pytest.importorskip("matplotlib")
    walk.plot(tmp_path / "walk.png", [solution, solution], "a walk")
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")


def test_a_figure_without_a_folder_is_refused(tmp_path, solution):
    pytest.importorskip("matplotlib")
    with pytest.raises(CompanionError, match="the figure cannot be written"):
        walk.plot(tmp_path / "none" / "walk.png", [solution], "a walk")
