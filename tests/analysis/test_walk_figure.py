import numpy as np
import pytest

from ekf_companion.analysis import walk_figure
from ekf_companion.errors import CompanionError
from ekf_companion.filters import mahony, zupt
from tests.filters import walks


@pytest.fixture(scope="module")
def solution():
    return zupt.run(walks.make(np.random.default_rng(0), rate=100.0, strides=2).events)


def test_a_walk_is_drawn(tmp_path, solution):
    pytest.importorskip("matplotlib")
    walk_figure.plot(tmp_path / "walk.png", [solution, solution], "a walk")
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")


def test_a_figure_without_a_folder_is_refused(tmp_path, solution):
    pytest.importorskip("matplotlib")
    with pytest.raises(CompanionError, match="cannot be written: No such file"):
        walk_figure.plot(tmp_path / "none" / "walk.png", [solution], "a walk")


def test_attitude_alone_is_no_walk(tmp_path, solution):
    pytest.importorskip("matplotlib")
    events = walks.make(np.random.default_rng(0), rate=100.0, strides=2).events
    turning = mahony.run(events)
    walk_figure.plot(tmp_path / "alone.png", [solution], "a walk")
    walk_figure.plot(tmp_path / "both.png", [solution, turning], "a walk")
    assert (tmp_path / "both.png").read_bytes() == (tmp_path / "alone.png").read_bytes()
    with pytest.raises(CompanionError, match="has a position to draw"):
        walk_figure.plot(tmp_path / "none.png", [turning], "a walk")
