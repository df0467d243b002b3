"""The score of flights in the autopilots' simulators, and what is printed without one."""

import random
import socket
import struct
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.sitl import links
from benchmarks.sitl.flight import Log
from benchmarks.sitl.line import Line
from benchmarks.sitl.pilot import figure_eight, square
from benchmarks.sitl.place import (
    ARDUPILOT_RADIUS,
    HOME,
    PX4_RADIUS,
    by_ardupilot,
    by_px4,
    from_home,
)
from benchmarks.sitl.recording import COMPONENT_ID, is_sent, read_odometry
from benchmarks.sitl.score import moved, pooled, right_after, score, silence, untold_steps
from benchmarks.sitl.throttle import PORT, Throttle, Way, frames
from benchmarks.sitl.throttle import Line as Wire
from benchmarks.sitl.tracks import Track, match
from ekf_companion.mavlink.codec import Sender, pack
from tests.daemon.waiting import LIMIT


def track(lead=0.0, offset=0.0, yaw=0.0):
    """Return a circle of 10 m at 5 m/s that is ahead of the truth, displaced and turned."""
    t = np.arange(0.0, 40.0, 0.02)
    a = 0.5 * (t + lead)
    pos_n = np.stack([10.0 * np.cos(a) + offset, 10.0 * np.sin(a), np.full(len(t), -12.0)], axis=1)
    vel_n = np.stack([-5.0 * np.sin(a), 5.0 * np.cos(a), np.zeros(len(t))], axis=1)
    euler = np.stack([np.zeros(len(t)), np.zeros(len(t)), np.full(len(t), yaw)], axis=1)
    return Track(t=t, pos_n=pos_n, vel_n=vel_n, att_t=t, euler=euler)


def test_an_offset_of_the_origin_is_an_error_in_every_axis():
    wrong = track(offset=3.0)
    wrong.pos_n[:, 2] -= 4.0
    found = score(wrong, track(), 5.0, 35.0)
    assert found.horizontal == pytest.approx(3.0)
    assert found.horizontal_max == pytest.approx(3.0)
    assert found.vertical == pytest.approx(4.0)
    assert found.vertical_max == pytest.approx(4.0)
    assert found.velocity == pytest.approx(0.0, abs=1e-9)


def test_without_an_estimate_the_error_is_infinite():
    assert score(None, track(), 5.0, 35.0).horizontal == np.inf
    assert score(track(), track(), 50.0, 60.0).vertical_max == np.inf


@pytest.mark.parametrize("lead", [-0.033, 0.0, 0.050])
def test_the_lead_is_found_and_counts_in_position_and_velocity(lead):
    found = score(track(lead=lead), track(), 5.0, 35.0)
    assert found.lead == pytest.approx(lead, abs=0.002)
    assert found.horizontal == pytest.approx(abs(lead) * 5.0, abs=0.02)
    assert found.velocity == pytest.approx(abs(lead) * 2.5, abs=0.02)


def test_a_heading_that_differs_by_whole_turns_is_no_error():
    found = score(track(yaw=2.0 * np.pi + np.deg2rad(3.0)), track(), 5.0, 35.0)
    assert found.yaw == pytest.approx(3.0, abs=1e-6)


def test_a_vehicle_that_stands_shows_no_lead():
    still = track()
    still = Track(
        t=still.t,
        pos_n=0.0 * still.pos_n,
        vel_n=0.0 * still.vel_n,
        att_t=still.att_t,
        euler=still.euler,
    )
    assert score(still, still, 5.0, 35.0).lead is None


def test_flights_pooled_are_as_one_long_flight():
    quiet, busy = track(lead=0.02, yaw=0.01), track(lead=-0.06, yaw=0.03)
    each = [score(one, track(), 5.0, 35.0) for one in (quiet, busy)]
    both = pooled(each)
    assert both.yaw == pytest.approx(np.rad2deg(np.sqrt((0.01**2 + 0.03**2) / 2.0)))
    assert both.lead == pytest.approx(-0.06, abs=0.002)
    assert both.horizontal_max == each[1].horizontal_max > each[0].horizontal_max


def test_a_place_is_right_again_after_its_last_large_error():
    wrong = track()
    wrong.pos_n[(wrong.t >= 20.0) & (wrong.t < 24.5), 1] += 5.0
    assert right_after(wrong, track(), 22.0, 40.0, 1.0) == pytest.approx(2.5, abs=0.03)
    assert right_after(wrong, track(), 25.0, 40.0, 1.0) == pytest.approx(0.0, abs=0.03)
    wrong.pos_n[wrong.t >= 24.5, 2] += 5.0
    assert right_after(wrong, track(), 22.0, 40.0, 1.0) == np.inf


def test_an_estimate_that_never_came_back_is_not_right():
    short = track()
    early = short.t < 20.0
    short = Track(
        t=short.t[early],
        pos_n=short.pos_n[early],
        vel_n=short.vel_n[early],
        att_t=short.att_t[early],
        euler=short.euler[early],
    )
    assert right_after(short, track(), 22.0, 40.0, 1.0) == np.inf
    assert right_after(None, track(), 22.0, 40.0, 1.0) == np.inf


def test_a_step_over_a_gap_counts_unless_the_counter_moved():
    kept = (track().t < 20.0) | (track().t > 25.0)
    whole = track()
    whole.pos_n[whole.t > 22.0, 2] += 1.5
    gone = Track(
        t=whole.t[kept],
        pos_n=whole.pos_n[kept],
        vel_n=whole.vel_n[kept],
        att_t=whole.t[kept],
        euler=whole.euler[kept],
    )
    resets = np.ones(len(gone.t), dtype=int)
    assert untold_steps(gone, resets, track(), 1.0) == 1
    assert untold_steps(gone, resets + (gone.t > 22.0), track(), 1.0) == 0
    assert untold_steps(track(), np.ones(len(track().t), dtype=int), track(), 1.0) == 0


def test_the_true_motion_after_a_switch_is_seen_in_every_axis():
    still = track()
    still.pos_n[:] = (1.0, 2.0, -12.0)
    assert moved(still, 20.0) == 0.0
    still.pos_n[still.t > 23.0, 2] = -16.0
    assert moved(still, 20.0) == pytest.approx(4.0)
    assert moved(still, 20.0, after=2.0) == 0.0


def test_silence_is_counted_in_seconds_at_both_ends_too():
    stamps = np.concatenate([np.arange(12.0, 20.0, 0.04), np.arange(25.0, 38.0, 0.04)])
    found = silence(stamps, 10.0, 40.0)
    assert found.total == pytest.approx(2.0 + 5.0 + 2.0, abs=0.2)
    assert found.longest == pytest.approx(5.0, abs=0.1)
    assert found.since == pytest.approx(20.0, abs=0.1)
    assert silence(stamps, 12.0, 19.9).since is None
    assert silence(np.zeros(0), 10.0, 40.0).total == 30.0


def test_a_frame_with_the_number_of_the_next_one_was_withheld():
    sender, written = Sender(1, COMPONENT_ID), []
    for is_withheld in (False, True, True, False, False, True, False):
        written.append(sender.frame("HEARTBEAT", bytes(9), is_draft=is_withheld))
    found = is_sent(np.array([one[4] for one in written]))
    assert found.tolist() == [True, False, False, True, True, False, True]


def test_a_recording_gives_what_was_sent_about_the_origin_beside_it(tmp_path):
    sender, file = Sender(1, COMPONENT_ID), bytearray()

    def add(frame):
        file.extend(struct.pack(">Q", 1_700_000_000_000_000 + len(file)) + frame)

    heart = Sender(1, 1)
    for k in range(4):
        add(heart.message("HEARTBEAT", type=2, autopilot=3, mavlink_version=3))
        place = {"latitude": 473977430, "longitude": 85455940 + 1000 * k, "altitude": 489400}
        add(sender.message("GPS_GLOBAL_ORIGIN", **place))
        fields = {"time_usec": 10_000_000 + k, "q": (1.0, 0.0, 0.0, 0.0), "x": 1.0, "z": -2.0}
        frame = {"frame_id": 20, "child_frame_id": 12, "reset_counter": k, "quality": 100}
        payload = pack("ODOMETRY", **fields, **frame)
        add(sender.frame("ODOMETRY", payload, is_draft=k == 2))
    path = tmp_path / "flight.tlog"
    path.write_bytes(file)
    found = read_odometry([path])
    assert found.is_sent.tolist() == [True, True, False, True]
    assert found.resets.tolist() == [0, 1, 2, 3]
    assert np.diff(found.origin.lon) * 1e7 == pytest.approx([1000.0] * 3)
    assert found.pos_n[0].tolist() == [1.0, 0.0, -2.0]


def test_a_projection_that_is_not_the_autopilots_own_is_an_error():
    far = np.array([[600.0, 0.0, -12.0], [0.0, 600.0, -12.0]])
    by_sphere = from_home(by_ardupilot(far, HOME))
    assert by_sphere[:, 2].tolist() == pytest.approx([-12.0, -12.0])
    assert abs(by_sphere - far).max() == pytest.approx(1.1, abs=0.3)
    assert abs(from_home(by_px4(far, HOME)) - far).max() == pytest.approx(1.7, abs=0.4)


@pytest.mark.parametrize("bearing", np.linspace(0.0, 2.0 * np.pi, 7))
def test_both_projections_are_of_their_spheres(bearing):
    pos_n = 1000.0 * np.array([[np.cos(bearing), np.sin(bearing), 0.0]])
    here = np.deg2rad(HOME.lat)
    for project, radius in ((by_ardupilot, ARDUPILOT_RADIUS), (by_px4, PX4_RADIUS)):
        place = project(pos_n, HOME)
        lat, lon = np.deg2rad(place.lat[0]), np.deg2rad(place.lon[0] - HOME.lon)
        cosine = np.sin(here) * np.sin(lat) + np.cos(here) * np.cos(lat) * np.cos(lon)
        # atol: the mean latitude is not the great circle's, 1 km on 6378 km
        assert radius * np.arccos(cosine) == pytest.approx(1000.0, abs=0.01)


def test_what_arrived_is_found_by_its_stamp():
    stamps, others = np.array([1.0, 1.033, 1.066, 1.1]), np.array([1.066, 1.0331, 0.5])
    rows, places = match(stamps, others)
    assert rows.tolist() == [1, 2]
    assert places.tolist() == [1, 0]


def test_a_ratio_of_small_errors_is_good_and_an_infinite_one_is_not():
    line = Line("f", "q", 1.25, 1.0, error=0.05, floor=(0.1, " m"))
    assert line.is_good
    assert line.row("X") == "X | f | q | 1.25, 0.05 m | 1 or 0.1 m | good"
    assert not line._replace(error=0.2).is_good
    assert not Line("f", "q", np.inf, 1.0).is_good
    assert not Line("f", "q", np.nan, 1.0).is_good


def test_alarms_and_modes_that_nobody_ordered_are_found():
    log = Log(
        texts=[
            (10.0, "EKF3 IMU0 stopped aiding"),
            (11.0, "GPS Glitch or Compass error"),
            (12.0, "EKF Failsafe Cleared"),
            (13.0, "EKF3 IMU0 is using GPS"),
            (50.0, "EKF variance"),
        ],
        modes=[(5.0, 4), (20.0, 9), (30.0, 6)],
        ordered=[4, 6],
        said=[(14.0, "Companion: estimate degraded: the receiver is 20 m off")],
    )
    assert log.alarms(0.0, 40.0) == ["EKF3 IMU0 stopped aiding", "GPS Glitch or Compass error"]
    assert log.alarms(0.0, 40.0, ("glitch",)) == ["EKF3 IMU0 stopped aiding"]
    assert log.unordered_modes(0.0, 40.0) == [9]
    assert log.told_after("receiver", 10.0) == 4.0
    assert log.told_after("receiver", 15.0) == np.inf


def test_a_line_is_told_to_be_bad_until_odometry_is_streamed_again():
    log = Log(said=[(2.0, "Companion: no ODOMETRY: EK3_SRC3_YAW unread")])
    assert links.told(log, 10.0) == 0.0
    log.said.append((4.0, "Companion: ODOMETRY is streamed"))
    assert links.told(log, 10.0) == np.inf
    log.said.append((11.5, "Companion: no ODOMETRY: answers take 0.9 s"))
    assert links.told(log, 10.0) == 1.5


def messages(count, size=40):
    sender = Sender(1, 1)
    return [sender.frame("STATUSTEXT", bytes([6]) + b"x" * size) for _ in range(count)]


def through(line, data, seconds, *, is_datagram):
    """Put all in at once; return what came out by then, looking every 2 ms."""
    way = Way(line, random.Random(1), is_datagram=is_datagram)
    way.put(data, 100.0)
    pieces = []
    for k in range(round(seconds / 0.002)):
        pieces += [(100.0 + 0.002 * k, piece) for piece in way.take(100.0 + 0.002 * k)]
    return way, pieces


def test_a_line_of_a_rate_carries_that_many_bytes():
    data = b"".join(messages(400))
    _, pieces = through(Wire(kind="tcp", baud=57600), data, 2.0, is_datagram=False)
    assert sum(len(piece) for _, piece in pieces) == pytest.approx(2.0 * 5760, rel=0.03)
    assert b"".join(piece for _, piece in pieces) == data[: sum(len(p) for _, p in pieces)]


def test_a_line_that_is_full_takes_no_more():
    way, _ = through(Wire(kind="tcp", baud=57600), bytes(70000), 0.1, is_datagram=False)
    assert way.is_full
    way, _ = through(Wire(kind="tcp"), bytes(70000), 0.1, is_datagram=False)
    assert not way.is_full


def test_an_autopilots_port_drops_messages_that_find_no_room():
    sent = messages(400)
    way = Way(Wire(kind="tcp", baud=57600), random.Random(1), is_datagram=False, is_port=True)
    way.put(b"".join(sent), 100.0)
    carried = b"".join(piece for k in range(2000) for piece in way.take(100.0 + 0.002 * k))
    assert not way.is_full
    assert carried == b"".join(sent[: len(carried) // len(sent[0])])
    assert 1900 < len(carried) <= PORT


def test_a_late_line_delays_and_keeps_the_order():
    sent = messages(50)
    wire = Wire(delay=0.2, jitter=0.05)
    _, pieces = through(wire, b"".join(sent), 0.5, is_datagram=True)
    assert [piece for _, piece in pieces] == sent
    assert min(t for t, _ in pieces) >= 100.2 - 1e-9
    assert max(t for t, _ in pieces) <= 100.25 + 0.003


def test_a_lossy_line_loses_whole_frames():
    sent = messages(1000)
    _, pieces = through(Wire(loss=0.1), b"".join(sent), 0.1, is_datagram=True)
    assert {piece for _, piece in pieces} <= set(sent)
    assert 850 <= len(pieces) <= 950


def test_a_line_stalls_every_five_seconds():
    way = Way(Wire(stall=0.5), random.Random(1), is_datagram=True)
    (frame,) = messages(1)
    way.put(frame, 100.1)
    assert way.take(100.4) == []
    assert way.take(100.6) == [frame]


def test_frames_are_cut_from_a_stream_and_the_rest_is_kept():
    sent = messages(3)
    data = b"\x00\x17" + b"".join(sent)
    found, rest = frames(data[:-5])
    assert found == sent[:2]
    assert frames(rest + data[-5:]) == ([sent[2]], b"")


def test_a_line_carries_both_ways_over_a_real_socket(tmp_path):
    sent = messages(5)
    size = len(b"".join(sent))
    with socket.create_server(("127.0.0.1", 0)) as server:
        simulator = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        with Throttle(simulator, Wire(kind="tcp", baud=57600), tmp_path) as between:
            between.start()
            _, host, port = between.link.split(":")
            with socket.create_connection((host, int(port)), timeout=LIMIT) as daemon:
                far, _ = server.accept()
                with far:
                    far.settimeout(LIMIT)
                    far.sendall(b"".join(sent))
                    daemon.sendall(b"up" * 50)
                    assert received(daemon, size) == b"".join(sent)
                    assert received(far, 100) == b"up" * 50


def test_a_line_is_a_pseudo_terminal_too(tmp_path):
    sent = messages(5)
    size = len(b"".join(sent))
    with socket.create_server(("127.0.0.1", 0)) as server:
        simulator = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        with Throttle(simulator, Wire(kind="pty", baud=57600), tmp_path) as between:
            between.start()
            _, device, rate = between.link.split(":")
            assert rate == "57600"
            far, _ = server.accept()
            with far, open(device, "r+b", buffering=0) as daemon:
                far.settimeout(LIMIT)
                far.sendall(b"".join(sent))
                daemon.write(b"up" * 50)
                assert received(far, 100) == b"up" * 50
                data = b""
                while len(data) < size:
                    data += daemon.read(size)
                assert data == b"".join(sent)


def test_a_line_is_datagrams_too_of_one_frame_each(tmp_path):
    sent = messages(20)
    with socket.create_server(("127.0.0.1", 0)) as server:
        simulator = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        with Throttle(simulator, Wire(kind="udp", delay=0.05), tmp_path) as between:
            between.start()
            _, host, port = between.link.split(":")
            far, _ = server.accept()
            with far, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon:
                daemon.bind((host, int(port)))
                daemon.settimeout(LIMIT)
                far.settimeout(LIMIT)
                far.sendall(b"".join(sent))
                found, peer = daemon.recvfrom(4096)
                assert found == sent[0]
                assert [daemon.recv(4096) for _ in sent[1:]] == sent[1:]
                daemon.sendto(sent[0] + sent[1], peer)
                assert received(far, len(sent[0] + sent[1])) == sent[0] + sent[1]


def received(file, size):
    data = b""
    while len(data) < size:
        data += file.recv(4096)
    return data


@pytest.mark.parametrize("make", [square, figure_eight])
def test_the_paths_end_where_they_begin_and_their_velocities_are_their_slopes(make):
    path, seconds = make()
    assert path(0.0)[:2] == pytest.approx(path(seconds)[:2], abs=1e-9)
    for t in np.arange(0.37, seconds - 0.3, 0.83):
        before, after = path(t - 1e-4), path(t + 1e-4)
        slope = [(b - a) / 2e-4 for a, b in zip(before[:2], after[:2], strict=True)]
        assert path(t)[2:] == pytest.approx(slope, abs=1e-3)


def test_without_a_simulator_a_sentence_says_so():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.sitl"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == [
        "PX4: left out; give the path of its simulator: make sitl PX4=PATH",
        "ArduCopter: left out; give the path of its simulator: make sitl ARDUPILOT=PATH",
    ]
