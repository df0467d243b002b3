"""Somebody else who sends the autopilot poses."""

import pytest

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.event import Advised, HoldChanged
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.outbox import Message
from ekf_companion.mavlink.session import Session, SessionOptions
from tests.mavlink.conversation import ARDUPILOT, MS, SECOND, Voice, sent
from tests.mavlink.line import FUSED

POSE = {"usec": 1, "x": 1.0}


class Room:
    """A session, its autopilot that fuses ODOMETRY, and others."""

    def __init__(self, *, is_flying=False, parameters=FUSED, **options):
        self.session = Session(SessionOptions(rates={}, guard=GuardOptions(**options)))
        self.autopilot = Voice(family=ARDUPILOT)
        self.base_mode = 128 if is_flying else 0
        self.now_ns = 0
        self.events = []
        self.parameters = parameters
        self.go(2)

    def go(self, seconds, *others, rate=20.0, name="VISION_POSITION_ESTIMATE", fields=POSE):
        """Go on for so long, while others send."""
        period_ns = round(SECOND / rate)
        end_ns = self.now_ns + round(seconds * SECOND)
        while self.now_ns < end_ns:
            self.now_ns += 10 * MS
            if self.now_ns % (500 * MS) == 0:
                self._say("HEARTBEAT", type=2, autopilot=3, base_mode=self.base_mode)
            if self.now_ns % SECOND == 0:
                self.session.receive(self.autopilot.place(self.now_ns // MS), self.now_ns)
                for parameter, value in self.parameters.items():
                    self._say(
                        "PARAM_VALUE",
                        param_id=parameter.encode(),
                        param_value=value,
                        param_type=9,
                        param_count=1,
                    )
            for other in others if self.now_ns % period_ns == 0 else ():
                self.session.receive(other.say(name, **fields), self.now_ns)
            self.session.tick(self.now_ns)
            self.session.data_to_send()
            self.events += self.session.events()
        return self

    def _say(self, name, **fields):
        self.session.receive(self.autopilot.say(name, **fields), self.now_ns)

    @property
    def texts(self):
        """What the pilot was told of it."""
        held = [
            event.hold and event.hold.text for event in self.events if type(event) is HoldChanged
        ]
        return held, [event.text for event in self.events if type(event) is Advised]


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("VISION_POSITION_ESTIMATE", POSE),
        ("ODOMETRY", {"time_usec": 1}),
        ("VISION_SPEED_ESTIMATE", {"usec": 1}),
        ("VICON_POSITION_ESTIMATE", {"usec": 1}),
        ("ATT_POS_MOCAP", {"time_usec": 1}),
        ("GLOBAL_VISION_POSITION_ESTIMATE", {"usec": 1}),
        ("GLOBAL_POSITION_SENSOR", {"time_usec": 1}),
    ],
)
@pytest.mark.parametrize("ids", [(1, 197), (255, 190), (7, 1)])
def test_on_the_ground_ours_waits_while_another_sends_poses(name, fields, ids):
    room = Room()
    assert room.session.may_stream
    room.go(1, Voice(*ids), name=name, fields=fields)
    assert not room.session.may_stream
    assert room.texts == ([f"{ids[0]}/{ids[1]} sends poses too"], [])
    reason = room.session.stream_state.reason
    assert f"system {ids[0]}, component {ids[1]} sends {name} at 20 Hz" in reason


def test_it_is_sent_again_some_time_after_the_other_has_gone():
    room = Room().go(2, Voice(1, 197)).go(9)
    assert not room.session.may_stream
    room.go(2)
    assert room.session.may_stream
    assert room.texts[0] == ["1/197 sends poses too", None]


def test_of_two_companions_one_sends():
    """Each hears the other, and waits for another time."""
    room = Room().go(2, Voice(1, 195))
    room.go(8)
    room.go(20, Voice(1, 195))  # the other was the first to begin again
    assert not room.session.may_stream


def test_in_flight_what_the_autopilot_flies_by_goes_on():
    """Anybody can send such a message, and silence would leave it with the other alone."""
    room = Room(is_flying=True).go(5, Voice(1, 197))
    assert room.session.may_stream
    assert room.texts == ([], ["1/197 sends poses too"])
    room.base_mode = 0
    room.go(2, Voice(1, 197))
    assert not room.session.may_stream


def test_in_flight_it_can_be_made_to_stop():
    room = Room(is_flying=True, withhold_in_flight=True).go(5, Voice(1, 197))
    assert not room.session.may_stream


def test_where_the_other_ends_in_flight_ours_takes_its_place_soon():
    """The autopilot's failsafe comes after 5 s without any."""
    room = Room().go(3, Voice(1, 197))
    room.base_mode = 128
    room.go(3, Voice(1, 197))
    assert not room.session.may_stream
    room.go(2)
    assert room.session.may_stream


def test_it_can_be_made_to_go_on():
    room = Room(second_source="send").go(5, Voice(1, 197))
    assert room.session.may_stream
    assert room.texts == ([], ["1/197 sends poses too"])
    assert room.session.second_source.words.startswith("system 1, component 197 sends VISION")


def test_a_single_one_says_nothing():
    room = Room().go(10, Voice(1, 197), rate=0.5)
    assert room.session.may_stream


@pytest.mark.parametrize("who", [Voice(1, 1, ARDUPILOT), Voice(1, 194)])
def test_the_autopilots_own_and_an_echo_of_ours_are_no_second_source(who):
    room = Room().go(5, who, name="ODOMETRY", fields={"time_usec": 1})
    assert room.session.may_stream
    assert room.session.second_source.words == ""


def test_where_nothing_is_fused_it_is_only_shown():
    room = Room(parameters={"VISO_TYPE": 0.0}).go(5, Voice(1, 197))
    assert room.texts == ([], [])
    assert "component 197" in room.session.second_source.words


def test_many_invented_senders_take_no_memory():
    room = Room()
    for component in range(2, 190):
        room.go(0.1, Voice(1, component))
    assert len(room.session.second_source._heard) <= 16


def published(room, count, *, usual=1):
    """Return the reset counters of ODOMETRY that are sent 33 times a second."""
    found = []
    for _ in range(count):
        room.now_ns += 30 * MS
        payload = pack("ODOMETRY", time_usec=1, reset_counter=usual)
        room.session.publish(Message("ODOMETRY", payload, False), room.now_ns)
        found += [one.reset_counter for one in sent(room.session, "ODOMETRY")]
    return found


@pytest.mark.parametrize(
    ("name", "fields", "theirs"),
    [
        ("VISION_POSITION_ESTIMATE", POSE, 0),
        ("VISION_POSITION_ESTIMATE", {"usec": 1, "reset_counter": 7}, 7),
        ("ODOMETRY", {"time_usec": 1, "reset_counter": 3}, 3),
        ("ATT_POS_MOCAP", {"time_usec": 1}, 0),
        ("VISION_SPEED_ESTIMATE", {"usec": 1, "reset_counter": 9}, 1),
    ],
)
def test_in_flight_ours_takes_over_the_counter_of_poses_of_another(name, fields, theirs):
    room = Room(is_flying=True)
    assert published(room, 3) == [1, 1, 1]
    room.go(2, Voice(1, 197), rate=2.0, name=name, fields=fields)
    said = published(room, 3)
    assert said[0] == 1
    assert said[-1] == theirs
    # and a jump of ours moves it all the same
    assert published(room, 1, usual=2)[0] not in (said[-1], theirs)
