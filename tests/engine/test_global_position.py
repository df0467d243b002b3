"""A global position for an autopilot that fuses no ODOMETRY, and what guards it."""

import itertools
import logging
import math

import pytest

from ekf_companion.config.keys import with_value
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import parse
from sim_autopilot.flight import Flight
from tests.engine.test_guard import IMU, KINDS, SECOND_NS, Link

SLOT = {"EKF2_AGP0_ID": 194, "EKF2_AGP0_CTRL": 1}
FREE = {f"EKF2_AGP{k}_CTRL": 0 for k in range(4)}
ALONE = {"EKF2_GPS_CTRL": 0, **FREE, **SLOT}
METRES = 6.37e6


@pytest.fixture(autouse=True)
def said(caplog):
    caplog.set_level(logging.INFO)
    return caplog


class Given(Link):
    """A companion that gives an autopilot its position five times a second."""

    def __init__(self, kind, parameters=(), rate=5.0, **options):
        super().__init__(kind, parameters, **options)
        config = with_value(self.config, "output.global_position.rate", rate)
        self.companion.reload(config)

    def given(self, name):
        return [unpack(frame) for _, frame in self.sent if frame.message_id == IDS[name]]

    @property
    def position(self):
        return self.companion.session.global_position


@pytest.fixture(scope="module")
def cycles():
    return list(Flight.plan("hover", SimConfig(imu=IMU), duration=8.0).cycles())


@KINDS
def test_none_is_sent_by_default(cycles, kind):
    link = Given(kind, ALONE if kind is Kind.PX4 else (), rate=0.0).fly(cycles)
    assert not link.given("COMMAND_INT") + link.given("GLOBAL_POSITION_SENSOR")
    assert not [name for _, name in link.asked() if name.startswith("EKF2_AGP")]


def test_px4_without_gnss_fuses_it(cycles):
    link = Given(Kind.PX4, ALONE).fly(cycles)
    given = link.given("GLOBAL_POSITION_SENSOR")
    assert len(given) > 20
    assert link.autopilot.reception.positions == {"fused": len(given)}
    truth = cycles[-1].estimate
    last = given[-1]
    assert math.radians(last.lat * 1e-7) == pytest.approx(truth.lat, abs=3.0 / METRES)
    assert (last.source, last.id, last.target_system, last.target_component) == (6, 194, 1, 1)
    assert 0.1 < last.eph < 5.0
    assert 0.1 < last.epv < 5.0
    assert math.isnan(last.alt_ellipsoid)
    assert not link.given("COMMAND_INT")
    # Its own position is then ours
    refused = link.companion.session.decoder.refused
    assert refused["GLOBAL_POSITION_INT: made of our own"] > 0


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"EKF2_GPS_CTRL": 7}, "would count twice"),
        ({"EKF2_GPS_CTRL": 1}, "would count twice"),
        ({"EKF2_AGP0_CTRL": 0, "EKF2_AGP3_CTRL": 3, "EKF2_GPS_CTRL": 7}, "would count twice"),
        ({"EKF2_EV_CTRL": 1}, "fuses our ODOMETRY"),
    ],
)
def test_beside_its_own_gnss_or_our_odometry_px4_is_given_none(cycles, parameters, words):
    link = Given(Kind.PX4, ALONE | parameters).fly(cycles)
    assert not link.given("GLOBAL_POSITION_SENSOR")
    assert words in link.position.refusal
    # It is recorded, as a withheld ODOMETRY is
    assert len(link.recorded("GLOBAL_POSITION_SENSOR")) > 20


@pytest.mark.parametrize("names", [["EKF2_GPS_CTRL"], ["EKF2_AGP2_CTRL"], list(FREE)])
def test_what_px4_does_not_answer_is_no_permission(cycles, names):
    link = Given(Kind.PX4, ALONE)
    link.is_deaf_to = set(names)
    link.fly(cycles)
    assert not link.given("GLOBAL_POSITION_SENSOR")
    assert "not answered" in link.position.refusal


def test_it_stops_and_goes_on_within_two_seconds_of_a_change_that_nobody_tells(cycles, said):
    link = Given(Kind.PX4, ALONE)
    link.fly(cycles, {4.0: link.set({"EKF2_GPS_CTRL": 7}), 6.0: link.set({"EKF2_GPS_CTRL": 0})})
    begin = cycles[0].t_ns
    times = [(t - begin) * 1e-9 for t in link.times("GLOBAL_POSITION_SENSOR")]
    pause = max(b - a for a, b in itertools.pairwise(times))
    assert pause > 0.5
    assert times[-1] > 7.5
    assert said.text.count("No global position is sent") == 1
    assert b"set EKF2_GPS_CTRL 0" in b"".join(one.text for one in link.given("STATUSTEXT"))


def test_sensors_of_our_own_count_nothing_twice(cycles):
    link = Given(Kind.PX4, ALONE | {"EKF2_GPS_CTRL": 7}, independent=True).fly(cycles)
    assert link.given("GLOBAL_POSITION_SENSOR")


@pytest.fixture(scope="module")
def outage():
    """Return a flight whose receiver falls silent for good after ten seconds."""
    flight = list(Flight.plan("hover", SimConfig(imu=IMU), duration=15.0).cycles())
    end_ns = flight[0].t_ns + 10 * SECOND_NS
    return [one._replace(fix=None) if one.t_ns > end_ns else one for one in flight]


class Ardupilot(Given):
    """With a camera on board that says how the vehicle moves, in a frame of its own."""

    def __init__(self, **options):
        super().__init__(Kind.ARDUPILOT, **options)
        self.answers = []
        answer = self.autopilot._answer

        def note(frame, command, result):
            if command == 43003:
                self.answers.append(result)
            answer(frame, command, result)

        self.autopilot._answer = note

    def fly(self, cycles, at=()):
        camera = Sender(1, 197)
        for cycle in cycles:
            if cycle.number % 5 == 0:
                here = cycle.estimate
                pose = {"q": here.q_nb, "frame_id": 20, "child_frame_id": 255, "quality": 90}
                pose |= dict(zip("xyz", here.pos_n, strict=True), estimator_type=2)
                pose |= {"pose_covariance": [math.nan] * 21, "time_usec": cycle.t_ns // 1000}
                self.foreign.append(camera.message("ODOMETRY", **pose))
            super().fly([cycle], at)
        return self


def test_ardupilot_refuses_it_while_its_receiver_is_good(outage):
    link = Ardupilot().fly(outage[:900])
    given = link.given("COMMAND_INT")
    assert len(given) == len(link.answers) > 20
    assert set(link.answers) == {4}
    assert not link.given("GLOBAL_POSITION_SENSOR")
    last = given[-1]
    assert (last.command, last.frame, last.target_system, last.target_component) == (43003, 0, 1, 1)
    assert math.isnan(last.z)
    assert (last.param2, last.param4) == (0.0, 0.0)
    assert 0.1 < last.param3 < 5.0
    assert link.companion.session.decoder.refused["GLOBAL_POSITION_INT: made of our own"] == 0


def test_without_its_receiver_ardupilot_moves_to_it_and_is_no_measurement_any_more(outage):
    link = Ardupilot()
    link.companion.reload(with_value(link.companion.tuning.config, "visual_odometry.use", True))
    link.fly(outage)
    assert link.answers[-5:] == [0] * 5
    moved, truth = link.autopilot._last.estimate, outage[-1].estimate
    assert moved.lat == pytest.approx(truth.lat, abs=2.0 / METRES)
    assert link.companion.session.decoder.refused["GLOBAL_POSITION_INT: made of our own"] > 0


def test_what_only_inertial_samples_carry_is_not_given(outage):
    link = Ardupilot().fly(outage)
    silent = outage[-1].t_ns - link.times("COMMAND_INT")[-1]
    assert silent > 2 * SECOND_NS


def test_ardupilot_that_flies_on_our_odometry_is_given_no_other_position(cycles):
    parts = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
    link = Given(Kind.ARDUPILOT, {"VISO_TYPE": 1} | {f"EK3_SRC1_{part}": 6 for part in parts})
    link.fly(cycles)
    assert not link.given("COMMAND_INT")
    assert "fuses our ODOMETRY" in link.position.refusal


@pytest.mark.parametrize("fields", [{"frame": 3}, {"x": 910_000_000}, {"x": 0, "y": 0}])
def test_ardupilot_denies_what_is_no_place(outage, fields):
    place = {"target_system": 1, "command": 43003, "x": 474_000_000, "y": 85_000_000}
    link = Ardupilot().fly(outage[:20])
    link.autopilot.receive(Sender(1, 194).message("COMMAND_INT", **(place | fields)), 0)
    assert link.answers == [2]


@pytest.mark.parametrize(("firmware", "answer"), [("ardupilot-4.0", 3), ("ardupilot-old", 4)])
def test_an_ardupilot_before_4_5_does_not_know_it(outage, firmware, answer):
    link = Ardupilot()
    link.autopilot.personality = parse(firmware)
    link.fly(outage[:20])
    place = {"target_system": 1, "command": 43003, "x": 474_000_000, "y": 85_000_000}
    link.autopilot.receive(Sender(1, 194).message("COMMAND_INT", **place), 0)
    assert link.answers == [answer]


# The same GNSS by other ways


def test_after_a_reboot_it_waits_for_new_answers(cycles):
    link = Given(Kind.PX4, ALONE)
    begin = cycles[0].t_ns

    def reboot():
        link.autopilot.reboot()
        link.is_deaf_to = set(FREE)

    link.fly(cycles, {4.0: reboot})
    times = [(t - begin) * 1e-9 for t in link.times("GLOBAL_POSITION_SENSOR")]
    assert times
    # The clock of this autopilot goes on, so that nobody may notice; its answers age all the same
    assert max(times) < 4.0 + 5.5
    assert "GLOBAL_POSITION_SENSOR" in link.companion.session.outbox.sent


@pytest.mark.parametrize("mode", ["always", "auto"])
def test_where_odometry_is_fused_it_is_not_sent_whatever_the_mode(cycles, mode):
    link = Given(Kind.PX4, ALONE | {"EKF2_EV_CTRL": 15}, mode=mode).fly(cycles)
    assert not link.given("GLOBAL_POSITION_SENSOR")


def test_without_odometry_it_is_sent_all_the_same(cycles):
    link = Given(Kind.PX4, ALONE | {"EKF2_EV_CTRL": 15}, mode="never").fly(cycles)
    assert link.given("GLOBAL_POSITION_SENSOR")
    assert not link.given("ODOMETRY")


@pytest.mark.parametrize("slot", [1, 2, 3])
def test_any_slot_counts(cycles, slot):
    parameters = FREE | {f"EKF2_AGP{slot}_ID": 194, f"EKF2_AGP{slot}_CTRL": 1}
    beside = Given(Kind.PX4, parameters | {"EKF2_GPS_CTRL": 2}).fly(cycles)
    assert not beside.given("GLOBAL_POSITION_SENSOR")
    alone = Given(Kind.PX4, parameters | {"EKF2_GPS_CTRL": 0}).fly(cycles)
    assert alone.autopilot.reception.positions == {
        "fused": len(alone.given("GLOBAL_POSITION_SENSOR"))
    }


def test_a_set_that_ardupilot_could_switch_to_counts(cycles):
    parts = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
    sets = {"VISO_TYPE": 1, "EK3_SRC_OPTIONS": 0} | {f"EK3_SRC2_{part}": 6 for part in parts}
    link = Given(Kind.ARDUPILOT, sets).fly(cycles)
    assert not link.given("COMMAND_INT")


def test_what_a_reload_switches_off_ends(cycles):
    link = Given(Kind.PX4, ALONE)
    off = with_value(link.companion.tuning.config, "output.global_position.rate", 0.0)
    begin = cycles[0].t_ns
    link.fly(cycles, {5.0: lambda: link.companion.reload(off)})
    times = [(t - begin) * 1e-9 for t in link.times("GLOBAL_POSITION_SENSOR")]
    assert times
    assert max(times) < 5.1
