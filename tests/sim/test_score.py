import math

import numpy as np
import pytest

from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.score import LOCAL_NED, Witness

CONFIG = SimConfig()
ORIGIN = LocalFrame(math.radians(47.3980001), math.radians(8.5460002), 490.123)
LATE_NS = 2_000_000


@pytest.fixture(scope="module")
def flight():
    return Flight.plan("figure-eight", CONFIG, duration=30.0)


def witness_of(
    flight,
    *,
    shift_n=(0.0, 0.0, 0.0),
    shift_vel_n=(0.0, 0.0, 0.0),
    turn=(0.0, 0.0, 0.0),
    std=1.0,
    origin=ORIGIN,
    frames=(20, 12),
):
    """Return a witness of ODOMETRY at 50 Hz with a known error, as an estimator sends it."""
    witness, autopilot, us = Witness(flight), Autopilot(CONFIG), Sender(1, 194)
    if origin is not None:
        autopilot.receive(
            us.message(
                "GPS_GLOBAL_ORIGIN",
                latitude=round(math.degrees(origin.lat) * 1e7),
                longitude=round(math.degrees(origin.lon) * 1e7),
                altitude=round(origin.alt * 1e3),
            ),
            now_ns=0,
        )
    times = flight.first_ns + flight.period_ns * np.arange(len(flight))
    for now_ns in times.tolist():
        witness.sent(now_ns)
    truth = flight.truth_at(times)
    about = ORIGIN if origin is None else origin
    pos_n = about.to_ned(truth.lat, truth.lon, truth.alt) + shift_n
    euler = truth.euler + np.array(turn)
    q_nb = so3.from_euler(*euler.T)
    vel = truth.vel_n + shift_vel_n
    if frames[1] != LOCAL_NED:
        vel = so3.rotate(so3.conjugate(q_nb), vel)
    covariance = np.zeros(21)
    covariance[[0, 6, 11, 15, 18, 20]] = std**2
    for i in range(0, len(times), 5):
        x, y, z = pos_n[i]
        vx, vy, vz = vel[i]
        data = us.message(
            "ODOMETRY",
            time_usec=int(times[i]) // 1000,
            frame_id=frames[0],
            child_frame_id=frames[1],
            **{"x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz},
            q=tuple(q_nb[i]),
            pose_covariance=tuple(covariance),
            velocity_covariance=tuple(covariance),
            reset_counter=1 if i < 5000 else 2,
        )
        autopilot.receive(data, now_ns=int(times[i]) + LATE_NS)
    for message in autopilot.received():
        witness.receive(message)
    return witness


def test_a_perfect_estimate_has_no_error_but_its_rounding(flight):
    score = witness_of(flight).score(after=10.0)
    assert score["origin"] == "GPS_GLOBAL_ORIGIN"
    # the origin's 1e-7 degrees, 6 mm and 4 mm, and the altitude's millimetre
    assert score["horizontal_m"]["max"] < 0.01
    assert score["vertical_m"]["max"] < 0.002
    assert score["velocity_mps"]["max"] < 1e-4
    for axis in ("roll_deg", "pitch_deg", "yaw_deg"):
        assert score[axis]["max"] < 1e-4
    assert score["odometry"]["rate_hz"] == 50.0
    assert score["odometry"]["scored"] == 1000
    assert score["odometry"]["resets"] == 1
    assert score["latency_ms"] == {"p50": 2.0, "p99": 2.0, "max": 2.0}
    assert set(score["inside_2_sigma"].values()) == {1.0}


def test_a_shifted_estimate_has_the_shift_as_its_error(flight):
    score = witness_of(
        flight, shift_n=(0.3, -0.4, 1.5), shift_vel_n=(0.1, 0.0, -0.2), std=0.1
    ).score()
    assert score["horizontal_m"]["rms"] == pytest.approx(0.5, abs=0.01)  # the origin's rounding
    assert score["vertical_m"]["rms"] == pytest.approx(1.5, abs=0.002)
    assert score["velocity_mps"]["rms"] == pytest.approx(math.hypot(0.1, 0.2), abs=1e-4)
    assert score["inside_2_sigma"]["horizontal"] == 0.0
    assert score["inside_2_sigma"]["vertical"] == 0.0


@pytest.mark.parametrize("frames", [(1, 1), (1, 12)])
def test_a_velocity_is_scored_along_the_axes_that_the_message_names(flight, frames):
    score = witness_of(flight, frames=frames, shift_vel_n=(0.1, 0.0, -0.2), std=0.1).score()
    assert score["odometry"]["not_scored"] == 0
    assert score["velocity_mps"]["rms"] == pytest.approx(math.hypot(0.1, 0.2), abs=1e-4)


def test_a_turned_estimate_has_the_turn_as_its_error(flight):
    score = witness_of(flight, turn=np.radians([0.5, -1.0, 2.0])).score()
    assert score["roll_deg"]["rms"] == pytest.approx(0.5, abs=1e-3)
    assert score["pitch_deg"]["rms"] == pytest.approx(1.0, abs=1e-3)
    assert score["yaw_deg"]["rms"] == pytest.approx(2.0, abs=1e-3)
    # velocity is turned by the message's own attitude, so it does not suffer
    assert score["velocity_mps"]["max"] < 1e-4


def test_without_an_origin_the_mean_offset_is_taken_off_and_the_score_says_so(flight):
    score = witness_of(flight, origin=None, shift_n=(5.0, 5.0, 5.0)).score()
    assert "mean offset" in score["origin"]
    assert score["horizontal_m"]["max"] < 0.01
    assert score["vertical_m"]["max"] < 0.01


def test_frames_that_mean_something_else_are_counted_and_not_scored(flight):
    score = witness_of(flight, frames=(4, 12)).score()
    assert score["odometry"]["received"] == score["odometry"]["not_scored"] == 1500
    assert score["odometry"]["scored"] == 0
    assert "horizontal_m" not in score


def test_no_estimate_gives_a_score_that_says_so(flight):
    score = Witness(flight).score()
    assert score["odometry"]["received"] == 0
    assert score["latency_ms"] is None
