"""Each fault of the fake autopilot or of the link: which stage fails, and what is reported."""

import re
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig, OdometryConfig, OutputConfig, SigningConfig
from ekf_companion.doctor.counters import Stamps
from ekf_companion.doctor.diagnosis import diagnose, first_failure
from ekf_companion.doctor.evidence import Means, Opening
from ekf_companion.doctor.stage import Outcome
from ekf_companion.mavlink.audit import probable_cause
from ekf_companion.mavlink.codec import Sender, pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.signing import Signing
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import SimConfig, StreamConfig
from tests.doctor.simulated import (
    ARDUPILOT_OURS,
    UDP,
    examine,
    is_request,
    simulated,
    stage,
    thinned,
    with_fields,
    without,
    words,
)

SLOW = Config(link=LinkConfig(imu_rate=100.0))


def marks(evidence):
    return {result.stage.value: result.outcome.value for result in diagnose(evidence)}


def link(**options):
    return Config(link=LinkConfig(imu_rate=100.0, **options))


@pytest.mark.parametrize("kind", list(Kind))
def test_where_nothing_is_wrong_nothing_is_found(kind):
    evidence = examine(kind=kind, config=SLOW)
    assert [f for f in diagnose(evidence) if f.outcome is not Outcome.OK] == []
    assert evidence.sent.frames == {(1, 1) if kind in ("px4", Kind.PX4) else (20, 12)}
    assert evidence.sent.rate == pytest.approx(30.0, rel=0.1)
    assert "; it would with" in stage(evidence, "fused").saw


def test_what_is_said_to_others_is_no_strange_value():
    evidence = examine(config=SLOW, seconds=2.0)
    told = replace(evidence, refused={"COMMAND_ACK: addressed to another": 500})
    assert stage(told, "values").saw == stage(replace(evidence, refused={}), "values").saw
    strange = replace(evidence, refused={"PARAM_SET: out of range": 5})
    assert "PARAM_SET: out of range (5)" in stage(strange, "values").saw


def test_who_only_listens_sends_nothing_and_says_so():
    evidence = examine(config=SLOW, means=Means.LISTENING, hears=pytest.fail)
    found = marks(evidence)
    assert set(found.values()) == {"ok", "unknown"}
    assert (found["sent"], found["fused"]) == ("unknown", "unknown")
    assert all(state.asked == 0.0 for state in evidence.messages.values())


# Whose frames


def others(system_id, component_id, **heartbeat):
    """Return one who sends a heartbeat at each turn."""
    sender = Sender(system_id, component_id)
    return lambda t_ns: [sender.message("HEARTBEAT", **heartbeat)]


def test_a_ground_station_alone_is_no_autopilot():
    ground = others(255, 190, type=6, autopilot=8)
    evidence = examine(change=lambda *_: b"", aside=ground, seconds=2.0)
    found = first_failure(diagnose(evidence))
    assert found.stage.value == "source"
    assert found.saw == "255/190 ground station"
    assert "Only a ground station sends here" in words(found)
    assert marks(evidence)["messages"] == "unknown"


def test_frames_without_a_heartbeat_are_nobodys():
    found = stage(examine(change=without("HEARTBEAT"), seconds=2.0), "source")
    assert found.outcome is Outcome.FAILED
    assert "AllowMsgIdOut" in words(found)


def test_several_autopilots_want_a_choice():
    """Rule 1."""
    second = others(2, 1, type=2, autopilot=3)
    found = stage(examine(config=SLOW, aside=second, seconds=3.0), "source")
    assert found.outcome is Outcome.WARNING
    assert "Set link.autopilot = 1" in words(found)
    chosen = examine(config=link(autopilot=1), aside=second, seconds=3.0)
    assert stage(chosen, "source").outcome is Outcome.OK


def test_an_autopilot_that_is_not_the_one_named_is_not_heard():
    found = stage(examine(config=link(autopilot=9), seconds=2.0), "source")
    assert found.outcome is Outcome.FAILED
    assert "link.autopilot = 1" in words(found)


def test_another_with_our_ids_is_a_clash():
    """Rule 4."""
    twin = others(1, 194, type=18, autopilot=8)
    found = stage(examine(config=SLOW, aside=twin, seconds=3.0), "source")
    assert found.outcome is Outcome.FAILED
    assert "link.component_id" in words(found)


@pytest.mark.parametrize(
    ("config", "remedy"),
    [
        (link(allow_systems=(7,)), "Add 1 to link.allow_systems"),
        (link(allow_components=(190, 191)), "Add 1 to link.allow_components"),
    ],
)
def test_an_autopilot_that_is_not_allowed_is_named_with_the_key_that_refuses_it(config, remedy):
    evidence = examine(config=config, seconds=2.0)
    assert remedy in words(stage(evidence, "source"))
    assert first_failure(diagnose(evidence)).stage.value == "source"


SECRET, OTHER = bytes(32), bytes(range(32))
SECOND = 1_000_000_000
HOUR = 3600 * SECOND
NOON_NS = 1_800_000_000 * SECOND
"""Unix time, when a simulated flight begins."""


def signed(secret, ahead_s=0):
    """Return a change that signs what the autopilot sends, by a clock so far ahead of ours."""
    clock, sender = count(NOON_NS + ahead_s * SECOND, SECOND // 100), Sender(1, 1, Signing(secret))
    return lambda name, fields: sender.frame(name, pack(name, **fields), next(clock))


def from_later():
    """Return a secret in use that has heard the autopilot an hour from now."""
    frame = Sender(1, 1, Signing(SECRET)).frame("HEARTBEAT", pack("HEARTBEAT"), NOON_NS + HOUR)
    signing = Signing(SECRET)
    assert signing.verify(next(iter(Splitter().feed(frame))), NOON_NS) == ""
    return signing


@pytest.mark.parametrize(
    ("ours", "change", "said"),
    [
        (lambda: Signing(SECRET), None, "signing.accept_unsigned"),
        (lambda: Signing(SECRET), signed(OTHER), "another secret"),
        (lambda: Signing(SECRET), signed(SECRET, ahead_s=-3600), "over a minute old"),
        (from_later, signed(SECRET), "clock went back"),
    ],
)
def test_signatures_that_are_not_believed_are_told_apart(ours, change, said):
    """Rule 34."""
    config = replace(SLOW, signing=SigningConfig(key_file="read by the command"))
    evidence = examine(config=config, signing=ours(), change=change, begin_ns=NOON_NS, seconds=2.0)
    found = stage(evidence, "source")
    assert found.outcome is Outcome.FAILED
    assert said in words(found)


def test_an_autopilot_that_shares_the_secret_is_found_and_hears_signed_frames():
    """Rule 34."""
    config = replace(SLOW, signing=SigningConfig(key_file="read by the command"))
    evidence = examine(
        config=config,
        signing=Signing(SECRET, link_id=1),
        change=signed(SECRET),
        begin_ns=NOON_NS,
        seconds=4.0,
    )
    assert stage(evidence, "source").outcome is Outcome.OK
    assert evidence.frames.signed > 100
    assert evidence.messages["HIGHRES_IMU"].answer == "accepted"


def test_who_hears_signed_frames_and_has_no_secret_is_told_that_ours_are_not_believed():
    """Rule 34."""
    found = stage(examine(config=SLOW, change=signed(SECRET), seconds=2.0), "source")
    assert found.outcome is Outcome.WARNING
    assert "Set signing.key_file" in words(found)


# Which messages


def test_who_only_listens_is_told_that_the_daemon_would_ask():
    quiet = examine(simulated(streams=StreamConfig(HIGHRES_IMU=0.0)), means=Means.LISTENING)
    assert "examine without --listen" in words(stage(quiet, "messages"))
    slow = examine(change=thinned(HIGHRES_IMU=2), means=Means.LISTENING, seconds=3.0)
    assert "examine without --listen" in words(stage(slow, "rates"))


def test_no_inertial_message_ends_the_way():
    streams = StreamConfig(HIGHRES_IMU=0.0)
    evidence = examine(simulated(streams=streams), hears=lambda *message: not is_request(*message))
    found = first_failure(diagnose(evidence))
    assert found.stage.value == "messages"
    assert "no inertial message" in found.saw
    assert "answers none of our requests" in found.problems[0].cause


def test_no_gnss_message_is_named_before_the_estimate_that_lacks_it():
    change = without("GPS_RAW_INT", "GLOBAL_POSITION_INT")
    evidence = examine(config=SLOW, change=change, seconds=5.0)
    assert first_failure(diagnose(evidence)).stage.value == "messages"
    assert "GPS_1_CONFIG" in words(stage(evidence, "messages"))
    assert marks(evidence)["estimate"] == "failed"


def test_only_a_derived_position_is_a_warning():
    evidence = examine(config=SLOW, change=without("GPS_RAW_INT"), seconds=5.0)
    found = stage(evidence, "messages")
    assert found.outcome is Outcome.WARNING
    assert "no independent measurement" in words(found)


# How often


def at_4_hz(autopilot_rate=100):
    """Every stream at 4 Hz, whatever was asked."""
    return thinned(
        HIGHRES_IMU=autopilot_rate // 4,
        ATTITUDE=autopilot_rate // 40,  # 10 Hz were asked
        GLOBAL_POSITION_INT=1,
        GPS_RAW_INT=1,
    )


def by_the_daemon(evidence):
    """Return the cause that the daemon would log of the same rates."""
    measured = {name: state.rate for name, state in evidence.messages.items()}
    asked = {name: state.asked for name, state in evidence.messages.items()}
    return probable_cause(measured, asked, Family(evidence.peer.family))


def test_all_streams_at_4_hz_are_a_ground_stations():
    """Rule 6."""
    evidence = examine(kind=Kind.ARDUPILOT, config=SLOW, change=at_4_hz())
    found = stage(evidence, "rates")
    assert "a ground station sets" in by_the_daemon(evidence)
    assert found.outcome is Outcome.FAILED
    assert "a ground station sets them" in words(found)
    assert "SERIALn_OPTIONS + 4096" in words(found)


def of_personality(personality, seconds=8.0, **options):
    """Return the evidence, and the rates' result, of a real firmware's habits."""
    evidence = examine(SimConfig(), personality=personality, seconds=seconds, **options)
    return evidence, stage(evidence, "rates")


@pytest.mark.parametrize("name", ["ardupilot", "ardupilot-old"])
def test_40_hz_is_the_most_of_a_loop_of_50(name):
    """Rule 6: it denies more, and what is asked for then is granted."""
    evidence, found = of_personality(f"{name}:loop_rate=50,SCHED_LOOP_RATE=50")
    assert "raise SCHED_LOOP_RATE" in by_the_daemon(evidence)
    assert found.outcome is Outcome.WARNING
    assert "40 Hz of 250 asked" in found.saw
    (trouble,) = found.problems
    assert "0.8 of SCHED_LOOP_RATE = 50, the most" in trouble.cause
    assert trouble.remedy == "Set SCHED_LOOP_RATE = 350 (up to 400) and reboot."


def test_a_loop_that_gives_less_than_was_wanted_is_named():
    """It is asked for no more than the loop gives, in whole milliseconds."""
    _, found = of_personality("ardupilot:loop_rate=80")
    (trouble,) = found.problems
    assert "0.8 of SCHED_LOOP_RATE = 80, the most" in trouble.cause
    assert "SCHED_LOOP_RATE = 350" in trouble.remedy


def test_a_ground_station_that_overrules_us_is_named_before_the_loop():
    """Rule 6: what it sets every ten seconds, we ask for anew, so that no mean shows it."""
    _, found = of_personality("ardupilot-old:loop_rate=50,gcs_rate=4", 18.0)
    assert found.outcome is Outcome.WARNING
    station, loop = found.problems
    assert "then came at about 4.0 Hz alike: a ground station overrules us" in station.cause
    assert "SERIALn_OPTIONS + 4096" in station.remedy
    assert "0.8 of SCHED_LOOP_RATE = 50" in loop.cause
    assert "BAUD" not in words(found)


def test_a_ground_station_shows_by_what_it_slowed_though_the_rate_is_ours_again():
    _, found = of_personality("ardupilot-old:gcs_rate=4", 18.0)
    (station,) = found.problems
    assert "a ground station overrules us" in station.cause


@pytest.mark.parametrize("personality", ["ardupilot", "ardupilot-old", "px4"])
def test_lost_frames_are_named_and_no_budget(personality):
    """Rule 6: what the link loses is no reason to spend more on it."""
    rng = np.random.default_rng(3)
    change = lambda *said: None if rng.random() < 0.22 else said  # noqa: E731
    _, found = of_personality(personality, change=change)
    assert found.outcome is Outcome.WARNING
    (trouble,) = found.problems
    assert re.match(r"2[0-5]% of the autopilot's frames never arrive", trouble.cause)
    assert "BAUD" not in trouble.remedy
    assert "RTS" not in trouble.remedy


SERIAL = Opening(url="serial:/dev/ttyS0:57600", kind="serial", device="/dev/ttyS0", baud=57600)


@pytest.mark.parametrize(
    ("opening", "said", "unsaid"),
    [
        (UDP, "MAV_n_RATE = ", "BAUD"),
        (SERIAL, "SER_TEL2_BAUD = 921600 and link.url with :921600", "where the link is"),
    ],
)
def test_a_spent_budget_is_raised_where_the_link_has_one(opening, said, unsaid):
    evidence, found = of_personality("px4:MAV_1_RATE=5760", opening=opening)
    assert "the link's budget is spent" in words(found)
    assert said in words(found)
    assert unsaid not in words(found)
    recording = replace(evidence, means=Means.RECORDING, opening=None)
    assert "where the link is serial, SER_TEL2_BAUD" in words(stage(recording, "rates"))


@pytest.mark.parametrize("rate", [40.0, 250.0])
def test_a_rate_that_is_asked_for_is_not_advised_to_be_asked_for(rate):
    sim = simulated(rate=40.0)
    config = Config(link=LinkConfig(imu_rate=rate))
    found = stage(examine(sim, Kind.ARDUPILOT, config=config, seconds=5.0), "rates")
    is_too_low = rate < 80.0
    assert ("link.imu_rate = 100" in words(found)) is is_too_low
    assert "SRn_RAW_SENS" not in words(found)


def test_a_whole_division_of_px4s_is_as_it_should_be():
    sim = simulated(rate=250.0, parameters={"IMU_INTEG_RATE": 250})
    config = Config(link=LinkConfig(imu_rate=200.0))
    evidence = examine(sim, config=config, change=thinned(HIGHRES_IMU=2), seconds=4.0)
    found = stage(evidence, "rates")
    assert found.outcome is Outcome.OK
    assert "125 Hz of 200 asked" in found.saw
    assert "PX4 divides its rate by whole numbers" in found.saw


def test_streams_scaled_by_one_factor_are_the_links_budget():
    sim = simulated(parameters={"MAV_0_RATE": 1200})
    scaled = thinned(
        HIGHRES_IMU=3, ATTITUDE=3, GLOBAL_POSITION_INT=3, EXTENDED_SYS_STATE=3, SYSTEM_TIME=3
    )
    config = Config(link=LinkConfig(imu_rate=100.0, heading_rate=20.0))
    evidence = examine(sim, config=config, change=scaled)
    assert "so the link is full; raise MAV_n_RATE" in by_the_daemon(evidence)
    found = stage(evidence, "rates")
    assert found.outcome is Outcome.WARNING
    assert "the link's budget is spent" in words(found)
    assert "MAV_0_RATE = 1200 now" in words(found)


def test_few_fixes_are_a_warning():
    evidence = examine(config=SLOW, change=thinned(GPS_RAW_INT=5))
    assert "GPS1_RATE_MS = 200" in words(stage(evidence, "rates"))


def test_lost_frames_are_counted_by_their_numbers():
    seen = iter(range(10**6))
    evidence = examine(
        config=SLOW, change=lambda *said: None if next(seen) % 12 == 0 else said, seconds=4.0
    )
    found = stage(evidence, "rates")
    assert found.outcome is Outcome.WARNING
    assert "8% of the autopilot's frames never arrive" in words(found)


# What time


def test_a_fix_on_another_clock_needs_system_time():
    unix = with_fields("GPS_RAW_INT", time_usec=lambda t: t + 1_780_000_000_000_000)

    def change(name, fields):
        return b"" if name == "SYSTEM_TIME" else unix(name, fields)

    evidence = examine(config=SLOW, change=change, seconds=6.0)
    found = first_failure(diagnose(evidence))
    assert found.stage.value == "time"
    assert "no SYSTEM_TIME comes" in words(found)


def test_a_reboot_is_told():
    """Rule 12."""
    turns = count()

    def change(name, fields):
        is_over = next(turns) > 400
        for field, unit in (("time_usec", 1), ("time_boot_ms", 1000)):
            if field in fields and is_over:
                fields[field] -= 15_000_000 // unit
        return name, fields

    found = stage(examine(config=SLOW, change=change, seconds=5.0), "time")
    assert "it rebooted" in words(found)


def test_repeated_stamps_are_two_paths():
    def change(name, fields):
        if name == "HIGHRES_IMU":
            fields["time_usec"] = fields["time_usec"] // 20_000 * 20_000
        return name, fields

    found = stage(examine(config=SLOW, change=change, seconds=3.0), "time")
    assert found.outcome is Outcome.WARNING
    assert "Let only one router endpoint lead here" in words(found)


def leaping(begin, end, by_s):
    """Return a change that moves the stamps of some messages."""
    turns = count()

    def change(name, fields):
        if begin < next(turns) < end:
            for field, unit in (("time_usec", 1e6), ("time_boot_ms", 1e3)):
                if field in fields:
                    fields[field] = max(0, fields[field] + round(by_s * unit))
        return name, fields

    return change


@pytest.mark.parametrize(("end", "by_s", "times"), [(1e9, 5.0, "once"), (600, 100.0, "2 times")])
def test_stamps_that_leap_are_of_the_stage_time_and_not_of_the_values(end, by_s, times):
    recording = {"config": SLOW, "seconds": 5.0, "means": Means.RECORDING}
    evidence = examine(change=leaping(400, end, by_s), **recording)
    found = stage(evidence, "time")
    assert found.outcome is Outcome.WARNING
    assert f"HIGHRES_IMU leap {times} away from the times at which they came" in words(found)
    assert f"by up to {by_s:g} s" in words(found)
    assert "not used, as their stamps leap: " in found.saw
    assert "leap" not in words(stage(evidence, "values"))


def test_samples_lost_or_held_on_their_way_are_no_leap():
    turns = count()

    def lost(name, fields):
        return None if 300 < next(turns) < 900 else (name, fields)

    evidence = examine(change=lost, config=SLOW, seconds=8.0, means=Means.RECORDING)
    assert evidence.stamps.gaps == 1
    assert evidence.stamps.leaps == 0
    stamps = Stamps(message="HIGHRES_IMU")
    for turn in range(1, 1000):  # of 250 Hz, held for 2 s on the way, then in a burst
        stamps.add(4_000 * turn, 4_000_000 * (max(turn, 800) if turn > 300 else turn))
    assert (stamps.count, stamps.leaps) == (999, 0)


def test_an_unanswered_timesync_is_a_warning():
    evidence = examine(config=SLOW, change=without("TIMESYNC"))
    found = stage(evidence, "time")
    assert found.outcome is Outcome.WARNING
    assert "does not answer TIMESYNC" in words(found)


def to_another(name, fields):
    """Change answers to TIMESYNC: they are to requests of somebody else."""
    is_answer = name == "TIMESYNC" and fields["tc1"]
    return name, fields | ({"ts1": fields["ts1"] + 1} if is_answer else {})


def test_answers_to_timesync_that_are_refused_are_no_silence():
    found = stage(examine(config=SLOW, change=to_another), "time")
    assert found.outcome is Outcome.WARNING
    assert "answers came, none to one of our last 16 requests" in words(found)
    assert "does not answer" not in words(found)


# Which values


def test_a_field_a_million_times_too_large_is_named_and_used():
    """Rule 9."""
    million = with_fields("HIGHRES_IMU", **dict.fromkeys(("xmag", "ymag", "zmag"), _million))
    evidence = examine(kind=Kind.ARDUPILOT, config=SLOW, change=million)
    found = stage(evidence, "values")
    assert found.outcome is Outcome.WARNING
    assert "a million times too large" in words(found)
    assert marks(evidence)["estimate"] == "ok"


def _million(value):
    return value * 1e6


def test_a_field_that_is_not_the_earths_is_named():
    weak = with_fields("HIGHRES_IMU", xmag=lambda v: v * 0.05, ymag=0.01, zmag=0.01)
    found = stage(examine(config=SLOW, change=weak, seconds=4.0), "values")
    assert "weaker or stronger than the Earth's" in words(found)


def test_no_fix_is_named():
    """Rule 13."""
    no_fix = with_fields("GPS_RAW_INT", fix_type=1, satellites_visible=3)
    evidence = examine(config=SLOW, change=no_fix, seconds=5.0)
    found = first_failure(diagnose(evidence))
    assert found.stage.value == "values"
    assert "The receiver has no 3-D fix (3 satellites)" in words(found)


def test_a_fix_that_never_changes_is_named():
    """Rule 13."""
    still = with_fields("GPS_RAW_INT", time_usec=20_500_000)
    found = first_failure(diagnose(examine(config=SLOW, change=still)))
    assert found.stage.value == "values"
    assert "The same fix comes again and again" in words(found)


@pytest.mark.parametrize("is_timed", [True, False])
def test_a_fix_that_stands_still_from_the_middle_on_is_named(is_timed):
    """Rule 13: a receiver that hangs, while its time goes on or not."""
    seen = []

    def change(name, fields):
        if name == "GPS_RAW_INT":
            seen.append({key: fields[key] for key in ("lat", "lon", "alt", "vel", "cog")})
            if len(seen) > 20:
                fields |= {**seen[19], "vel": 536}
                fields["time_usec"] *= is_timed
        return name, fields

    found = first_failure(diagnose(examine(config=SLOW, change=change, seconds=10.0)))
    assert found.stage.value == "values"
    assert "The same fix comes again and again, now for" in words(found)


def test_a_receiver_that_holds_its_place_at_rest_is_well():
    still = with_fields("GPS_RAW_INT", lat=473_977_420, lon=85_455_940, alt=488_000, vel=0, cog=0)
    assert "again and again" not in words(stage(examine(config=SLOW, change=still), "values"))


def test_a_receiver_that_hung_for_a_while_is_a_warning():
    """Rule 13."""
    since = []

    def change(name, fields):
        if name == "GPS_RAW_INT":
            since.append(fields["time_usec"])
            if len(since) in range(10, 30):
                fields["time_usec"] = since[9]
        return name, fields

    found = stage(examine(config=SLOW, change=change), "values")
    assert found.outcome is Outcome.WARNING
    assert "again and again, at the longest for 4 s" in words(found)


def test_a_fix_without_time_or_accuracy_is_a_warning():
    """Rule 13."""
    poor = with_fields("GPS_RAW_INT", time_usec=0, h_acc=0)
    found = stage(examine(config=SLOW, change=poor, seconds=5.0), "values")
    assert found.outcome is Outcome.WARNING
    assert "hold no time" in words(found)
    assert "reports no accuracy" in words(found)


def test_stale_inertial_values_are_refused_by_their_bits():
    """Rule 8."""
    seen = []

    def stale(name, fields):
        if name == "HIGHRES_IMU":
            seen.append(name)
            fields["fields_updated"] = 0x1FC0 if len(seen) % 50 else 0x1FFF
        return name, fields

    found = stage(examine(config=SLOW, change=stale, seconds=3.0), "values")
    assert found.outcome is Outcome.FAILED
    assert "fields_updated" in words(found)


# What becomes of it


DOUBLE = {
    Kind.PX4: {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 7},
    Kind.ARDUPILOT: {**ARDUPILOT_OURS, "EK3_SRC1_VELXY": 3},
}


@pytest.mark.parametrize("kind", list(Kind))
def test_no_odometry_goes_where_the_same_fixes_would_count_twice(kind):
    """Rule 25."""
    evidence = examine(
        simulated(parameters=DOUBLE[kind]),
        kind,
        config=SLOW,
        seconds=5.0,
        hears=lambda name, _: name != "ODOMETRY" or pytest.fail("ODOMETRY was sent"),
    )
    found = marks(evidence)
    assert (found["sent"], found["fused"]) == ("failed", "unknown")
    assert "together with" in words(stage(evidence, "sent"))
    assert "Set EK" in stage(evidence, "sent").problems[0].remedy
    assert "output.odometry.independent = true" in words(stage(evidence, "sent"))


def test_what_is_always_sent_and_counted_twice_fails():
    config = replace(SLOW, output=OutputConfig(odometry=OdometryConfig(mode="always")))
    sim = simulated(parameters=DOUBLE[Kind.PX4])
    found = first_failure(diagnose(examine(sim, config=config, seconds=5.0)))
    assert found.stage.value == "fused"
    assert "The same GNSS would count twice" in words(found)
    assert "Set EKF2_GPS_CTRL to 0" in words(found)


def test_where_ours_alone_counts_all_is_well():
    sim = simulated(parameters={"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0})
    evidence = examine(sim, config=SLOW)
    assert marks(evidence)["fused"] == "ok"
    assert "the autopilot fuses ours, and no GNSS" in stage(evidence, "fused").saw
    assert evidence.sent.count > 50


def test_an_autopilot_that_tells_no_parameter_gets_no_odometry():
    evidence = examine(
        config=SLOW, seconds=6.0, hears=lambda name, _: name not in ("PARAM_REQUEST_READ",)
    )
    assert evidence.sent.count == 0
    assert "it answers no request for a parameter" in words(stage(evidence, "sent"))
    assert marks(evidence)["fused"] == "unknown"


def test_ardupilot_leaves_any_frame_but_one():
    """Rule 19."""
    config = replace(SLOW, output=OutputConfig(odometry=OdometryConfig(frame="LOCAL_NED")))
    found = first_failure(diagnose(examine(kind=Kind.ARDUPILOT, config=config)))
    assert found.stage.value == "sent"
    assert "output.odometry.frame = LOCAL_FRD" in words(found)


def test_a_refusal_spoken_aloud_is_heard():
    """Rule 24."""
    sender = Sender(1, 1)
    text = b"ODOMETRY: estimator_type 5 unsupported"
    evidence = examine(
        config=SLOW,
        seconds=5.0,
        aside=lambda t_ns: [sender.message("STATUSTEXT", severity=2, text=text)],
    )
    found = stage(evidence, "fused")
    assert found.outcome is Outcome.FAILED
    assert "output.odometry.estimator_type = auto" in words(found)


def test_what_old_firmware_is_sent_counts_as_odometry_does():
    config = Config(output=OutputConfig(odometry=OdometryConfig(mode="always")))
    found = examine(personality="ardupilot-4.0", config=config, seconds=12.0)
    sent = stage(found, "sent")
    assert sent.saw.startswith("VISION_POSITION_ESTIMATE ")
    assert not [one for one in sent.problems if "goes out" in one.cause]
