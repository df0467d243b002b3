import numpy as np
import pytest

from sim_autopilot.faults.fault import parse
from sim_autopilot.faults.wire import Wire

MS = 1_000_000
FRAMES = [bytes([k % 256, k // 256]) * 10 for k in range(10_000)]
"""Ten seconds of one frame a millisecond."""


def passed(*texts, seed=1, way="out"):
    """Return arrival (ms) and number of each frame that comes out; -1: a changed one."""
    wire = Wire([parse(text) for text in texts], seed, zero_ns=0, way=way)
    found = []
    for k, frame in enumerate(FRAMES):
        wire.push(k * MS, frame)
        while (item := wire.pop(k * MS)) is not None:
            found.append(item)
    while (item := wire.pop(10**18)) is not None:
        found.append(item)
    number = {frame: k for k, frame in enumerate(FRAMES)}
    return np.array([(t / MS, number.get(frame, -1)) for t, frame in found]), found


def outside(rows, start=2000, end=5000):
    """Return the rows of frames that were sent before or after the fault."""
    return rows[(rows[:, 1] >= 0) & ((rows[:, 1] < start) | (rows[:, 1] >= end))]


WHEN = "start=2,duration=3"


@pytest.mark.parametrize(
    "text",
    [
        f"loss:{WHEN}",
        f"duplicate:{WHEN}",
        f"reorder:{WHEN}",
        f"jitter:{WHEN},delay=0.001",
        f"corrupt:{WHEN}",
        f"cut:{WHEN}",
    ],
)
def test_a_fault_leaves_alone_what_is_before_and_after_it(text):
    rows, _ = passed(text)
    untouched = outside(rows)
    assert untouched[:, 1].tolist() == [*range(2000), *range(5000, 10_000)]
    assert untouched[:, 0].tolist() == untouched[:, 1].tolist()


def test_lost_frames_are_a_share_and_those_that_come_are_whole():
    rows, _ = passed(f"loss:{WHEN},share=0.3")
    inside = rows[(rows[:, 1] >= 2000) & (rows[:, 1] < 5000)]
    assert len(inside) == pytest.approx(3000 * 0.7, abs=100)


def test_duplicates_are_the_same_bytes_at_once():
    rows, _ = passed(f"duplicate:{WHEN},share=0.5")
    numbers, counts = np.unique(rows[:, 1], return_counts=True)
    assert len(numbers) == len(FRAMES)
    assert (counts == 2).sum() == pytest.approx(1500, abs=100)


def test_held_back_frames_are_overtaken():
    rows, _ = passed(f"reorder:{WHEN},share=0.1,delay=0.02")
    late = rows[rows[:, 0] != rows[:, 1]]
    assert len(late) == pytest.approx(300, abs=60)
    assert (late[:, 0] - late[:, 1] == 20).all()
    assert (np.diff(rows[:, 1]) < 0).any()
    assert len(rows) == len(FRAMES)


def test_jitter_delays_and_keeps_the_order():
    rows, _ = passed(f"jitter:{WHEN},delay=0.05")
    assert (np.diff(rows[:, 1]) == 1).all()
    waits = (rows[:, 0] - rows[:, 1])[2000:5000]
    assert 20 < waits.mean() <= 50
    assert waits.max() <= 50


def test_corrupt_frames_have_so_many_bits_flipped():
    rows, found = passed(f"corrupt:{WHEN},share=0.2,bits=3")
    damaged = np.flatnonzero(rows[:, 1] < 0)
    assert len(damaged) == pytest.approx(600, abs=90)
    for k in damaged.tolist():
        one, right = found[k][1], FRAMES[k]
        flips = sum((a ^ b).bit_count() for a, b in zip(one, right, strict=True))
        assert flips == 3


def test_nothing_passes_a_cut_either_way():
    for way in ("out", "in"):
        rows, _ = passed(f"cut:{WHEN}", way=way)
        assert len(rows) == 7000
    assert len(passed(f"cut:{WHEN},way=in", way="out")[0]) == 10_000
    assert len(passed(f"cut:{WHEN},way=in", way="in")[0]) == 7000


def test_chance_hangs_on_the_seed_the_place_and_the_direction_only():
    text = f"loss:{WHEN},share=0.5"
    assert passed(text)[1] == passed(text)[1]
    assert passed(text)[1] != passed(text, seed=2)[1]
    assert passed(text)[1] != passed(text, way="in")[1]
    # A fault of another layer between does not change what falls out, only its place does
    both = passed(text, f"corrupt:{WHEN},share=0.0")[1]
    assert both == passed(text)[1]


def test_every_frame_takes_as_long_as_the_link():
    wire = Wire([], 1, zero_ns=0, latency=0.003)
    wire.push(0, b"one")
    assert wire.pop(2 * MS) is None
    assert wire.pop(3 * MS) == (3 * MS, b"one")
    assert wire.pop(10**12) is None
