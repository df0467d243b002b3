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

SLOWEST = (
    "tests/analysis/test_report_page.py",
    "tests/arrays/test_python_docs.py",
    "tests/daemon/test_page.py",
    "tests/engine/test_stamps.py",
    "tests/fleet/test_batch.py",
    "tests/doctor/test_examination.py",
    "tests/daemon/test_daemon.py",
    "tests/daemon/test_monitors.py",
    "tests/engine/test_stream.py",
    "tests/engine/test_spares.py",
    "tests/cli/test_preflight.py",
    "tests/engine/test_guard.py",
    "tests/arrays/test_run.py",
    "tests/doctor/test_faults.py",
    "tests/replay/test_smoothing.py",
    "tests/daemon/test_signed_daemon.py",
    "tests/daemon/test_time.py",
    "tests/review/test_evidence.py",
    "tests/daemon/test_http.py",
    "tests/sim/test_demo.py",
    "tests/status/test_progress.py",
    "tests/calibrate/test_delay.py",
    "tests/daemon/test_supervised.py",
    "tests/benchmarks/test_speed.py",
    "tests/cli/test_extras.py",
    "tests/analysis/test_comparison.py",
    "tests/daemon/test_restart.py",
    "tests/benchmarks/test_soak.py",
    "tests/filters/test_ahrs.py",
    "tests/daemon/test_durability.py",
    "tests/daemon/test_reconnect.py",
    "tests/sim/test_follower.py",
    "tests/filters/test_zupt.py",
    "tests/filters/test_euler.py",
    "tests/analysis/test_observability.py",
    "tests/daemon/test_freshness.py",
    "tests/filters/test_gap.py",
    "tests/filters/test_ukf.py",
    "tests/benchmarks/test_consistency.py",
    "tests/calibrate/test_commands.py",
    "tests/cli/test_observability.py",
    "tests/sim/test_flown_link.py",
    "tests/engine/test_restart_in_flight.py",
    "tests/sim/test_closed_loop.py",
    "tests/sim/test_flown_origin.py",
    "tests/logs/test_hostile.py",
    "tests/engine/test_datagrams.py",
    "tests/replay/test_blocks.py",
    "tests/engine/test_faults.py",
)
"""Files of several seconds and more, by what they took beside other work, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the slowest files: for what begins last, all processes but one wait."""
    places = {name: place for place, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: places.get(item.nodeid.partition("::")[0], len(places)))


@pytest.fixture(scope="session")
def flight() -> Callable[[str], Path]:
    """Return a function from a name to a recorded flight; it skips the test where there is none."""

    def find(name: str) -> Path:
        if not (DATA / name).is_file():
            pytest.skip(f"the recorded flight {name} is not on this machine")
        return DATA / name

    return find
