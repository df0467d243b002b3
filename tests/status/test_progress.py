"""A filter that is given samples and gives nothing, told apart from one that is given nothing."""

import os
import socket
import subprocess
import sys
import time

import pytest

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Arrival
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Kind
from ekf_companion.status.judge import BARREN_S
from ekf_companion.status.observer import Progress
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight
from tests.daemon.test_daemon import free_port, manager
from tests.daemon.test_systemd import beats, environment
from tests.daemon.waiting import LIMIT
from tests.engine.conversation import cycles

SECOND_NS = 1_000_000_000
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, -9.8)


class Given:
    """A pipeline that is given something fifty times a second, and looked at twice."""

    def __init__(self):
        self.pipeline, self.progress = Pipeline(FilterSettings()), Progress()
        self.now_ns = 100 * SECOND_NS
        self.longest_s = 0.0

    def feed(self, seconds, stamp=lambda t_ns: t_ns, values=STILL, *, rate=50):
        """Feed samples whose stamps follow from the time; give what became of the last."""
        arrival = None
        for k in range(round(seconds * 50)):
            self.now_ns += SECOND_NS // 50
            if rate and k % (50 // rate) == 0:
                row = (stamp(self.now_ns), int(Kind.IMU), (*values, *(0.0,) * 8)[:14])
                self.pipeline.process_row(row)
                arrival = self.pipeline.arrival
            if k % 25 == 0:
                self.progress.update(self.pipeline, self.now_ns)
                self.longest_s = max(self.longest_s, self.progress.barren_s(self.now_ns))
        return arrival


@pytest.mark.parametrize(
    ("stamp", "arrival"),
    [
        (lambda t_ns: t_ns - 100 * SECOND_NS, Arrival.STALE),
        (lambda t_ns: 102 * SECOND_NS, Arrival.DUPLICATE),
    ],
)
def test_samples_of_which_no_estimate_is_made_are_noticed_after_seconds(stamp, arrival):
    given = Given()
    given.feed(2.0)
    assert given.feed(BARREN_S - 0.5, stamp) is arrival
    assert 0.0 < given.longest_s < BARREN_S
    given.feed(2.0, stamp)
    assert given.longest_s > BARREN_S
    given.feed(1.0)
    assert given.progress.barren_s(given.now_ns) == 0.0


def test_what_is_not_given_is_owed_no_estimate():
    given = Given()
    given.feed(10.0)
    given.feed(30.0, rate=0)  # a silent link
    given.feed(0.2, lambda t_ns: 50 * SECOND_NS)  # a stray sample, and silence again
    given.feed(30.0, rate=0)
    given.feed(0.2, lambda t_ns: 50 * SECOND_NS)
    given.feed(10.0, values=(float("nan"), *STILL[1:]))  # what no sensor can say
    given.feed(10.0, rate=1)  # few samples, all of them used
    assert given.longest_s < 0.5


@pytest.mark.parametrize("kinds", [(Kind.IMU,), (Kind.IMU, Kind.HEADING)])
def test_a_filter_that_aligns_or_lacks_fixes_is_not_stuck(kinds):
    log = events(Flight.plan("hover", SimConfig(imu=ImuConfig(rate=50.0)), duration=10.0))
    pipeline, progress, longest_s = Pipeline(FilterSettings()), Progress(), 0.0
    for t_ns, kind, row in zip(log.t_ns.tolist(), log.kind.tolist(), log.values, strict=True):
        if kind in kinds:
            pipeline.process_row((t_ns, kind, tuple(row.tolist())))
            progress.update(pipeline, t_ns)
            longest_s = max(longest_s, progress.barren_s(t_ns))
    assert pipeline.health().status < 3  # no position yet
    assert longest_s == 0.0


STUCK = """
from ekf_companion.engine.pipeline import Pipeline
process_row, given = Pipeline.process_row, []
def held(self, row):
    given.append(row[0])
    return process_row(self, (given[:500][-1], *row[1:]))
Pipeline.process_row = held
from ekf_companion.cli import app
"""
"""A defect: from its 500th measurement on the filter takes all to be of one time."""


def test_the_watchdog_is_not_fed_by_a_filter_that_makes_nothing_of_its_samples(tmp_path):
    """Rule 2: a stalled filter is started again, though the loop goes round."""
    port = free_port()
    code = f"{STUCK}app(['run', '--link', 'udpin:127.0.0.1:{port}'])\n"
    with (
        manager(tmp_path) as (address, told),
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={**os.environ, **environment(address)},
            stderr=subprocess.DEVNULL,
        ) as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot,
    ):
        end = time.monotonic() + LIMIT
        while not beats(told):
            assert time.monotonic() < end
            time.sleep(0.02)
        begin = stalled_at = None
        for t_ns, data in cycles(60.0):
            begin = begin or time.monotonic() - t_ns * 1e-9
            time.sleep(max(begin + t_ns * 1e-9 - time.monotonic(), 0.0))
            autopilot.sendto(data, ("127.0.0.1", port))
            if stalled_at is None:
                stalled = [pair for pair in list(told) if "makes no estimate" in pair[1]]
                stalled_at = stalled[0][0] if stalled else None
            elif time.monotonic() > stalled_at + 2.5:
                break
        process.kill()
        process.wait()
    words = stalled[0][1].removeprefix("STATUS=stalled: inertial samples have come for ")
    assert 3.0 <= float(words.split()[0]) < 10.0, stalled
    # One may be under way: both are sent each half second, or later where the machine is busy
    assert len([when for when in beats(told) if when > stalled_at]) <= 1
