"""A flight with a lidar: fake autopilot, simulated Mid-360, its odometry and the daemon.

Four of them over real sockets, in real time; the receiver is gone for the last part.
"""

from __future__ import annotations

import contextlib
import signal
import socket
import threading
import time
from dataclasses import dataclass

import numpy as np
import pytest

from ekf_companion.config.config import load_config
from ekf_companion.review.convert import estimate
from sim_autopilot import fly as live
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.faults import fault
from sim_autopilot.flight import Flight
from sim_autopilot.lidar.device import Device
from sim_autopilot.lidar.livox import LivoxFaults
from sim_autopilot.lidar.motion import of_trajectory
from sim_autopilot.lidar.record import simulate
from tests.daemon.test_daemon import SYSTEM, Daemon, Record, assert_same_as_its_messages, free_port
from tests.daemon.test_run_lidar import LIDAR, MOUNTED, LidarProcess
from tests.daemon.waiting import LIMIT

pytestmark = pytest.mark.campaign

LENGTH, CUT = 36.0, 22.0
"""Of the flight, and when its receiver ends, s."""
SOURCE = """visual_odometry:
  use: true
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
    """A flight that lets something begin with it."""

    def __init__(self, flight, begin):
        self._flight, self._begin = flight, begin

    def __getattr__(self, name):
        return getattr(self._flight, name)

    def cycles(self):
        for number, cycle in enumerate(self._flight.cycles()):
            if number == 0:
                self._begin()
            yield cycle


@dataclass
class Flown:
    witness: object
    record: Record
    words: str
    """Of the daemon."""
    said: str
    """By the lidar's process."""


def fly(folder, flight, seen, faults=None, during=lambda lidar, start: lidar):
    port, aid, http = free_port(), free_port(), free_port(socket.SOCK_STREAM)
    config = f"link: {{aid_url: 'udpin:127.0.0.1:{aid}'}}\nhttp: {{port: {http}}}\n{SOURCE}"
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(folder / "flight.tlog"))
    with contextlib.ExitStack() as stack:
        device = stack.enter_context(Device(seen, LIDAR, faults=faults, is_held=True))
        daemon = stack.enter_context(Daemon(folder, *options, config=config))
        daemon.wait_for(f"udpin:127.0.0.1:{aid}: open")
        start = lambda: stack.enter_context(  # noqa: E731
            LidarProcess(folder, device.command_port, aid, MOUNTED)
        )
        lidar = start()
        lidar.wait_for("is told to send")
        outage = fault.parse(f"gnss-outage:start={CUT},duration={LENGTH}")

        async def body(link):
            begun = Starting(flight, device.begin)
            return await live.fly(begun, link, personality=Kind.PX4, faults=[outage], wait=LIMIT)

        last = [lidar]
        other = threading.Thread(target=lambda: last.append(during(lidar, start)))
        other.start()
        flown = live.run(live.over(f"udpout:127.0.0.1:{port}", body))
        other.join()
        assert last[-1].stop() == 0
        assert daemon.stop() == 0
        said, words = last[-1].words.read_text(), daemon.words.read_text()
    return Flown(flown.witness, Record(folder / "flight.tlog", daemon.config), words, said)


def away(flight, record, config):
    """Return how far off a converted log is since the last fix, m, and in sigmas of an axis."""
    table, _ = estimate(record.path, load_config(config), None, None)
    t = (np.asarray(table.stamp_ns) - flight.to_ns(0.0)) * 1e-9
    lat, lon = (np.deg2rad(table.column(name)) for name in ("lat_deg", "lon_deg"))
    place = flight.trajectory.frame.to_ned(lat, lon, table.column("alt_m"))
    error = place - flight.trajectory.at(t).pos_n
    sigma = table.columns(["sd_pos_n", "sd_pos_e", "sd_pos_d"])
    inside = (t > CUT + 0.5) & (t < LENGTH - 0.5) & np.isfinite(error[:, 0])
    since = np.linalg.norm(error[inside] - error[inside][0], axis=1)
    return since, np.abs(error[inside] / sigma[inside]).max()


def test_without_fixes_odometry_goes_on_by_the_lidar(tmp_path, flight, seen, record_property):
    flown = fly(tmp_path, flight, seen)
    (tmp_path / "without.yaml").write_text("link:\n")
    with_lidar, sigmas = away(flight, flown.record, flown.record.config)
    without, _ = away(flight, flown.record, tmp_path / "without.yaml")
    sent = flown.witness.estimate(CUT).t
    record_property("with, without the lidar, m", (with_lidar.max(), without.max()))
    record_property("sigmas; ODOMETRY sent", (sigmas, len(sent), np.diff(sent).max()))
    assert sent[-1] > LENGTH - 1.0
    assert len(sent) > 20 * (LENGTH - CUT)
    assert with_lidar.max() < 1.5
    assert without.max() > 3.0 * with_lidar.max()
    assert sigmas < 4.0
    assert "visual odometry" in flown.words
    assert "begins anew" not in flown.said
    assert_same_as_its_messages(flown.record)


def test_a_cable_that_is_out_and_a_process_that_is_killed(tmp_path, flight, seen, record_property):
    """Both while there are no fixes: each costs a new frame, and no more than was travelled."""

    def during(lidar, start):
        time.sleep(CUT + 7.0)
        lidar.kill(signal.SIGKILL)
        lidar.wait()
        return start()

    faults = LivoxFaults(silent=(CUT + 2.0, CUT + 4.0), times=2, lost=0.01)
    flown = fly(tmp_path, flight, seen, faults, during)
    since, sigmas = away(flight, flown.record, flown.record.config)
    sent = flown.witness.estimate(CUT).t
    record_property(
        "m, sigmas; ODOMETRY sent", (since.max(), sigmas, len(sent), np.diff(sent).max())
    )
    assert since.max() < 10.0
    assert sigmas < 4.0
    assert sent[-1] > LENGTH - 1.0
