"""A filter by its name, or of one's own, over a recording."""

from threadpoolctl import threadpool_info, threadpool_limits

from ekf_companion.filters import mahony
from ekf_companion.logs.recording import Recording
from ekf_companion.replay.filters_by_name import run_filter
from sim_autopilot.config import SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight


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

    with threadpool_limits(3, "blas"):
        before = blas_threads()
        solution = run_filter(flight(), my_filter)
        assert seen == {1} != before
        assert blas_threads() == before
    assert solution.name == "my_filter"
    assert len(solution.table) > 100
