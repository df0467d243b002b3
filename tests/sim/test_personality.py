"""How a personality is chosen, what each does with ODOMETRY, and a reboot."""

import dataclasses

import pytest

from ekf_companion.core.settings.settings import HABITS
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.codec import Sender
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import PERSONALITIES, parse
from sim_autopilot.loop import Bench, StreamRequester
from sim_autopilot.score_table import reception
from tests.sim.imitated import FULL, cycles, planned, run
from tests.sim.wire import US, ask, named, read


def test_the_firmwares_differ_in_what_they_fuse_by_default():
    assert parse("px4").parameters["EKF2_EV_CTRL"] == 0
    assert parse("px4-old").parameters["EKF2_EV_CTRL"] == 15
    assert parse("px4-old").parameters["EKF2_GPS_CTRL"] == 7
    assert "EKF2_EV_CTRL" not in parse("px4-1.13").parameters
    assert parse("px4-1.13:EKF2_AID_MASK=9").parameters["EKF2_AID_MASK"] == 9
    for name in ("ardupilot", "ardupilot-old"):
        assert parse(name).parameters["VISO_TYPE"] == 0
        assert parse(name).parameters["EK3_SRC1_POSXY"] == 3


POSE = {
    "q": (1.0, 0.0, 0.0, 0.0),
    "pose_covariance": (1.0,) * 21,
    "velocity_covariance": (1.0,) * 21,
}


def odometry(**fields):
    sent = {"frame_id": 20, "child_frame_id": 12, "estimator_type": 3, **POSE, **fields}
    return Sender(*US).message("ODOMETRY", **sent)


@pytest.mark.parametrize("name", ["px4", "px4-old"])
def test_px4_refuses_an_estimator_type_aloud_each_time(name):
    autopilot = Autopilot(SimConfig(), personality=parse(name))
    for k in range(3):
        autopilot.receive(odometry(estimator_type=5, time_usec=k * 33_000), now_ns=0)
    texts = named(read(autopilot.data_to_send()), "STATUSTEXT")
    assert [(m.severity, m.text) for m in texts] == [
        (2, b"ODOMETRY: estimator_type 5 unsupported")
    ] * 3
    line = reception(autopilot.reception.summary())
    assert line == "odometry: accepted 0, refused 3: estimator_type 5 is refused (3)"


def test_an_old_px4_fuses_beside_gnss_what_a_new_one_does_not():
    for name, fused in (
        ("px4", 0),
        ("px4-old", 9),
        ("px4-1.13", 0),
        ("px4-1.13:EKF2_AID_MASK=9", 9),
    ):
        autopilot = Autopilot(SimConfig(), personality=parse(name))
        for k in range(10):
            autopilot.receive(odometry(time_usec=1000 + k * 33_000), now_ns=0)
        summary = autopilot.reception.summary()
        assert (summary["accepted"], summary["fused"]) == (10, fused)


def test_ardupilot_refuses_without_a_word():
    autopilot = Autopilot(SimConfig(), personality=parse("ardupilot:VISO_TYPE=1"))
    autopilot.receive(odometry(frame_id=1), now_ns=0)
    autopilot.receive(odometry(time_usec=50_000), now_ns=0)
    assert autopilot.data_to_send() == []
    assert sum(autopilot.reception.refused.values()) == 1
    assert autopilot.reception.accepted == 1


def test_reasons_are_counted_under_a_bounded_number_of_names():
    autopilot = Autopilot(SimConfig(), personality=parse("px4-old"))
    t = 0
    for k in range(100):
        t += 500_000 + k * 1000
        autopilot.receive(odometry(time_usec=t), now_ns=0)
    assert len(autopilot.reception.unfused) <= 33


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("px5", "no such personality; there are px4, px4-old"),
        ("px4:mising=0.1", "did you mean missing"),
        ("px4:missing=much", "must be a number"),
        ("px4:missing", "is not key=value"),
        ("px4:missing=1,missing=2", "stands twice"),
        ("px4:A_PARAMETER_TOO_LONG=1", "16 letters"),
    ],
)
def test_a_personality_that_cannot_be_meant_is_refused_with_a_remedy(text, words):
    with pytest.raises(ConfigError, match=words):
        parse(text)


def test_the_configuration_goes_before_the_personality():
    config = SimConfig()
    slow = dataclasses.replace(config, imu=dataclasses.replace(config.imu, rate=100.0))
    assert parse("ardupilot").suited(slow).imu.rate == 100.0
    assert parse("ardupilot").suited(config).imu.rate == 400.0
    assert parse("px4").suited(config).gnss.rate == 8.0
    assert parse("ardupilot").suited(config).compass.delay == HABITS["ardupilot"].mag_delay
    assert parse("px4").suited(config).compass == config.compass


@pytest.mark.parametrize("name", list(PERSONALITIES))
def test_the_same_seed_gives_the_same_bytes(name):
    def frames():
        flight = planned.__wrapped__(name, 1.5)
        bench = Bench(flight, StreamRequester(dict(FULL)), personality=PERSONALITIES[name])
        return list(bench.frames())

    assert frames() == frames()


def test_a_rebooted_autopilot_begins_its_numbers_anew():
    autopilot = Autopilot(planned("px4").config, personality=parse("px4:missing=0"))
    autopilot.parameters["EKF2_EV_CTRL"] = 3
    autopilot.receive(ask("HIGHRES_IMU", 250), now_ns=0)
    autopilot.reboot()
    assert autopilot.data_to_send() == []
    messages, _ = run(autopilot, cycles("px4")[:500])
    assert messages[0][1].sequence == 0
    assert len(named(messages, "HIGHRES_IMU")) == 100  # 50 Hz again
    assert autopilot.parameters["EKF2_EV_CTRL"] == 3
