"""A filter by its name, or of one's own, over a recording."""

import os
import subprocess
import sys

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from ekf_companion.filters import mahony
from ekf_companion.logs.recording import Recording
from ekf_companion.replay.filters_by_name import run_filter
from sim_autopilot.config import SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight
from tests.paths import ROOT


def flight():
    flown = Flight.plan("figure-eight", SimConfig(), duration=12.0, seed=3)
    return Recording(events=events(flown), family="unknown")


def blas_threads():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_a_filter_runs_on_one_thread_of_the_blas_and_leaves_them_as_they_were():
    """Beside other work the threads of four filters over 63 s fought for 140 s: now 38."""
    seen = set()

    def my_filter(recording, settings, option):
        seen.update(blas_threads())
        return mahony.run(recording.events, gap=settings.imu.gap_reset)

    recording = flight()  # the simulator loads SciPy, which has a BLAS of its own
    with threadpool_limits(3, "blas"):
        before = blas_threads()
        solution = run_filter(recording, my_filter)
        assert seen == {1} != before
        assert blas_threads() == before
    assert solution.name == "my_filter"
    assert len(solution.table) > 100


FIRST_CALL = """
import sys
import numpy as np
from threadpoolctl import threadpool_info
from ekf_companion import OwnAid, estimate

class Watch(OwnAid):
    aid = "watch"
    def innovation(self, state):
        seen.update(one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas")
        return 0.0 * state.pos_n[..., 2:3]
    def covariance(self):
        return np.eye(1)

assert "scipy.linalg" not in sys.modules
seen = set()
t = np.arange(0.0, 8.0, 0.02)
noise = np.random.default_rng(1).normal(0.0, 0.005, (len(t), 3))
each = np.ones(40)
fixes = {"time": t[::10], "lat_deg": 47.0 * each, "lon_deg": 8.0 * each, "alt": 400.0 * each}
heading = {"time": t[::10], "heading": 0.3 * each}
aids = [(7_500_000_000, Watch())]
estimate(
    t, noise, [0, 0, -9.8] + noise, gnss=fixes, heading=heading, filter=sys.argv[1], aids=aids
)
assert "scipy.linalg" in sys.modules
print(sorted(seen))
"""


@pytest.mark.parametrize("name", ["euler", "iterated"])
def test_the_first_run_of_a_process_is_on_one_thread_too(name):
    """SciPy's BLAS was loaded after the limit was set: 10 s of processor time, where 2.5 do."""
    threads = {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", FIRST_CALL, name],
        env=os.environ | threads,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "[1]\n", done.stderr
