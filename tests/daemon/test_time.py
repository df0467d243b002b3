"""The autopilot's clock, over real sockets, with PX4's bad day: answers that name any target."""

import contextlib
import json
import socket
import threading
import urllib.request

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import TimesyncConfig
from ekf_companion.doctor.examination import examine_log
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import parse
from sim_autopilot.flight import Flight
from sim_autopilot.fly import fly, over, run
from tests.daemon.test_daemon import (
    SYSTEM,
    Daemon,
    Open,
    Record,
    assert_same_as_its_messages,
    free_port,
)
from tests.daemon.waiting import LIMIT, wait_until


@contextlib.contextmanager
def flying(url, personality):
    """Fly in time, as a PX4 does, until the context ends."""
    px4 = parse(personality)
    config = px4.suited(SimConfig(system_id=SYSTEM))
    flight = Open(Flight.plan("figure-eight", config, duration=600.0, skip=6.0))

    async def body(link):
        await fly(flight, link, personality=px4, wait=LIMIT)

    thread = threading.Thread(target=lambda: run(over(url, body)))
    thread.start()
    try:
        yield
    finally:
        flight.land()
        thread.join()


def time_of(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/status", timeout=LIMIT) as answer:
        return json.load(answer)["time"]


@pytest.fixture(scope="module")
def locked(tmp_path_factory):
    """Return the time in the status of a daemon that has locked to a PX4, and its recording."""
    folder = tmp_path_factory.mktemp("time")
    port, http_port = free_port(), free_port(socket.SOCK_STREAM)
    path = folder / "flight.tlog"
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(path))
    config = f"http: {{port: {http_port}}}\noutput: {{odometry: {{mode: always}}}}\n"
    config += "timesync: {largest_rtt: 0.2}  # of a busy machine\n"
    with Daemon(folder, *options, config=config) as daemon:
        daemon.wait_for("Status on")
        with flying(f"udpout:127.0.0.1:{port}", "px4"):
            wait_until(lambda: time_of(http_port)["is_locked"])
            daemon.wait_for("Estimate is OK")
            found = time_of(http_port)
        assert daemon.stop() == 0
    return found, Record(path, daemon.config)


def test_the_clock_locks_to_a_px4_whose_answers_name_any_target(locked):
    found, record = locked
    assert found["is_locked"]
    assert found["answers"] >= 20
    answers = [message for _, message in record.of("TIMESYNC", component=1) if message.tc1]
    assert len({(m.target_system, m.target_component) for m in answers}) >= 15


def test_its_recording_gives_the_same_messages(locked):
    """Rule 38: live is replay, to the bit."""
    assert_same_as_its_messages(locked[1])


PATIENT = Config(timesync=TimesyncConfig(largest_rtt=0.2))


def test_the_doctor_sees_the_clock_in_the_recording(locked):
    _, record = locked
    state = examine_log(record.path, PATIENT).time
    assert state.is_locked
    assert state.answers >= 20


def test_the_doctor_names_why_the_clock_of_a_recording_was_not_locked(locked, tmp_path):
    _, record = locked
    path = tmp_path / "unanswered.tlog"
    frames = zip(record.stamps, record.raw, record.frames, strict=True)
    answer = IDS["TIMESYNC"], 1
    path.write_bytes(
        b"".join(
            stamp.to_bytes(8, "big") + raw
            for stamp, raw, frame in frames
            if (frame.message_id, frame.component_id) != answer
        )
    )
    state = examine_log(path, PATIENT).time
    assert not state.is_locked
    assert state.trouble.endswith(" requests without an answer")
