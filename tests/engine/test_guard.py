"""Rule 25: the guard against double counting, played by the fake autopilot, frame by frame."""

import itertools
import logging

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.keys import with_value
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.logs import tlog
from ekf_companion.mavlink import loop_rate
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.decode import Family, receiver, trim
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.fusion import NAMES
from ekf_companion.mavlink.messages import IDS
from ekf_companion.replay.read import read
from ekf_companion.review.convert import convert, estimate, estimate_and_smooth
from sim_autopilot.acceptance import DEFAULTS, Reception
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import ImuConfig, SimConfig, StreamConfig
from sim_autopilot.flight import Flight
from sim_autopilot.judgement import Stack

SECOND_NS = 1_000_000_000
US = 194
READ, VALUE = IDS["PARAM_REQUEST_READ"], IDS["PARAM_VALUE"]
WORDS = "would fuse"
BOTH = {
    Kind.PX4: {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 7},
    Kind.ARDUPILOT: {"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6, "EK3_SRC1_VELXY": 6},
}
LIFTED = {
    Kind.PX4: {"EKF2_GPS_CTRL": 0},
    Kind.ARDUPILOT: {"EK3_SRC1_VELZ": 6},
}
"""What makes of both only ours."""
RATE = 100
"""Of the inertial samples, Hz: the guard decides alike at any."""
IMU = ImuConfig(rate=float(RATE))
KINDS = pytest.mark.parametrize("kind", list(Kind))


@pytest.fixture(scope="module")
def cycles():
    return list(Flight.plan("hover", SimConfig(imu=IMU), duration=8.0).cycles())


@pytest.fixture(autouse=True)
def said(caplog):
    caplog.set_level(logging.INFO)
    return caplog


class Link:
    """An autopilot and a companion who hear each other, and what went over the link."""

    def __init__(self, kind=Kind.PX4, parameters=(), *, streams=None, heading="auto", **odometry):
        self.autopilot = Autopilot(SimConfig(imu=IMU, streams=streams or StreamConfig()), kind)
        self.autopilot.parameters.clear()
        self.autopilot.parameters.update(DEFAULTS[Stack(kind.value)])
        self.autopilot.parameters.update(dict(parameters))
        self.config = with_value(
            Config(output=OutputConfig(odometry=OdometryConfig(**odometry))),
            *("heading.source", heading),
        )
        self.companion = Companion(self.config, is_recording=True)
        self.sent = []
        """Time and frame of what the companion sends, in order."""
        self.record = []
        self.is_deaf_to = set()
        """Names of parameters for which no request arrives."""
        self.foreign = []
        """Frames of a third that the companion hears next."""

    def fly(self, cycles, at=()):
        """Turn by turn; ``at`` gives what to do at which time, s."""
        plan = sorted(dict(at).items())
        begin_ns = cycles[0].t_ns
        for cycle in cycles:
            while plan and cycle.t_ns - begin_ns >= plan[0][0] * SECOND_NS:
                plan.pop(0)[1]()
            self.autopilot.cycle(cycle)
            heard = [*self.autopilot.data_to_send(), *self.foreign]
            self.foreign.clear()
            self.companion.receive(b"".join(heard), cycle.t_ns)
            self.companion.tick(cycle.t_ns)
            self._carry(cycle.t_ns)
        return self

    def _carry(self, now_ns):
        for data in self.companion.data_to_send():
            (frame,) = Splitter().feed(data)
            self.sent.append((now_ns, frame))
            if frame.message_id == READ and unpack(frame).param_id.decode() in self.is_deaf_to:
                continue
            self.autopilot.receive(data, now_ns)
        self.record += self.companion.session.outbox.take_record()

    def times(self, name):
        return [now_ns for now_ns, frame in self.sent if frame.message_id == IDS[name]]

    def asked(self):
        """Return time and name of each parameter that was asked for to know what is fused."""
        asked = [
            (now_ns, unpack(frame).param_id.decode())
            for now_ns, frame in self.sent
            if frame.message_id == READ
        ]
        others = {*trim.NAMES, *(name for names in receiver.NAMES.values() for name in names)}
        others |= {loop_rate.NAME}
        return [one for one in asked if one[1] not in others]

    def recorded(self, name):
        frames = Splitter().feed(b"".join(data for _, data in self.record))
        return [f for f in frames if f.message_id == IDS[name] and f.component_id == US]

    @property
    def verdict(self):
        return self.companion.session.guard.decision

    def set(self, values):
        """Return what sets parameters without a word over the link."""
        return lambda: self.autopilot.parameters.update(values)


# What is decided


@KINDS
def test_the_firmwares_defaults_are_streamed_to(cycles, said, kind):
    link = Link(kind).fly(cycles)
    assert len(link.times("ODOMETRY")) > 50
    assert said.text.count("ODOMETRY is streamed") == 1
    # And nothing left before the answer was there
    answer = link.companion.session.outbox.withheld["ODOMETRY"]
    assert answer == 0  # it came before the first estimate


@KINDS
def test_no_odometry_at_all_leaves_where_both_would_be_fused(cycles, said, kind):
    link = Link(kind, BOTH[kind]).fly(cycles)
    assert link.times("ODOMETRY") == []
    assert said.text.count("ODOMETRY is withheld") == 1
    assert said.text.count(WORDS) == 1
    texts = [unpack(f) for _, f in link.sent if f.message_id == IDS["STATUSTEXT"]]
    (text,) = [t for t in texts if b"no ODOMETRY" in t.text]
    assert text.text.startswith(b"Companion: no ODOMETRY: set E")
    assert (text.severity, text.id) == (4, 0)  # a warning, in one piece
    assert link.verdict.remedy
    assert link.verdict.parameters.items() >= BOTH[kind].items()
    # Health is told all the same, and nothing is missing from the numbers of what is sent
    assert len(link.times("ESTIMATOR_STATUS")) > 2
    numbers = [frame.sequence for _, frame in link.sent]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(numbers))
    withheld = link.companion.session.outbox.withheld["ODOMETRY"]
    assert withheld == len(link.recorded("ODOMETRY")) > 50


def test_a_warning_is_taken_back_at_once_though_the_same_was_said_within_the_minute(cycles):
    """The two parameters of a switch to ODOMETRY come one after the other."""
    link = Link(Kind.PX4)
    link.fly(
        cycles, {3.0: link.set({"EKF2_EV_CTRL": 15}), 5.0: link.set({"EKF2_GPS_CTRL": 0})}.items()
    )
    texts = [unpack(f).text for _, f in link.sent if f.message_id == IDS["STATUSTEXT"]]
    said = [text.split(b":", 1)[1] for text in texts if b"ODOMETRY" in text]
    assert [b"no ODOMETRY" in text for text in said] == [False, True, False]


@KINDS
def test_ours_alone_is_streamed_to_be_flown_on(cycles, kind):
    assert Link(kind, BOTH[kind] | LIFTED[kind]).fly(cycles).times("ODOMETRY")


def test_an_old_px4_is_decided_by_its_mask(cycles, said):
    link = Link(Kind.PX4)
    link.autopilot.parameters.clear()
    link.autopilot.parameters.update(EKF2_AID_MASK=9, EKF2_HGT_MODE=0)
    link.fly(cycles)
    assert link.times("ODOMETRY") == []
    assert "set EKF2_AID_MASK to 8 to fly on our estimate" in said.text
    # The new ones were asked for three times before the old one counted
    early = [name for now_ns, name in link.asked() if now_ns - link.asked()[0][0] < 3 * SECOND_NS]
    assert early.count("EKF2_EV_CTRL") == early.count("EKF2_GPS_CTRL") == 3


@pytest.mark.parametrize(
    ("parameters", "child"),
    [({"EKF2_AID_MASK": 280, "EKF2_HGT_MODE": 3}, 12), (LIFTED[Kind.PX4], 1)],
)
def test_an_old_px4_that_flies_on_ours_is_sent_the_velocity_of_the_body(cycles, parameters, child):
    link = Link(Kind.PX4)
    link.autopilot.parameters.clear()
    link.autopilot.parameters.update(BOTH[Kind.PX4] if child == 1 else {})
    link.autopilot.parameters.update(parameters)
    link.fly(cycles)
    sent = [unpack(frame) for _, frame in link.sent if frame.message_id == IDS["ODOMETRY"]]
    assert {m.child_frame_id for m in sent} == {child}
    assert len(sent) > 50


# What changes in flight


@KINDS
def test_it_is_lifted_within_two_seconds_of_a_change_that_nobody_tells(cycles, said, kind):
    link = Link(kind, BOTH[kind])
    link.fly(cycles, {4.0: link.set(LIFTED[kind])})
    first = link.times("ODOMETRY")[0] - cycles[0].t_ns
    assert 4 * SECOND_NS < first < 6 * SECOND_NS
    assert said.text.count("ODOMETRY is withheld") == said.text.count("ODOMETRY is streamed") == 1


@KINDS
def test_it_is_set_within_two_seconds_of_a_change_that_nobody_tells(cycles, kind):
    link = Link(kind)
    link.fly(cycles, {4.0: link.set(BOTH[kind])})
    last = link.times("ODOMETRY")[-1] - cycles[0].t_ns
    assert 4 * SECOND_NS < last < 6 * SECOND_NS


@KINDS
def test_a_change_by_a_ground_station_counts_at_once(cycles, kind):
    link = Link(kind, BOTH[kind] | LIFTED[kind])
    ((name, value),) = {**BOTH[kind], **LIFTED[kind]}.items() & LIFTED[kind].items()
    back = DEFAULTS[Stack(kind.value)][name]

    def change():
        # As the autopilot tells it to everybody, in its own way of laying an integer
        told = Autopilot(SimConfig(parameters={name: back}), kind)
        told.receive(
            Sender(255, 190).message(
                "PARAM_REQUEST_READ",
                target_system=1,
                target_component=1,
                param_id=name.encode(),
                param_index=-1,
            ),
            0,
        )
        link.foreign += told.data_to_send()
        link.is_deaf_to = {name}

    link.fly(cycles, {4.0: change})
    assert value != back
    last = link.times("ODOMETRY")[-1] - cycles[0].t_ns
    assert last <= 4 * SECOND_NS


def test_a_reboot_is_waited_for_and_asked_about_anew(cycles):
    link = Link(Kind.PX4)
    link.fly(cycles[: 5 * RATE])
    assert link.times("ODOMETRY")
    link.sent.clear()
    # Its clock begins anew, and with it other parameters
    link.autopilot.parameters.update(BOTH[Kind.PX4])
    link.fly(list(Flight.plan("hover", SimConfig(imu=IMU), duration=8.0, seed=2).cycles()))
    assert link.times("ODOMETRY") == []
    assert {name for _, name in link.asked()} >= {"EKF2_EV_CTRL", "EKF2_GPS_CTRL"}
    assert not link.verdict.is_streaming


@pytest.mark.parametrize("kinds", [(Kind.ARDUPILOT, Kind.PX4), (Kind.PX4, Kind.ARDUPILOT)])
def test_another_make_of_autopilot_on_the_same_wire_begins_all_anew_and_so_in_a_replay(
    cycles, tmp_path, kinds
):
    first, second = kinds
    link, swapped = Link(first), 44 * RATE // 10
    link.fly(cycles[:swapped])
    pipeline, other = link.companion.pipeline, Link(second)
    link.autopilot = other.autopilot
    link.fly(cycles[swapped:])
    companion = link.companion
    assert companion.pipeline is not pipeline
    assert companion.session.guard.decision.parameters.keys() & set(NAMES[Family(second.value)])
    sent = [unpack(frame) for _, frame in link.sent if frame.message_id == IDS["ODOMETRY"]]
    types = [message.estimator_type for message in sent]
    expected = {Kind.PX4: 3, Kind.ARDUPILOT: 5}
    assert (types[0], types[-1]) == (expected[first], expected[second])

    path, out = tmp_path / "swap.tlog", tmp_path / "again.tlog"
    path.write_bytes(b"".join(stamp.to_bytes(8, "big") + data for stamp, data in link.record))
    report = convert(path, out, Config())
    assert report.family == second.value
    assert any("the estimate begins anew there" in note for note in report.notes)
    again = [
        [
            frame.payload
            for _, raw in tlog.read(log).frames()
            for frame in Splitter().feed(raw)
            if frame.message_id == IDS["ODOMETRY"] and frame.component_id == US
        ]
        for log in (path, out)
    ]
    assert again[0] == again[1]
    # A row for each estimate, whichever way it is converted
    rows = [len(estimate(path, Config())[0]), len(estimate_and_smooth(path, Config())[1])]
    assert rows[0] == rows[1] > 0.95 * len(cycles)
    assert read(path).family == first.value  # the longer part


def test_an_autopilot_that_was_lost_is_asked_anew(cycles):
    link = Link(Kind.PX4).fly(cycles)
    assert link.verdict.is_streaming
    for k in range(60):
        link.companion.tick(cycles[-1].t_ns + k * SECOND_NS // 10)
    assert not link.verdict.is_streaming
    assert link.verdict.reason == "no autopilot is heard"


# What is not answered


@KINDS
def test_an_autopilot_that_answers_nothing_is_not_streamed_to(cycles, said, kind):
    link = Link(kind)
    link.autopilot.parameters.clear()
    link.fly(cycles)
    assert link.times("ODOMETRY") == []
    assert said.text.count("it answers no request for a parameter") == 1
    # Three times each to begin with, a second between two
    first = [now_ns for now_ns, name in link.asked() if name == link.asked()[0][1]][:3]
    assert all(b - a >= SECOND_NS for a, b in itertools.pairwise(first))


@pytest.mark.parametrize(
    ("kind", "name"), [(Kind.PX4, "EKF2_EV_CTRL"), (Kind.ARDUPILOT, "VISO_TYPE")]
)
def test_a_parameter_that_cannot_be_read_is_named(cycles, said, kind, name):
    link = Link(kind)
    link.is_deaf_to = {name}
    link.fly(cycles)
    assert link.times("ODOMETRY") == []
    assert f"it did not answer for {name}" in said.text
    assert f"look for {name} in a ground station" in said.text


@KINDS
def test_a_parameter_that_is_said_not_to_exist_fuses_nothing(cycles, said, kind):
    name = {Kind.PX4: "EKF2_EV_CTRL", Kind.ARDUPILOT: "VISO_TYPE"}[kind]
    link = Link(kind)
    link.is_deaf_to = {name}
    error = Sender(1, 1).message(
        "PARAM_ERROR", target_system=1, target_component=US, param_id=name.encode(), error=1
    )
    link.fly(cycles, {2.0: lambda: link.foreign.append(error)})
    assert link.times("ODOMETRY")
    assert f"{name} does not exist" in said.text


def test_answers_that_come_late_are_taken(cycles):
    link = Link(Kind.PX4)
    link.is_deaf_to = {"EKF2_EV_CTRL"}
    link.fly(cycles, {5.0: lambda: link.is_deaf_to.clear()})
    first = link.times("ODOMETRY")[0] - cycles[0].t_ns
    assert 5 * SECOND_NS < first < 7 * SECOND_NS


def test_who_answers_late_is_asked_for_all_the_rest_at_once(cycles):
    """Rule 25: seventeen questions that were all given up before."""
    link = Link(Kind.ARDUPILOT, BOTH[Kind.ARDUPILOT] | {"EK3_SRC1_POSZ": 1, "EK3_SRC1_VELZ": 6})
    link.is_deaf_to = set(NAMES[Family.ARDUPILOT])
    link.fly(cycles[: 6 * RATE])
    assert "answers no request" in link.verdict.reason
    link.is_deaf_to = set()
    link.fly(cycles[6 * RATE :])
    assert set(link.verdict.parameters) == set(NAMES[Family.ARDUPILOT])


def test_what_others_say_of_parameters_does_not_count(cycles):
    link = Link(Kind.PX4, BOTH[Kind.PX4])
    lie = Sender(1, 100).message("PARAM_VALUE", param_id=b"EKF2_EV_CTRL", param_type=6)
    link.fly(cycles, {k / 2: lambda: link.foreign.append(lie) for k in range(16)})
    assert link.times("ODOMETRY") == []


# What is configured


@KINDS
@pytest.mark.parametrize(
    ("odometry", "is_streaming", "words"),
    [
        ({"mode": "always"}, True, "nothing guards against counting GNSS twice"),
        ({"mode": "never"}, False, "output.odometry.mode is never"),
        ({"independent": True}, True, "our sensors are our own"),
    ],
)
def test_the_configuration_goes_before(cycles, said, kind, odometry, is_streaming, words):
    link = Link(kind, BOTH[kind], **odometry).fly(cycles)
    assert bool(link.times("ODOMETRY")) is is_streaming
    assert said.text.count(words) == 1
    # What is sent into the autopilot's own estimate is to be known
    assert bool(link.asked()) is is_streaming
    assert link.times("ESTIMATOR_STATUS")


ALONE = {
    Kind.PX4: {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0},
    Kind.ARDUPILOT: {
        "VISO_TYPE": 1,
        **{f"EK3_SRC1_{part}": 6 for part in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")},
    },
}
"""With these all that is fused is ours."""


def own_refused(link):
    """Return how many headings and positions were refused because they are made of ours."""
    refused = link.companion.session.decoder.refused
    return {
        name: refused[f"{name}: made of our own"] for name in ("heading", "GLOBAL_POSITION_INT")
    }


@KINDS
@pytest.mark.parametrize("odometry", [{"mode": "always"}, {"independent": True}])
def test_rule_16_where_all_is_sent_our_own_echo_is_still_no_measurement(cycles, kind, odometry):
    """Rules 16 and 25: whatever the mode; and what is streamed stays as the mode says."""
    link = Link(kind, **odometry).fly(cycles)
    assert own_refused(link)["heading"] == 0
    for parameters in (ALONE[kind], BOTH[kind] | {"EK3_SRC1_YAW": 6}):
        link = Link(kind, parameters, **odometry).fly(cycles)
        assert min(own_refused(link).values()) > 20  # PX4's begin with its origin
        assert len(link.times("ODOMETRY")) > 50


@KINDS
def test_rule_16_who_does_not_say_what_it_fuses_may_fuse_ours(cycles, kind):
    """Rules 16 and 25: an autopilot that answers nothing, and is sent to all the same."""
    link = Link(kind, mode="always")
    link.is_deaf_to = set(NAMES[Family(kind.value)])
    link.fly(cycles)
    assert link.times("ODOMETRY")
    assert min(own_refused(link).values()) > 15
    link = Link(kind, mode="never").fly(cycles)
    assert max(own_refused(link).values()) == 0


def test_rule_16_what_it_fuses_from_now_on_counts_within_two_seconds(cycles):
    """Rules 16 and 25: a change that nobody tells."""
    link = Link(Kind.PX4, mode="always").fly(cycles[: 4 * RATE])
    assert own_refused(link)["heading"] == 0
    link.autopilot.parameters.update(ALONE[Kind.PX4])
    link.fly(cycles[4 * RATE :])
    assert own_refused(link)["heading"] >= 10 * (4 - 2)


def test_a_pilot_may_lift_and_set_it_by_our_own_parameter(cycles, said):
    link = Link(Kind.PX4, BOTH[Kind.PX4])

    def mode(value):
        return lambda: link.foreign.append(
            Sender(255, 190).message(
                "PARAM_SET",
                target_system=1,
                target_component=US,
                param_id=b"EC_ODOM_MODE",
                param_value=value,
                param_type=9,
            )
        )

    link.fly(cycles, {3.5: mode(1.0), 5.5: mode(0.0)})
    times = [now_ns - cycles[0].t_ns for now_ns in link.times("ODOMETRY")]
    assert 3.5 * SECOND_NS <= times[0] < 3.6 * SECOND_NS
    assert 5.4 * SECOND_NS < times[-1] <= 5.5 * SECOND_NS
    assert said.text.count(WORDS) == 2


def test_a_stack_that_nobody_knows_is_streamed_to(cycles):
    link = Link(Kind.PX4, BOTH[Kind.PX4], streams=StreamConfig(HEARTBEAT=0.0))
    beat = Sender(1, 1).message("HEARTBEAT", type=2, autopilot=0, mavlink_version=3)
    link.fly(cycles, {float(k): lambda: link.foreign.append(beat) for k in range(8)})
    assert link.times("ODOMETRY")
    assert link.asked() == []


def test_a_type_that_px4_refuses_never_leaves(cycles, said):
    """Rule 24: and that the configuration wanted it is said once."""
    link = Link(Kind.PX4, estimator_type="GPS_INS").fly(cycles)
    odometry = [unpack(f) for _, f in link.sent if f.message_id == IDS["ODOMETRY"]]
    assert {message.estimator_type for message in odometry} == {3}
    assert said.text.count("PX4 refuses GPS_INS") == 1


def test_a_frame_that_ardupilot_ignores_is_warned_of(cycles, said):
    """Rule 19."""
    link = Link(Kind.ARDUPILOT, frame="LOCAL_NED").fly(cycles[: 6 * RATE])
    assert said.text.count("ArduPilot ignores LOCAL_NED") == 1
    Link(Kind.ARDUPILOT).fly(cycles[:RATE])
    Link(Kind.PX4, frame="LOCAL_NED").fly(cycles[:RATE])
    assert said.text.count("ignores") == 1
    assert link.verdict.is_streaming


# What it costs, and what remains


@pytest.mark.parametrize(
    ("kind", "parameters", "most"),
    [(Kind.PX4, {}, 150), (Kind.ARDUPILOT, {}, 150), (Kind.ARDUPILOT, BOTH[Kind.ARDUPILOT], 900)],
)
def test_watching_costs_little_of_the_link(cycles, kind, parameters, most):
    link = Link(kind, parameters).fly(cycles)
    begin_ns = cycles[0].t_ns + 4 * SECOND_NS
    asked = sum(len(f.raw) for t, f in link.sent if f.message_id == READ and t >= begin_ns)
    frames = Splitter().feed(b"".join(data for _, data in link.record))
    sizes = [len(f.raw) for f in frames if f.message_id == VALUE]
    per_second = (asked + sum(sizes) / len(sizes) * len(link.asked()) / 2) / 4
    assert 0 < per_second < most


def test_a_recorded_flight_converts_to_the_odometry_that_was_withheld(cycles, tmp_path):
    link = Link(Kind.PX4, BOTH[Kind.PX4])
    link.fly(cycles, {5.0: link.set(LIFTED[Kind.PX4])})
    assert_converts_to_the_same(link, tmp_path)
    assert len(link.recorded("ODOMETRY")) > len(link.times("ODOMETRY")) > 0


def assert_converts_to_the_same(link, tmp_path):
    """Compare every ODOMETRY and every refusal, live and in a replay."""
    path, out = tmp_path / "flight.tlog", tmp_path / "again.tlog"
    path.write_bytes(b"".join(stamp.to_bytes(8, "big") + data for stamp, data in link.record))
    report = convert(path, out, link.config)
    refused = link.companion.session.decoder.refused
    assert {name: report.refused.get(f"refused: {name}") for name in refused} == dict(refused)
    ours = [
        [
            frame.payload
            for _, raw in tlog.read(log).frames()
            for frame in Splitter().feed(raw)
            if frame.message_id == IDS["ODOMETRY"] and frame.component_id == US
        ]
        for log in (path, out)
    ]
    assert ours[0] == ours[1]
    assert len(ours[0]) > 50


@pytest.mark.parametrize("mode", ["auto", "always"])
@pytest.mark.parametrize("deaf", [{"EKF2_EV_CTRL", "EKF2_GPS_CTRL"}, set(NAMES[Family.PX4])])
def test_rule_38_what_is_never_answered_is_given_up_at_the_same_frame_in_a_replay(
    cycles, tmp_path, mode, deaf
):
    """Rule 38: the heading that the autopilot makes of ours is refused from that frame on."""
    link = Link(Kind.PX4, heading="autopilot", mode=mode)
    link.autopilot.parameters.clear()
    link.autopilot.parameters.update(EKF2_AID_MASK=24, EKF2_HGT_MODE=3)
    link.is_deaf_to = deaf
    link.fly(cycles)
    assert (own_refused(link)["heading"] > 0) is (mode == "always" or len(deaf) == 2)
    assert_converts_to_the_same(link, tmp_path)


def test_rule_38_a_mode_that_was_set_in_flight_is_set_in_a_replay(cycles, tmp_path):
    """Rule 38: with it goes what the autopilot is asked for, and what is refused."""
    link = Link(Kind.PX4, ALONE[Kind.PX4], heading="autopilot")
    never = Sender(255, 190).message(
        "PARAM_SET",
        target_system=1,
        target_component=US,
        param_id=b"EC_ODOM_MODE",
        param_value=2.0,
        param_type=9,
    )
    link.fly(cycles, {4.0: lambda: link.foreign.append(never)})
    assert 0 < own_refused(link)["heading"] < 70
    assert_converts_to_the_same(link, tmp_path)


def test_a_px4_that_flies_on_ours_gets_its_origin_before_it_fuses_anything(cycles):
    link = Link(Kind.PX4, ALONE[Kind.PX4])
    link.autopilot.reception = Reception("px4", link.autopilot.parameters)
    link.fly(cycles)
    origins = link.times("SET_GPS_GLOBAL_ORIGIN")
    assert len(origins) == 1
    assert min(link.times("ODOMETRY")) > origins[0]
    assert link.autopilot.reception.fused > 50
    assert link.autopilot.reception.misplaced == 0
