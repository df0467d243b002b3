"""A flight with a lidar: fake autopilot, simulated Mid-360, its odometry and the daemon.

Four of them over real sockets, in real time; the receiver is gone for the last part.
"""

from __future__ import annotations

import contextlib
import signal
import socket
import threading
import time

import numpy as np
import pytest

from ekf_companion.config.config import load_config
from ekf_companion.review.convert import estimate
from sim_autopilot import fly as live
from sim_autopilot.config import SimConfig
from sim_autopilot.faults import fault
from sim_autopilot.flight import Flight
from sim_autopilot.lidar.device import Device
from sim_autopilot.lidar.livox import LivoxFaults
from sim_autopilot.lidar.motion import of_trajectory
from sim_autopilot.lidar.record import simulate
from tests.daemon.test_aid_port import aid_of
from tests.daemon.test_daemon import SYSTEM, Daemon, Record, assert_same_as_its_messages, free_port
from tests.daemon.test_run_lidar import LIDAR, MOUNTED, LidarProcess
from tests.daemon.waiting import LIMIT

pytestmark = pytest.mark.campaign

LENGTH, CUT = 36.0, 22.0
"""Of the flight, and when its receiver ends, s."""
KNOWN = 250
"""Cycles by which it is known when the flight began, one second."""
SOURCE = """visual_odometry:
  use: true
  delay_std: 0.01
  walk: 0
  speed_walk: 0
  yaw_walk: 0
  scale_std: 0
  scale_walk: 0
"""


@pytest.fixture(scope="module")
def flight():
    return Flight.plan("figure-eight", SimConfig(system_id=SYSTEM), duration=LENGTH)


@pytest.fixture(scope="module")
def seen(flight):
    """What a lidar sees of it in a hall."""
    motion = of_trajectory(flight.trajectory)
    return simulate("hall", 5, duration=LENGTH, motion=motion)


class Starting:
    """A flight that lets something begin with it, once it is known when it did."""

    def __init__(self, flight, begin):
        self._flight, self._begin = flight, begin

    def __getattr__(self, name):
        return getattr(self._flight, name)

    def cycles(self):
        zero_ns, starts = self._flight.to_ns(0.0), []
        for number, cycle in enumerate(self._flight.cycles()):
            yield cycle
            # The wait for it ends late on a busy machine, and never early
            starts.append(time.monotonic() - (cycle.flight_ns - zero_ns) * 1e-9)
            if number == KNOWN:
                self._begin(time.monotonic() - min(starts))


class Board:
    """The daemon and the process of the lidar, which may be killed and started again."""

    def __init__(self, folder, command_port):
        self.port, self._aid, self.http = free_port(), free_port(), free_port(socket.SOCK_STREAM)
        self._folder, self._command_port = folder, command_port
        self._stack = contextlib.ExitStack()
        self.start_daemon()
        self.start_lidar()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._stack.close()

    def start_daemon(self):
        config = f"link: {{aid_url: 'udpin:127.0.0.1:{self._aid}'}}\nhttp: {{port: {self.http}}}\n"
        options = ("--link", f"udpin:127.0.0.1:{self.port}", "--checkpoint", "checkpoint")
        record = ("--record", str(self._folder / "flight.tlog"))
        self.daemon = self._stack.enter_context(
            Daemon(self._folder, *options, *record, config=config + SOURCE, cwd=self._folder)
        )

    def start_lidar(self):
        self.lidar = self._stack.enter_context(
            LidarProcess(self._folder, self._command_port, self._aid, MOUNTED)
        )

    def stop(self):
        assert self.lidar.stop() == 0
        assert self.daemon.stop() == 0


def kill(process):
    process.kill(signal.SIGKILL)
    process.wait()


def fly(folder, flight, seen, faults=None, during=lambda board: None):
    """Fly it all; return what the autopilot received of it, and the board."""
    with (
        Device(seen, LIDAR, faults=faults, is_held=True) as device,
        Board(folder, device.command_port) as board,
    ):
        board.daemon.wait_for(": open")
        board.lidar.wait_for("is told to send")
        outage = fault.parse(f"gnss-outage:start={CUT},duration={LENGTH}")
        other = threading.Thread(target=during, args=(board,))

        def begin(ago):
            device.begin(ago)
            other.start()

        async def body(link):
            started = Starting(flight, begin)
            return await live.fly(started, link, faults=[outage], wait=LIMIT)

        flown = live.run(live.over(f"udpout:127.0.0.1:{board.port}", body))
        other.join()
        board.stop()
        return flown.witness, board


def away(witness):
    """Return what was sent without fixes: times, m since the last fix, and sigmas of an axis."""
    found = witness.estimate(CUT + 0.5)
    error = witness.error(found).pos_n
    since = np.linalg.norm(error - error[0], axis=1)
    return found.t, since, float(np.abs(error / found.std[:, :3]).max())


def without(flight, folder):
    """Return how far the same flight is off since the last fix without the lidar, m."""
    (folder / "without.yaml").write_text("link:\n")
    config = load_config(folder / "without.yaml")
    table, _ = estimate(folder / "flight.tlog", config, None, None)
    t = (np.asarray(table.stamp_ns) - flight.to_ns(0.0)) * 1e-9
    lat, lon = (np.deg2rad(table.column(name)) for name in ("lat_deg", "lon_deg"))
    place = flight.trajectory.frame.to_ned(lat, lon, table.column("alt_m"))
    error = (place - flight.trajectory.at(t).pos_n)[(t > CUT + 0.5) & (t < LENGTH - 0.5)]
    return np.linalg.norm(error - error[0], axis=1).max()


def test_without_fixes_odometry_goes_on_by_the_lidar(tmp_path, flight, seen):
    shown = []

    def look(board):
        time.sleep(CUT + 5.0)
        shown.append(aid_of(board.http))

    witness, board = fly(tmp_path, flight, seen, during=look)
    assert (shown[0]["state"], shown[0]["source"][:16]) == ("used", "240/197 ODOMETRY")
    t, since, sigmas = away(witness)
    alone = without(flight, tmp_path)
    assert t[-1] > LENGTH - 1.0
    assert len(t) > 20 * (LENGTH - CUT)
    assert since.max() < 1.0
    assert alone > 3.0 * since.max()
    assert sigmas < 4.0
    assert "begins anew" not in board.lidar.words.read_text()
    assert_same_as_its_messages(Record(tmp_path / "flight.tlog", board.daemon.config))


def cable_and_lidar(board):
    """Kill the lidar's process five seconds after its cable was out."""
    time.sleep(CUT + 7.0)
    kill(board.lidar)
    board.start_lidar()


def restarted_daemon(board):
    """Kill the daemon while it has fixes: it goes on from its checkpoint, and the lidar with it."""
    time.sleep(CUT - 6.0)
    kill(board.daemon)
    board.start_daemon()


@pytest.mark.parametrize(
    ("during", "faults"),
    [
        (cable_and_lidar, {"silent": (CUT + 2.0, CUT + 4.0), "times": 2, "lost": 0.01}),
        (restarted_daemon, {}),
        (lambda board: None, {"leap": (CUT + 3.0, 1.79e9)}),  # from its own clock to PTP's
    ],
)
def test_odometry_goes_on_whatever_is_killed(tmp_path, flight, seen, during, faults):
    witness, _ = fly(tmp_path, flight, seen, LivoxFaults(**faults), during)
    t, since, sigmas = away(witness)
    assert t[-1] > LENGTH - 1.0
    assert since.max() < 2.0
    assert sigmas < 4.0
