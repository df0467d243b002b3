"""Clients that nobody here wrote, beside the daemon and the fake autopilot, behind a router.

Run by ``make e2e``, which installs them; elsewhere skipped.
"""

import json
import os
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from tests.e2e.hub import Hub

CLIENTS = os.environ.get("E2E_CLIENTS", "")
HERE = Path(__file__).parent
DURATION = 25.0
"""Seconds of flight."""
OURS = 194
pytestmark = [
    pytest.mark.skipif(not CLIENTS, reason="MAVSDK and MAVProxy are installed by make e2e"),
    pytest.mark.timeout(180),
]


@contextmanager
def running(*command, out=os.devnull, words=os.devnull, **options):
    """Run a program while the body runs, what it says going to files."""
    with open(out, "w") as stdout, open(words, "w") as stderr:
        process = subprocess.Popen(
            [str(part) for part in command], stdout=stdout, stderr=stderr, **options
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def flight(folder, hub, kind):
    """Fly against the daemon; give the simulator's process and where the daemon records to."""
    autopilot, daemon = hub.ports
    record, config = folder / "daemon.tlog", folder / "daemon.yaml"
    config.write_text("http: {port: 0}\n")
    with ExitStack() as stack:
        stack.enter_context(
            running(
                *(sys.executable, "-m", "ekf_companion", "run", "--config", config),
                *("--link", f"udpout:127.0.0.1:{daemon}", "--record", record),
                words=folder / "daemon.log",
            )
        )
        flying = stack.enter_context(
            running(
                *(sys.executable, "-m", "sim_autopilot", "fly", "--scenario", "figure-eight"),
                *("--link", f"udpout:127.0.0.1:{autopilot}", "--duration", DURATION),
                *("--autopilot", kind),
            )
        )
        yield flying, record


def odometry(frames):
    """Return the ODOMETRY of ours among frames, by their stamps."""
    said = {}
    for frame in frames:
        if frame.message_id == IDS["ODOMETRY"] and frame.component_id == OURS:
            said[unpack(frame).time_usec] = unpack(frame)
    return said


def recorded(path):
    splitter = Splitter()
    return odometry(f for _, raw in tlog.read(path).frames() for f in splitter.feed(raw))


@pytest.fixture(scope="module", params=["px4", "ardupilot"])
def seen(request, tmp_path_factory):
    """Fly with both clients listening; give what each of them saw, and what the daemon sent."""
    folder = tmp_path_factory.mktemp(request.param)
    mavsdk, mavproxy = free_port(), free_port()
    with Hub(mavsdk, mavproxy) as hub, ExitStack() as stack:
        reader = stack.enter_context(
            running(
                *(f"{CLIENTS}/python", HERE / "mavsdk_client.py"),
                *(f"udpin://127.0.0.1:{mavsdk}", DURATION + 3.0),
                out=folder / "mavsdk.jsonl",
                words=folder / "mavsdk.log",
            )
        )
        stack.enter_context(
            running(
                *(f"{CLIENTS}/python", f"{CLIENTS}/mavproxy.py", "--non-interactive"),
                *(f"--master=udpin:127.0.0.1:{mavproxy}", "--logfile=mavproxy.tlog"),
                *(f"--state-basedir={folder}", "--default-modules=", "--nodtr"),
                cwd=folder,
                env={**os.environ, "HOME": str(folder), "MPLBACKEND": "agg"},
                out=folder / "mavproxy.log",
                words=folder / "mavproxy.err",
            )
        )
        time.sleep(2.0)
        flying, record = stack.enter_context(flight(folder, hub, request.param))
        assert flying.wait(DURATION + 60.0) == 0
        reader.wait(30.0)
    lines = [json.loads(line) for line in (folder / "mavsdk.jsonl").read_text().splitlines()]
    return lines, recorded(folder / "mavproxy.tlog"), recorded(record)


def test_mavsdk_telemetry_gets_each_estimate_with_its_covariance(seen):
    lines, _, sent = seen
    heard = [line for line in lines if line["via"] == "telemetry"]
    assert len(heard) > 5 * DURATION
    matched = [line for line in heard if line["time_usec"] in sent]
    assert len(matched) > 0.5 * len(sent)
    for line in matched:
        ours = sent[line["time_usec"]]
        assert line["position"] == pytest.approx([ours.x, ours.y, ours.z], rel=1e-6)
        assert line["q"] == pytest.approx(ours.q, abs=1e-6)
        assert line["velocity"] == pytest.approx([ours.vx, ours.vy, ours.vz], rel=1e-6)
        for name in ("pose_covariance", "velocity_covariance"):
            assert line[name] == pytest.approx(getattr(ours, name), rel=1e-6)
        assert np.isfinite(line["pose_covariance"]).all()


def test_mavsdk_direct_gets_the_frames_that_the_autopilot_takes(seen):
    """Rule 19: MAVSDK's telemetry knows neither frame's name; its direct access shows the ids."""
    lines, _, _ = seen
    ours = [m["fields"] for m in lines if m["via"] == "direct" and m["component_id"] == OURS]
    assert len(ours) > 5 * DURATION
    frames = {(fields["frame_id"], fields["child_frame_id"]) for fields in ours}
    # PX4: local NED, and so is the velocity; ArduPilot: local FRD, body FRD
    assert frames in ({(1, 1)}, {(20, 12)})


def test_mavproxy_records_the_stream_as_a_ground_station(seen):
    _, heard, sent = seen
    both = heard.keys() & sent.keys()
    assert len(both) > 0.9 * len(sent) > 5 * DURATION
    assert all(heard[stamp] == sent[stamp] for stamp in both)
