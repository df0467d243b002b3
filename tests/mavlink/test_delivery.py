"""ODOMETRY over a line that is slow, late, uneven, lossy, or stands still."""

import pytest

from ekf_companion.mavlink.event import Advised, Noted
from tests.mavlink.conversation import MS, PX4, SECOND
from tests.mavlink.line import Flown, Way

FAR = 0.5
"""s. An autopilot is set to no more than half of it."""
PX4_FUSED = {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 0.0, "EKF2_EV_DELAY": 0.0}


def both(**way):
    """Return a flight on a line whose two ways are alike."""
    return Flown(Way(**way), Way(**way)).take_off()


def texts(flown):
    return [text for _, text in flown.holds]


@pytest.mark.parametrize(("baud", "rate"), [(115200, 30), (57600, 15), (38400, 7.5)])
def test_the_rate_falls_to_what_a_line_of_unknown_speed_carries(baud, rate):
    """57600 baud carry 5760 bytes/s, thirty ODOMETRY 7400."""
    flown = Flown(Way(rate=baud / 10)).take_off().fly(60)
    assert texts(flown) == []
    assert max(flown.ages()) < FAR
    assert max(flown.ages(begin=40)) < 0.3
    assert rate <= flown.rate(40, 60) < 1.4 * rate + 1


@pytest.mark.parametrize("bytes_s", [5760, 3840])
def test_a_line_that_becomes_slow_in_flight_brings_nothing_late(bytes_s):
    flown = Flown(Way()).take_off().fly(20)
    flown.there.rate = bytes_s
    flown.fly(40)
    assert texts(flown) == []
    assert max(flown.ages()) < FAR
    assert flown.rate(50, 60) >= 5


def test_of_a_line_whose_speed_is_known_no_more_is_asked_than_it_carries():
    for bytes_s, rate in ((11520, 30), (5760, 15), (3840, 7.5), (1920, 5)):
        flown = Flown(Way(rate=bytes_s))
        flown.session.delivery.pacing.capacity = bytes_s
        flown.fly(20)
        assert texts(flown) == []
        assert max(flown.ages(begin=1)) < 0.3
        assert flown.rate(10, 20) == pytest.approx(rate, abs=0.6)


def test_the_rate_rises_again_when_the_line_does():
    flown = Flown(Way(rate=5760)).take_off().fly(20)
    assert flown.rate(10, 20) < 17
    flown.there.rate = 1e9
    flown.fly(40)
    assert flown.rate(50, 60) == pytest.approx(30, abs=0.5)


def test_a_queue_on_the_way_to_us_slows_nothing_down():
    """As of an autopilot that streams more than its own line carries: the answers wait there."""
    flown = Flown(Way()).take_off().fly(10)
    flown.back.delay_ns = 180 * MS
    flown.fly(10)
    assert flown.rate(11, 20) == pytest.approx(30, abs=0.5)


def notes(flown):
    return [event.text for event in flown.events if isinstance(event, Noted)]


def test_our_own_loop_that_stalls_is_named_and_no_full_line():
    flown = Flown(Way()).take_off().fly(10)
    flown.loop_ns = 120 * MS
    flown.fly(20)
    assert notes(flown) == [
        "This board lets the daemon wait for 120 ms, so that ODOMETRY leaves late: see what else "
        "takes its processor (top)"
    ]
    assert flown.session.delivery.pacing.every == 1
    assert flown.rate(11, 30) == pytest.approx(30, abs=0.5)


def test_a_full_line_is_named_though_our_own_loop_stalls_a_little():
    flown = Flown(Way(rate=5760)).take_off()
    flown.loop_ns = 20 * MS
    flown.fly(20)
    (note,) = notes(flown)
    assert note.startswith("The line to the autopilot is full")


def test_odometry_that_our_own_loop_holds_back_blames_no_link():
    flown = Flown(Way()).take_off().fly(10)
    flown.loop_ns = 600 * MS
    flown.fly(5)
    assert texts(flown)[0].startswith("companion ")
    assert "this board lets the daemon wait" in flown.session.delivery.hold.reason
    assert "top" in flown.session.delivery.hold.remedy


@pytest.mark.parametrize("clock", [0.98, 1.02])
def test_a_clock_that_runs_unevenly_is_no_queue(clock):
    """As a simulator's on a busy machine."""
    flown = Flown(Way(), clock=clock).take_off().fly(60)
    assert flown.rate(10, 60) == pytest.approx(30, abs=0.5)
    slow = Flown(Way(rate=5760), clock=clock).take_off().fly(60)
    assert max(slow.ages()) < FAR


def test_a_way_that_becomes_longer_is_no_queue_for_ever():
    flown = Flown(Way()).take_off().fly(20)
    flown.there.delay_ns = 140 * MS
    flown.fly(100)
    assert flown.rate(110, 120) == pytest.approx(30, abs=0.5)


@pytest.mark.parametrize("bytes_s", [300, 1])
def test_a_line_that_jams_ends_odometry_within_two_seconds(bytes_s):
    flown = Flown(Way()).take_off().fly(20)
    flown.there.rate = bytes_s
    flown.fly(10)
    ((at, text),) = flown.holds
    assert at < 22.0
    assert text.startswith(("autopilot answers no more", "link "))
    assert len(flown.ages(begin=20)) < 15


def test_a_line_that_is_free_again_is_used_again():
    stall = (20 * SECOND, 24 * SECOND)
    flown = Flown(Way(stalls=(stall,))).take_off().fly(40)
    assert texts(flown) == ["autopilot answers no more", None]
    assert 24.9 < flown.holds[1][0] < 26.5
    assert flown.rate(30, 40) > 14


def test_stalls_of_half_a_second_end_nothing():
    stalls = tuple((k * SECOND, k * SECOND + SECOND // 2) for k in range(10, 60, 5))
    flown = Flown(Way(stalls=stalls)).take_off().fly(60)
    assert texts(flown) == []
    assert flown.rate(10, 60) > 20


def test_a_tenth_of_all_frames_lost_either_way_ends_nothing():
    flown = both(loss=0.1).fly(300)
    assert texts(flown) == []
    assert flown.rate(10, 300) > 0.85 * 30


def test_a_line_too_slow_for_any_rate_is_tried_ever_more_seldom():
    flown = Flown(Way(rate=960)).take_off().fly(120)
    assert texts(flown)[0].startswith("link ")
    assert len(flown.ages(begin=60)) < 30
    assert len(flown.holds) < 16


def test_an_autopilot_that_never_answers_is_sent_as_before():
    """Old firmware, or a router that drops TIMESYNC."""
    flown = Flown(Way()).take_off()
    flown.is_answering = False
    flown.fly(30)
    assert texts(flown) == []
    assert flown.rate(10, 30) == pytest.approx(30, abs=0.5)


def test_an_autopilot_that_answers_no_more_is_sent_nothing():
    flown = Flown(Way()).take_off().fly(20)
    flown.is_answering = False
    flown.fly(10)
    assert texts(flown) == ["autopilot answers no more"]
    assert flown.holds[0][0] < 22


def test_on_the_ground_a_constant_delay_must_be_set():
    flown = Flown(Way(delay_ns=110 * MS), Way(delay_ns=110 * MS)).fly(10)
    assert texts(flown) == ["set VISO_DELAY_MS 220"]
    state = flown.session.stream_state
    assert "220 ms after its state was true" in state.reason
    assert "set VISO_DELAY_MS to 220" in state.remedy
    flown.parameters["VISO_DELAY_MS"] = 220.0
    flown.fly(5)
    assert texts(flown) == ["set VISO_DELAY_MS 220", None]
    assert flown.rate(13, 15) == pytest.approx(30, abs=1)
    assert flown.session.delivery.advice(flown.now_ns) == ""


def test_in_flight_a_constant_delay_is_told_and_goes_on():
    """Silence would end the flight."""
    flown = both(delay_ns=110 * MS).fly(20)
    assert texts(flown) == []
    (advised,) = [event for event in flown.events if isinstance(event, Advised)]
    assert advised.text == "ODOMETRY 220 ms late, still sent"
    assert "set VISO_DELAY_MS to 220" in advised.sentence
    assert flown.rate(10, 20) == pytest.approx(30, abs=0.5)


@pytest.mark.parametrize(
    ("way", "words"),
    [
        ({"delay_ns": 200 * MS}, "more than VISO_DELAY_MS can cover (250)"),
        ({"delay_ns": 60 * MS, "jitter_ns": 140 * MS}, "no value of VISO_DELAY_MS covers that"),
    ],
)
def test_where_no_setting_helps_that_is_said(way, words):
    flown = Flown(Way(**way), Way(**way)).fly(20)
    assert words in flown.session.delivery.advice(flown.now_ns)
    assert texts(flown)[0].startswith("link ")


def test_jitter_alone_neither_ends_nor_thins_it():
    flown = both(delay_ns=30 * MS, jitter_ns=50 * MS).fly(60)
    assert texts(flown) == []
    assert flown.rate(10, 60) == pytest.approx(30, abs=1)


def test_px4_is_told_its_own_parameter():
    flown = Flown(
        Way(delay_ns=100 * MS), Way(delay_ns=100 * MS), family=PX4, parameters=PX4_FUSED
    ).fly(10)
    assert texts(flown) == ["set EKF2_EV_DELAY 200"]


def test_what_is_not_fused_is_sent_however_late():
    """Nobody flies on it: a delay harms nobody, a queue still would."""
    flown = Flown(Way(delay_ns=400 * MS), parameters={"VISO_TYPE": 0.0, "VISO_DELAY_MS": 10.0}).fly(
        20
    )
    assert texts(flown) == []


def test_what_is_not_sent_is_recorded():
    flown = Flown(Way(rate=5760)).take_off()
    flown.fly(30)
    outbox = flown.session.outbox
    assert outbox.sent["ODOMETRY"] + outbox.withheld["ODOMETRY"] == 900
    assert outbox.withheld["ODOMETRY"] > 400


def test_a_link_that_is_opened_again_is_measured_anew():
    flown = Flown(Way(stalls=((20 * SECOND, 200 * SECOND),))).take_off().fly(23)
    assert flown.session.hold is not None
    flown.there = Way()
    flown.fly(7)
    assert flown.session.hold is None
    assert flown.rate(28, 30) > 14
