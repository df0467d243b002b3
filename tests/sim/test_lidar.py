from __future__ import annotations

import socket
import threading
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.lidar import livox
from ekf_companion.lidar.livox_command import configure, read_answer
from ekf_companion.lidar.readers import read
from sim_autopilot.__main__ import app
from sim_autopilot.lidar.motion import GRAVITY
from sim_autopilot.lidar.radar import RAYS, RadarErrors, simulate_radar
from sim_autopilot.lidar.record import TICK, UNIT, ImuErrors, simulate, usual_lidar
from sim_autopilot.lidar.worlds import WORLDS
from sim_autopilot.lidar.write import write_sequence

PERFECT = ImuErrors(
    gyro_noise=0, accel_noise=0, gyro_bias=0, accel_bias=0, gyro_walk=0, accel_walk=0
)
SLOW = {"forest", "street"}
EACH_WORLD = [pytest.param(w, marks=[pytest.mark.campaign] * (w in SLOW)) for w in WORLDS]


def placed(flown, k):
    """Return the points of a scan in the world, by the truth at their own times."""
    part = slice(flown.first[k], flown.first[k + 1])
    times = flown.stamp[k] + flown.dt[part] * TICK
    body = flown.xyz[part] * UNIT @ flown.lidar.rotation.T + flown.lidar.position
    turned = np.einsum("nij,nj->ni", flown.motion.rotation(times), body)
    return turned + flown.motion.position(times), flown.label[part], times


def distance(world, points, times, label):
    """Return how far points lie from the nearest surface of a world."""
    best = np.abs(points[:, 2]) if world.has_ground else np.full(len(points), np.inf)
    moving = np.concatenate((world.movers[:, :6], world.movers[:, 6:]), 1)
    for row in [*world.boxes, *moving]:
        place = points - (row[6:] * times[:, None] if len(row) > 6 else 0.0)
        low, high = row[:3], row[3:6]
        outside = np.linalg.norm(np.maximum(np.maximum(low - place, place - high), 0.0), axis=1)
        inside = np.minimum(place - low, high - place).min(axis=1)
        best = np.minimum(best, np.where(outside > 0, outside, np.abs(inside)))
    for x, y, radius, _, _ in world.cylinders:
        best = np.minimum(best, np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - radius))
    for x, y, z, radius in world.spheres:
        away = np.linalg.norm(points - (x, y, z), axis=1)
        best = np.where((label == 2) & (away < radius + 0.1), 0.0, best)
    return best


@pytest.mark.parametrize("world", EACH_WORLD)
def test_points_placed_by_the_truth_lie_on_the_walls(world):
    flown = simulate(world, 5, duration=9.0)
    errors = []
    for k in range(60, len(flown.stamp), 7):
        points, label, times = placed(flown, k)
        errors.append(distance(flown.world, points, times, label))
    # 20 to 30 mm of noise, and 0.2 mrad of some tens of metres
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.035
    assert len(np.concatenate(errors)) > 1000


@pytest.mark.parametrize("world", EACH_WORLD)
def test_the_inertial_samples_integrate_back_to_the_truth(world):
    flown = simulate(world, 5, duration=14.0, errors=PERFECT)
    step = 1 / flown.errors.rate
    begin = flown.imu_stamp[:1] - step / 2
    C = flown.motion.rotation(begin)[0]
    position, velocity = flown.motion.position(begin)[0], flown.motion.velocity(begin)[0]
    for w, f in zip(flown.gyro.astype(float), flown.accel.astype(float), strict=True):
        half = rotation(w * step / 2)
        accel = C @ half @ f - (0, 0, GRAVITY)
        position = position + velocity * step + accel * step**2 / 2
        velocity = velocity + accel * step
        C = C @ half @ half
    end = flown.imu_stamp[-1:] + step / 2
    angle = np.linalg.norm(C - flown.motion.rotation(end)[0]) / np.sqrt(2)
    # The middle stands for the interval: second order in 5 ms
    assert np.linalg.norm(position - flown.motion.position(end)[0]) < 0.05
    assert np.linalg.norm(velocity - flown.motion.velocity(end)[0]) < 0.01
    assert angle < np.radians(0.02)


def rotation(vector):
    """Return the rotation of a rotation vector."""
    angle = np.linalg.norm(vector)
    x, y, z = vector
    K = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    return (
        np.eye(3)
        + np.sinc(angle / np.pi) * K
        + (1 - np.cos(angle)) / max(angle, 1e-12) ** 2 * (K @ K)
    )


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        write_sequence(tmp_path / name, simulate("street", seed, duration=3.0, name="one"))
    for file in ("lidar.npz", "imu.npz", "truth.npz", "calib.json"):
        one = (tmp_path / "a" / file).read_bytes()
        assert one == (tmp_path / "b" / file).read_bytes()
        assert (one == (tmp_path / "c" / file).read_bytes()) == (file == "calib.json")
    one, same, other = (simulate_radar("room", seed, duration=3.0) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.doppler, same.doppler)
    assert len(one.doppler) != len(other.doppler) or (one.doppler != other.doppler).any()


def test_the_noise_and_the_biases_are_those_of_the_sensor():
    noisy, perfect = (simulate("room", 2, duration=30.0, errors=one) for one in (None, PERFECT))
    error = noisy.gyro.astype(float) - perfect.gyro - noisy.gyro_bias
    density = error.std() / np.sqrt(noisy.errors.rate)
    assert density == pytest.approx(noisy.errors.gyro_noise, rel=0.05)
    assert 0.0005 < np.abs(noisy.gyro_bias).max() < 0.02


def test_the_speeds_of_a_radar_are_those_of_what_stands_still_and_of_cars():
    exact = replace(RAYS, range_sigma=0.0, angle_sigma=0.0, missing=0.0)
    errors = RadarErrors(shared_angle=0.0, speed_sigma=0.0, step=0.0, ghosts=0.0)
    flown = simulate_radar(
        "street", 1, duration=8.0, errors=errors, radar=usual_lidar("street", exact)
    )
    t = np.repeat(flown.stamp, np.diff(flown.first)) + 0.5 * errors.frame
    direction = flown.xyz / np.linalg.norm(flown.xyz, axis=1)[:, None]
    motion, mount = flown.motion, flown.lidar
    body = np.einsum("nji,nj->ni", motion.rotation(t), motion.velocity(t))
    vel = (body + np.cross(motion.gyro(t), mount.position)) @ mount.rotation
    error = flown.doppler + (direction * vel).sum(axis=1)
    still = flown.label == 0
    assert np.abs(error[still]).max() < 0.02  # points have steps of 3 mm
    assert np.abs(error[flown.label == 1]).max() > 1.0
    wraps = simulate_radar("street", 1, duration=8.0, errors=RadarErrors(most_speed=2.0))
    assert np.abs(wraps.doppler).max() <= 2.0 + 0.0625


def test_cars_move_in_the_street():
    flown = simulate("street", 1, duration=6.0)
    assert (flown.label == 1).any()


def test_the_command_writes_a_recording_and_refuses_another_world(tmp_path):
    run = CliRunner().invoke
    done = run(app, ["lidar", str(tmp_path / "r"), "--world", "plain", "--duration", "2"])
    assert done.exit_code == 0
    assert (tmp_path / "r/lidar.npz").is_file()
    beams = ["--beams", "radar", "--duration", "3"]
    assert run(app, ["lidar", str(tmp_path / "radar"), *beams]).exit_code == 0
    assert "doppler" in np.load(tmp_path / "radar/lidar.npz")
    refused = run(app, ["lidar", str(tmp_path / "s"), "--world", "sea"])
    assert refused.exit_code == 2


def test_the_command_writes_what_a_livox_sends(tmp_path):
    done = CliRunner().invoke(app, ["lidar", str(tmp_path / "r.pcap"), "--duration", "2"])
    assert done.exit_code == 0, done.output
    assert "a Livox at 192.168.1.150: 19 scans" in read(tmp_path / "r.pcap").decisions[0]


def test_a_livox_on_the_network_sends_once_it_is_told_to():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind(("127.0.0.1", 0))
        port = ours.getsockname()[1]
    options = ["livox", "127.0.0.2", "--port", str(port), "--duration", "2"]
    done = []
    thread = threading.Thread(target=lambda: done.append(CliRunner().invoke(app, options)))
    thread.start()
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
        one.settimeout(0.5)
    points, samples, commands = sockets
    said = configure(1, "127.0.0.1", *(one.getsockname()[1] for one in (points, samples)))
    answer = None
    while answer is None:  # it may not have started yet
        commands.sendto(said, ("127.0.0.2", port))
        try:
            answer, sender = commands.recvfrom(2000)
        except (TimeoutError, ConnectionRefusedError):
            continue
    assert read_answer(answer, 1) == ""
    assert sender == ("127.0.0.2", port)
    found = [livox.decode(one.recv(2000)) for one in (points, samples)]
    assert [type(one) for one in found] == [livox.Points, livox.Inertial]
    thread.join()
    for one in sockets:
        one.close()
    assert done[0].exit_code == 0, done[0].output
    assert "datagrams sent" in done[0].output
