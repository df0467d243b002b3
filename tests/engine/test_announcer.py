"""What has changed, in words."""

import logging

import pytest

from ekf_companion.engine.announcer import Announcer
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import (
    Clash,
    FirmwareReported,
    IntervalSet,
    ParameterSet,
    PeerChanged,
    PeerFound,
    PeerLost,
    RateTooLow,
    Rebooted,
    RequestAnswered,
    SeveralAutopilots,
)
from ekf_companion.mavlink.statustext import LARGEST, Severity
from tests.mavlink.conversation import MS, SECOND, met, sent

CAUSE = "a loop of 50 Hz sends at most 40; raise SCHED_LOOP_RATE"


@pytest.mark.parametrize(
    ("event", "logged", "severity", "told"),
    [
        (PeerFound(1, 1, Family.PX4), "Autopilot found: system 1, component 1, px4", None, ""),
        (PeerLost(0), "Autopilot lost", None, ""),
        (
            Rebooted(),
            "Autopilot rebooted",
            Severity.WARNING,
            "autopilot rebooted, estimate anew",
        ),
        (RequestAnswered("ATTITUDE", "denied"), "Request for ATTITUDE: denied", None, ""),
        (
            RequestAnswered("SCALED_PRESSURE", "failed"),
            "Request for SCALED_PRESSURE: not offered; only autopilots whose inertial message has",
            None,
            "",
        ),
        (FirmwareReported("1.16.0"), "firmware: 1.16.0", None, ""),
        (
            SeveralAutopilots(1, 2),
            "listening to system 1; set link.autopilot",
            Severity.WARNING,
            "several autopilots, using 1",
        ),
        (
            PeerChanged((1, 154), (1, 1), is_lost=False),
            "Listening to system 1, component 1 instead of system 1, component 154, which is less",
            Severity.WARNING,
            "using autopilot 1/1, not 1/154",
        ),
        (
            Clash(1, 194),
            "no ODOMETRY while it sends any; give one of us another link.component_id",
            Severity.CRITICAL,
            "id 194 is taken twice, not sending",
        ),
        (
            RateTooLow("HIGHRES_IMU", 250.0, 40.1, CAUSE),
            f"HIGHRES_IMU comes at 40.1 Hz, asked for 250: {CAUSE}",
            Severity.WARNING,
            f"HIGHRES_IMU 40 of 250 Hz: {CAUSE}",
        ),
        (
            ParameterSet("EC_BARO_NSE", "baro.std", 2.5),
            "EC_BARO_NSE set to 2.5 (baro.std)",
            Severity.INFO,
            "EC_BARO_NSE is 2.5",
        ),
        (
            ParameterSet("EC_GPS_DELAY", "gnss.delay", 0.3, is_late=True),
            "EC_GPS_DELAY set to 0.3 (gnss.delay) from the next start",
            Severity.INFO,
            "EC_GPS_DELAY is 0.3 from the next start",
        ),
        (IntervalSet("ODOMETRY", 10.0), "ODOMETRY asked for at 10 Hz", None, ""),
    ],
)
def test_rule_29_what_happens_on_the_link_is_logged_and_told_where_the_pilot_can_act(
    caplog, event, logged, severity, told
):
    """Rule 29."""
    caplog.set_level(logging.INFO)
    session, _ = met()
    Announcer(session).on_event(event, 0)
    session.tick(0)
    pieces = sent(session, "STATUSTEXT")
    assert logged in caplog.text
    assert b"".join(piece.text for piece in pieces).decode() == (told and f"Companion: {told}")
    assert {piece.severity for piece in pieces} == ({severity} if severity else set())
    assert sum(len(piece.text) for piece in pieces) < LARGEST


def test_what_anybody_can_make_happen_is_told_once_a_second_and_how_it_ended(caplog):
    caplog.set_level(logging.INFO)
    session, _ = met()
    announcer = Announcer(session)
    for number in range(250):
        now_ns = number * 10 * MS
        announcer.on_event(ParameterSet("EC_BARO_NSE", "baro.std", 1.0 + number), now_ns)
        announcer.on_event(IntervalSet("ODOMETRY", 1.0 + number % 40), now_ns)
        announcer.tick(now_ns)
    assert len(caplog.records) == 6
    announcer.tick(3 * SECOND)
    announcer.tick(4 * SECOND)
    assert [record.getMessage() for record in caplog.records[6:]] == [
        "Parameter EC_BARO_NSE set to 250 (baro.std)",
        "ODOMETRY asked for at 10 Hz",
    ]
