"""How old what is sent may be: by stamps and times, and of a daemon that was stopped in flight."""

import signal
import time

import pytest

from ekf_companion.daemon.freshness import Freshness
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from tests.daemon.test_daemon import Daemon, free_port
from tests.daemon.test_supervised import Pilot

pytestmark = pytest.mark.campaign

MS = 1_000_000
SECOND = 1000 * MS
BOOT = 50 * SECOND
WAY = 8 * MS
LIMIT = 0.25


def sent(freshness, arrivals):
    """Return the stamps of those estimates that are sent, of pairs of stamp and arrival."""
    kept = []
    for t_ns, now_ns in arrivals:
        freshness.on_estimate(t_ns, now_ns)
        if freshness.is_fresh(t_ns, now_ns, LIMIT):
            kept.append(t_ns)
    return kept


def live(begin, end, wait=lambda now_ns: 0):
    """Return the samples of a span of time at 100 Hz, each as long after its stamp as it waited."""
    return [
        (BOOT + t_ns, t_ns + WAY + wait(t_ns))
        for t_ns in range(begin * SECOND, end * SECOND, 10 * MS)
    ]


def drained(begin, end, stopped_until):
    """Return the same where nothing is read until a time, and 0.1 ms later the next, and so on."""
    arrivals, free_ns = [], stopped_until * SECOND
    for t_ns, now_ns in live(begin, end):
        free_ns = max(free_ns + MS // 10, now_ns)
        arrivals.append((t_ns, free_ns))
    return arrivals


def test_what_comes_as_it_was_taken_is_sent():
    assert len(sent(Freshness(), live(0, 60))) == 6000


def test_a_delay_that_varies_like_that_of_a_radio_withholds_nothing():
    assert len(sent(Freshness(), live(0, 60, lambda now_ns: now_ns * 7919 % (200 * MS)))) == 6000


def test_after_a_stall_only_what_is_new_is_sent():
    freshness = Freshness()
    sent(freshness, live(0, 30))
    kept = sent(freshness, drained(30, 40, stopped_until=35))
    oldest = BOOT + 35 * SECOND - 250 * MS
    assert oldest - 20 * MS < kept[0] < oldest + 60 * MS
    assert kept[-1] == BOOT + 40 * SECOND - 10 * MS
    assert len(kept) == pytest.approx(525, abs=6)


def test_a_simulation_that_runs_faster_than_time_withholds_nothing():
    assert len(sent(Freshness(), [(t_ns, now_ns // 10) for t_ns, now_ns in live(0, 60)])) == 6000


def test_a_simulation_that_runs_slower_than_time_withholds_nothing():
    """PX4's on a busy machine: 2 % slow; ODOMETRY was withheld for 8 s of each 20."""
    slow = [(t_ns, round(now_ns * 1.04)) for t_ns, now_ns in live(0, 60)]
    assert len(sent(Freshness(), slow)) == 6000


def test_a_clock_that_begins_anew_withholds_nothing():
    freshness = Freshness()
    sent(freshness, live(0, 30))
    reboot = [(t_ns - BOOT - 20 * SECOND, now_ns) for t_ns, now_ns in live(30, 40)]
    assert len(sent(freshness, reboot)) == 1000


def test_a_clock_that_leaps_ahead_withholds_for_a_moment_at_most():
    freshness = Freshness()
    sent(freshness, live(0, 30))
    leapt = [(t_ns + 100 * SECOND, now_ns) for t_ns, now_ns in live(30, 40)]
    assert len(sent(freshness, leapt)) == 1000


@pytest.mark.parametrize(("theirs", "ours"), [("udpin", "udpout"), ("tcpin", "tcp")])
def test_rule_2_a_daemon_that_was_stopped_sends_nothing_of_the_time_that_it_missed(
    tmp_path, theirs, ours
):
    port = free_port()
    options = ("--link", f"{ours}:127.0.0.1:{port}")
    with (
        Pilot(port, kind=theirs) as pilot,
        Daemon(tmp_path, *options, config="http: {port: 0}\n") as daemon,
    ):
        daemon.wait_for("Estimate is OK")
        daemon.kill(signal.SIGSTOP)
        first = stamp(pilot.wire.sent)
        time.sleep(3.0)
        last = stamp(pilot.wire.sent)
        daemon.kill(signal.SIGCONT)
        while odometry(pilot.wire)[-1] < last:
            time.sleep(0.1)
        daemon.wait_for("The companion stood still for")
        assert daemon.stop() == 0
        assert "Autopilot lost" not in daemon.words.read_text()
    missed = [t_us for t_us in odometry(pilot.wire) if first + 5e5 < t_us < last - 1e6]
    assert last - first > 2.5e6
    assert missed == []


def stamp(sent):
    """Return the stamp of the last inertial sample that the autopilot has sent, us."""
    for data in reversed(sent):
        if (found := of_kind("HIGHRES_IMU", [data])) != []:
            return found[0]
    raise AssertionError("no inertial sample was sent")


def odometry(wire):
    return [unpack(f).time_usec for f in wire.frames() if f.message_id == IDS["ODOMETRY"]]


def of_kind(name, data):
    splitter = Splitter()
    frames = [frame for one in data for frame in splitter.feed(one)]
    return [unpack(frame).time_usec for frame in frames if frame.message_id == IDS[name]]
