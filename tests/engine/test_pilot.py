"""What the pilot reads: once a minute of a kind, and at once what is grave."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from ekf_companion.config.config import Config
from ekf_companion.core.memory.enums import Aid, Source
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.announcer import Announcer
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.estimate_announcer import LONGEST_TEXT
from ekf_companion.engine.pilot import PilotTexts
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.engine.reasons import LONGEST_WORDS, ORDER, in_words
from ekf_companion.engine.warm_start import Outcome, Why
from ekf_companion.engine.wrong import Wrong
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.event import PeerLost, Rebooted
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.statustext import CHUNK, Severity
from ekf_companion.nav.state import Reason, Status
from tests.engine.recorded import frames
from tests.mavlink.conversation import SECOND, met, sent

INFO, WARNING = Severity.INFO, Severity.WARNING
HEALTH = Pipeline(FilterSettings()).health()


class Screen:
    """What a pilot reads of some texts, with the second in which it came."""

    def __init__(self):
        self.read = []
        self.now = 0
        self.texts = PilotTexts(lambda severity, text: self.read.append((self.now, text)))

    def at(self, second):
        """Go on to a second, and return the texts to send then, and that time, ns."""
        while self.now < second:
            self.now += 1
            self.texts.tick(self.now * SECOND)
        return self.texts

    def happen(self, second, size):
        """Let something happen that is counted by its size."""
        words, many = f"jumps {size} m", f"jumped {{}} times, {size} m"
        at_ns, texts = second * SECOND, self.at(second)
        texts.on_occurrence("jump", WARNING, words, at_ns, many=many, size=size)

    def be(self, second, state, **how):
        self.at(second).on_state("estimate", state, INFO, f"it is {state}", second * SECOND, **how)


def test_what_happens_again_and_again_is_counted_into_one_text_a_minute():
    screen = Screen()
    for second, size in enumerate([1.0, 2.0, 7.0, 3.0, 4.0] * 20):
        screen.happen(second, size)
    screen.at(300)
    counted = [(60, "jumped 59 times, 7.0 m"), (120, "jumped 40 times, 7.0 m")]
    assert screen.read == [(0, "jumps 1.0 m"), *counted]


def test_kinds_do_not_wait_for_one_another():
    screen = Screen()
    screen.happen(0, 1.0)
    screen.texts.on_occurrence("stall", WARNING, "stood still", 0)
    assert [text for _, text in screen.read] == ["jumps 1.0 m", "stood still"]


def test_a_state_that_comes_back_waits_and_is_sent_if_it_still_holds():
    screen = Screen()
    for second, state in ((0, "a"), (5, "b"), (10, "a"), (15, "b"), (20, "a")):
        screen.be(second, state)
    screen.at(59)
    assert screen.read == [(0, "it is a"), (5, "it is b")]
    screen.at(200)
    assert screen.read[2:] == [(60, "it is a")]


def test_a_state_that_has_passed_before_its_minute_is_not_sent():
    screen = Screen()
    for second, state in ((0, "a"), (5, "b"), (10, "a"), (15, "b")):
        screen.be(second, state)
    screen.at(200)
    assert screen.read == [(0, "it is a"), (5, "it is b")]


def test_what_is_grave_never_waits():
    screen = Screen()
    for second in range(0, 20, 2):
        screen.be(second, "lost", is_grave=True)
        screen.be(second + 1, "fine")
    assert screen.read == [(0, "it is lost"), (1, "it is fine"), (2, "it is lost")]
    screen.be(61, "fine")
    screen.be(62, "lost", is_grave=True)
    assert screen.read[3:] == [(61, "it is fine"), (62, "it is lost")]


def test_after_all_was_well_again_what_comes_is_news():
    screen = Screen()
    screen.be(0, "bad")
    screen.be(20, "fine", is_end=True)
    screen.be(25, "bad")
    assert [at for at, _ in screen.read] == [0, 20, 25]


# The estimate


class Pilot:
    """An announcer that is shown a status each second, and what the pilot reads of it."""

    def __init__(self):
        self.session, _ = met()
        self.announcer = Announcer(self.session)
        self.read = []
        self.second = 0

    def see(self, status, reasons=(), seconds=1, **changes):
        health = replace(HEALTH, status=status, reasons=dict(reasons), **changes)
        for _ in range(seconds):
            now_ns = self.second * SECOND
            self.announcer.tick(now_ns)
            self.announcer.estimate.on_health(health, now_ns)
            self.session.statustext.tick(now_ns)
            self.collect()
            self.second += 1
        return self

    def collect(self):
        said = sent(self.session, "STATUSTEXT")
        assert all(len(one.text.rstrip(b"\0")) <= CHUNK for one in said)
        self.read += [one.text.decode().removeprefix("Companion: ") for one in said]


DRIFT = {Reason.POSITION_OFF: "GNSS 3.0 m off to one side"}
BARO = {Reason.CLIMB_BARO: "barometer against GNSS height"}


def test_an_estimate_that_flaps_is_told_once_a_minute():
    pilot = Pilot().see(Status.OK)
    for _ in range(55):
        pilot.see(Status.DEGRADED, DRIFT).see(Status.OK)
    assert pilot.read == ["estimate OK", "degraded: GNSS 3.0 m off to one side"]
    pilot.see(Status.OK, seconds=30)
    assert pilot.read[2:] == ["estimate OK"]


def test_it_is_told_what_is_wrong_and_when_that_changes():
    pilot = Pilot().see(Status.OK, seconds=3).see(Status.DEGRADED, DRIFT, seconds=3)
    pilot.see(Status.DEGRADED, BARO | DRIFT, seconds=3)
    assert pilot.read[1:] == [
        "degraded: GNSS 3.0 m off to one side",
        "degraded: barometer against GNSS height",
    ]


def test_lost_is_told_at_once_and_so_is_that_it_was_found_again():
    pilot = Pilot().see(Status.OK, seconds=5).see(Status.DEAD_RECKONING, seconds=3).see(Status.OK)
    assert pilot.read == ["estimate OK", "GNSS lost, dead reckoning", "estimate OK"]
    pilot.see(Status.INVALID)
    assert pilot.read[-1] == "estimate invalid, not sent"


def test_a_receiver_that_is_refused_is_not_called_lost():
    refused = {Reason.POSITION_REFUSED: "GNSS is 60 m off, refused"}
    pilot = Pilot().see(Status.DEAD_RECKONING, refused)
    assert pilot.read == ["GNSS is 60 m off, dead reckoning"]


def test_a_restart_is_told_and_no_loss_of_gnss_with_it():
    pilot = Pilot()
    pilot.announcer.estimate.on_start(Outcome(0.4), 0)
    pilot.see(Status.DEAD_RECKONING).see(Status.DEGRADED, DRIFT)
    assert pilot.read == ["restarted, going on from 0.4 s ago"]
    pilot.see(Status.DEAD_RECKONING, seconds=3)
    assert pilot.read[1:] == ["GNSS lost, dead reckoning"]  # for it is, if none comes


def test_a_pause_of_our_own_is_blamed_on_nobody_else():
    pilot = Pilot().see(Status.OK)
    pilot.announcer.estimate.on_pause(6.04, SECOND)
    pilot.see(Status.DEAD_RECKONING, resets=1, reset_reason="inertial gap")
    pilot.see(Status.OK, resets=1)
    assert pilot.read == ["estimate OK", "the companion stood still for 6.0 s"]


def test_many_pauses_are_counted():
    pilot = Pilot()
    for second in range(1, 50):
        pilot.announcer.estimate.on_pause(1.0 + second % 7, second * SECOND)
    pilot.see(Status.OK, seconds=62)
    assert "stood still 48 times, 7.0 s at most" in pilot.read


def test_the_first_start_of_a_day_is_nothing_to_tell():
    pilot = Pilot()
    pilot.announcer.estimate.on_start(Outcome(why=Why.REBOOTED), 0)
    pilot.announcer.estimate.on_start(Outcome(), 0)
    assert pilot.see(Status.OK).read == ["estimate OK"]


@pytest.mark.parametrize("why", Why)
@pytest.mark.parametrize("frame", ["same", "new"])
def test_every_text_about_a_start_is_one_message(why, frame):
    assert len(f"restarted: {why.short}, {frame} origin") <= LONGEST_TEXT


def test_a_reboot_of_the_autopilot_is_told():
    pilot = Pilot().see(Status.OK)
    pilot.announcer.on_event(Rebooted(), SECOND)
    pilot.see(Status.OK, seconds=3)
    assert pilot.read == ["estimate OK", "autopilot rebooted, estimate anew", "estimate OK"]


def test_every_reason_has_words_that_fit_beside_the_status():
    assert sorted(ORDER) == sorted(Reason)
    x = State()
    x.dt, x.azimuth = 0.2, 1.0
    for aid in range(3):
        run = x.run[aid]
        run.n, run.tt = 9.0, 5.0
        run.z[0] = run.z[1] = 9e9
    x.slide.smooth[0] = 1e7
    for i in range(3):
        x.P[i][i] = 1e9
    words = in_words(x, Reason(sum(Reason)))
    assert list(words) == list(ORDER)
    assert len(set(words.values())) == len(ORDER)
    assert max(map(len, words.values())) <= LONGEST_WORDS


def test_what_a_receiver_is_off_by_is_where_its_refused_fixes_have_come_to():
    """Of one that drifts by 0.5 m/s the mean of ten seconds would be 2.5 m short."""
    x = State()
    x.t, run = 10e9, x.run[0]
    for k in range(51):
        tau = 0.2 * k
        run.n, run.t, run.tt = run.n + 1.0, run.t + tau, run.tt + tau * tau
        run.z[1] += 1.0 + 0.5 * tau
        run.tz[1] += tau * (1.0 + 0.5 * tau)
    words = in_words(x, Reason.POSITION_REFUSED | Reason.UNAIDED)
    assert words == {
        Reason.POSITION_REFUSED: "GNSS is 6.0 m off, refused",
        Reason.UNAIDED: "no GNSS is used",
    }


def test_a_session_that_did_not_listen_does_not_call_the_autopilot_lost():
    session, _ = met()
    session.tick(SECOND)
    session.excuse(20 * SECOND)
    session.tick(21 * SECOND)
    assert not [one for one in session.events() if isinstance(one, PeerLost)]
    session.tick(26 * SECOND)
    assert [one for one in session.events() if isinstance(one, PeerLost)]


# What is wrong, where the hypotheses decide


JUMP = Wrong(Source.POSITION, "GNSS 60 m off", 0.93, False, (Aid.POSITION,))
FOUND = JUMP._replace(words="GNSS 61 m off", is_found=True, unused=())


def test_what_is_found_is_told_at_once_and_that_it_is_over():
    pilot = Pilot().see(Status.OK, seconds=3).see(Status.OK, wrong=(JUMP,))
    pilot.see(Status.OK, wrong=(FOUND,), seconds=5)
    assert pilot.read[1:] == ["GNSS 61 m off, corrected"]
    pilot.see(Status.OK, seconds=5)
    assert not pilot.read[2:]  # until it has lasted
    pilot.see(Status.OK)
    assert pilot.read[2:] == ["GNSS right again"]


def test_what_is_suspected_is_told_once_it_lasts():
    pilot = Pilot().see(Status.OK, seconds=3)
    for _ in range(3):
        pilot.see(Status.OK, wrong=(JUMP,)).see(Status.OK, seconds=2)
    assert pilot.read == ["estimate OK"]
    pilot.see(Status.OK, wrong=(JUMP,), seconds=9)
    assert pilot.read[1:] == ["suspected: GNSS 60 m off"]


def test_what_comes_and_goes_is_told_once():
    pilot = Pilot().see(Status.OK)
    for _ in range(120):
        pilot.see(Status.OK, wrong=(FOUND,)).see(Status.OK)
    assert pilot.read[1:] == ["GNSS 61 m off, corrected"]


def test_a_receiver_that_is_suspected_is_not_called_lost():
    pilot = Pilot().see(Status.DEAD_RECKONING, wrong=(JUMP,))
    assert pilot.read == ["GNSS 60 m off, dead reckoning"]


# A recorded flight


def read_in(weigh):
    """Return what the pilot reads with its stamps, s: 60 m north from 51.65 s on for 10 s; 0.5 m/s
    east from 76.65 s on."""
    read, companion, ticked = [], Companion(replace(Config(), weigh_faults=weigh)), 0
    for now_ns, frame in frames("sitl-ap-copter-glitch-slide-flown"):
        companion.receive(frame, now_ns)
        if now_ns - ticked > SECOND // 20:
            companion.tick(now_ns)
            ticked = now_ns
        for one in Splitter().feed(b"".join(companion.data_to_send())):
            if one.message_id == IDS["STATUSTEXT"] and companion.pipeline is not None:
                text = unpack(one).text.decode().removeprefix("Companion: ")
                read.append((companion.pipeline.stamp_ns * 1e-9, text))
    return read


def test_a_glitch_and_a_slide_are_named_within_five_seconds_where_the_hypotheses_decide():
    read = read_in("act")
    glitch = [text for at, text in read if 51.65 < at < 56.65]
    assert glitch == ["GNSS 60 m off, corrected"]
    assert [text for at, text in read if 61.65 < at < 71.65] == ["GNSS right again"]
    (slide,) = [text for at, text in read if 76.65 < at < 81.65]
    assert re.fullmatch(r"GNSS slides, 1\.\d m, corrected", slide)
    assert not [text for _, text in read if text.startswith(("degraded", "no ODOMETRY"))]
    assert len(read) <= 10


def test_a_glitch_and_a_slide_are_named_within_five_seconds():
    read = read_in("off")
    glitch = [text for at, text in read if 51.65 < at < 56.65]
    assert glitch == ["degraded: GNSS 60 m off to one side", "degraded: GNSS is 60 m off, refused"]
    slide = [text for at, text in read if 76.65 < at < 81.65 and "OK" not in text]
    assert [text[:14] for text in slide] == ["degraded: GNSS"] * 2
    assert slide[1].endswith("m off, refused")
    assert len(read) <= 10


def test_a_fault_after_half_a_minute_of_health_is_news_though_health_was_told_lately():
    sent = []
    pilot = PilotTexts(lambda _, text: sent.append(text))
    states = (
        (0, "ok", "estimate OK"),
        (30, "degraded", "GNSS is 60 m off"),
        (50, "ok", "estimate OK"),
        (55, "degraded", "GNSS is 2 m off"),
        (56, "ok", "estimate OK"),
        (58, "degraded", "GNSS is 3 m off"),  # once a minute only
    )
    for seconds, key, text in states:
        is_end = key == "ok"
        pilot.on_state("estimate", key, Severity.NOTICE, text, seconds * SECOND_NS, is_end=is_end)
    assert sent == ["estimate OK", "GNSS is 60 m off", "GNSS is 2 m off"]


def test_what_no_good_sensor_has_is_logged_once_and_no_matter_of_the_pilot(caplog):
    pilot = Pilot().see(Status.OK)
    for metres in ("0.97", "1.02"):
        pilot.see(Status.OK, oddities=(f"anchor 3: its ranges are {metres} m longer",))
    pilot.see(Status.OK, oddities=("anchor 7 has no place", "anchor 3: its ranges are 1 m longer"))
    said = [one.getMessage() for one in caplog.records if "anchor" in one.getMessage()]
    assert said == ["anchor 3: its ranges are 0.97 m longer", "anchor 7 has no place"]
    assert pilot.read == ["estimate OK"]
