"""How many files, moves and calls one frame goes through."""

from __future__ import annotations

import subprocess
import sys

import pytest

from benchmarks.trace import Call, Cost, cost

LARGEST = {
    ("HIGHRES_IMU", "ODOMETRY"): Cost(files=12, moves=16, calls=25),
    ("GPS_RAW_INT", ""): Cost(files=9, moves=12, calls=15),
}
"""Of a message and what it brings: nobody follows more when he asks why an ODOMETRY says what, or
where a fix is read."""


def test_a_move_is_a_call_in_another_file_than_the_call_before():
    calls = [Call("a.py", "f"), Call("a.py", "g"), Call("b.py", "h"), Call("a.py", "f")]
    assert cost(calls) == Cost(files=2, moves=2, calls=4)


@pytest.mark.parametrize("family", ["px4", "ardupilot"])
def test_a_frame_goes_through_no_more_than_can_be_followed(family):
    """The plainest of each message; the others hold more than one measurement."""
    # In a process of its own, whose compiled classes are replaced by such as count
    command = [sys.executable, "-m", "benchmarks.trace", "--family", family]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines()]
    least = {tuple(row[:2]): Cost(*map(int, row[3::3])) for row in rows if row[0].isupper()}
    for key, limit in LARGEST.items():
        assert all(a <= b for a, b in zip(least[key], limit, strict=True)), (key, least[key])
