"""The judgement of a link without problems, and with one number of it changed."""

import math
from dataclasses import replace

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig
from ekf_companion.core.memory.enums import Source
from ekf_companion.doctor.counters import MessageCounter, Stamps
from ekf_companion.doctor.diagnosis import diagnose
from ekf_companion.doctor.evidence import Feedback, Sent
from ekf_companion.doctor.report import lines
from ekf_companion.doctor.stage import Outcome, Stage
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.wrong import Wrong
from ekf_companion.nav.state import Status
from sim_autopilot.autopilot import Kind
from tests.doctor.simulated import ARDUPILOT_OURS, evidence_of, examine, simulated, stage, words

SECOND = 1_000_000_000
OURS_ALONE = {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0}
CONFIG = Config(link=LinkConfig(imu_rate=100.0))


@pytest.fixture(scope="module")
def well():
    evidence = examine(simulated(parameters=OURS_ALONE), config=CONFIG, seconds=8.0)
    assert {result.outcome for result in diagnose(evidence)} == {Outcome.OK}
    return evidence


@pytest.fixture(scope="module")
def arducopter():
    sim = simulated(parameters=ARDUPILOT_OURS)
    evidence = examine(sim, Kind.ARDUPILOT, config=CONFIG, seconds=8.0)
    assert {result.outcome for result in diagnose(evidence)} == {Outcome.OK}
    return evidence


def with_health(evidence, **options):
    return replace(evidence, estimator=replace(evidence.estimator, **options))


def with_verdicts(evidence, aid, **counts):
    verdicts = {a: dict(v) for a, v in evidence.estimator.verdicts.items()}
    verdicts[aid] |= {Verdict[name]: count for name, count in counts.items()}
    return with_health(evidence, verdicts=verdicts)


@pytest.mark.parametrize(
    ("status", "mark", "said"),
    [
        (Status.OK, Outcome.OK, "ok, position to"),
        (Status.DEGRADED, Outcome.WARNING, "one aid is silent or refused"),
        (Status.DEAD_RECKONING, Outcome.FAILED, "the position drifts"),
        (Status.INVALID, Outcome.FAILED, "the position drifts"),
        (Status.ATTITUDE, Outcome.FAILED, "North is not found"),
    ],
)
def test_the_estimate_is_as_good_as_its_status(well, status, mark, said):
    found = stage(with_health(well, status=status), "estimate")
    assert found.outcome is mark
    assert said in words(found)


def test_what_the_fault_hypotheses_have_found_is_a_warning(well):
    wrong = Wrong(Source.POSITION, "GNSS 60 m off", 1.0, True, ())
    found = stage(with_health(well, wrong=(wrong,)), "estimate")
    assert found.outcome is Outcome.WARNING
    assert "GNSS 60 m off, corrected" in words(found)


def test_what_an_estimate_waits_for_is_named(well):
    none = {aid: dict.fromkeys(Verdict, 0) for aid in Aid}
    waiting = with_health(well, status=Status.ALIGNING, verdicts=none)
    assert "no position is, for no fix has come" in words(stage(waiting, "estimate"))
    empty = with_health(well, status=Status.INIT, verdicts=none, samples=0)
    assert "No inertial sample" in words(stage(empty, "estimate"))
    moving = with_verdicts(
        with_verdicts(waiting, Aid.POSITION, BEFORE_ALIGNMENT=30), Aid.HEADING, BEFORE_ALIGNMENT=30
    )
    assert "align.time" in words(stage(moving, "estimate"))


@pytest.mark.parametrize("aid", [aid for aid in Aid if aid is not Aid.REST])
def test_an_aid_that_is_refused_or_scatters_is_a_warning(well, aid):
    refused = stage(with_verdicts(well, aid, FUSED=80, GATED=20), "estimate")
    assert refused.outcome is Outcome.WARNING
    assert "20% of the measurements of the " in words(refused)
    enough = with_verdicts(well, aid, FUSED=80, GATED=0)
    wild = with_health(enough, nis={**well.estimator.nis, aid: 9.0})
    assert "scatters 3.0 times as much" in words(stage(wild, "estimate"))


def test_a_reset_is_told_with_its_reason(well):
    jumped = with_health(well, resets=2, reset_reason="heading against the motion")
    found = stage(jumped, "estimate")
    assert found.outcome is Outcome.WARNING
    assert "CAL_MAG0_ROT" in words(found)


def test_a_reboot_is_no_reset_beside(well):
    """The verdict of the same log said "resets: 0; reboots: 1"."""
    rebooted = replace(well, peer=replace(well.peer, reboots=1))
    again = with_health(rebooted, resets=2, reset_reason="heading against the motion", gaps=1)
    found = stage(again, "estimate")
    assert ", 1 reset (the last: heading against the motion), 1 gap" in found.saw
    assert "The estimate was reset once; the last: " in words(found)
    assert "reset" not in stage(with_health(rebooted, resets=1), "estimate").saw


def test_a_disturbed_field_is_a_warning(well):
    found = stage(with_verdicts(well, Aid.HEADING, FUSED=50, DISTURBED=50), "values")
    assert found.outcome is Outcome.WARNING
    assert "heading.hard_iron" in words(found)


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (Stamps(message="HIGHRES_IMU", count=100, zero=90), "holds no time"),
        (Stamps(message="HIGHRES_IMU", count=100, backward=5), "go back"),
        (Stamps(message="SCALED_IMU", count=100, is_whole_ms=True), "whole milliseconds"),
    ],
)
def test_strange_stamps_are_named(well, stamps, said):
    assert said in words(stage(replace(well, stamps=stamps), "time"))


def test_a_clock_that_drifts_and_a_slow_timesync_are_named(well):
    fast = replace(well, time=replace(well.time, skew_ppm=400.0))
    assert "clock runs 0.04 % faster than ours" in words(stage(fast, "time"))
    refused = {"slow": 60}
    state = replace(well.time, is_locked=False, refused=refused, rtt_p50_ms=40.0)
    found = stage(replace(well, time=state), "time")
    assert "timesync.largest_rtt = 0.08" in words(found)


def with_parameter(evidence, name, value):
    return replace(evidence, parameters={**evidence.parameters, name: value})


def test_a_quality_that_ours_does_not_reach_is_named(well, arducopter):
    assert "Set EKF2_EV_QMIN = 30" in words(
        stage(with_parameter(well, "EKF2_EV_QMIN", 60), "fused")
    )
    strict = with_parameter(arducopter, "VISO_QUAL_MIN", 80)
    assert "Set VISO_QUAL_MIN = 30" in words(stage(strict, "fused"))
    assert stage(with_parameter(well, "EKF2_EV_QMIN", 1), "fused").outcome is Outcome.OK


def test_what_becomes_of_dead_reckoning_is_named(well, arducopter):
    for case, name in ((well, "EKF2_EV_QMIN"), (arducopter, "VISO_QUAL_MIN")):
        fused = stage(with_parameter(case, name, 0), "fused")
        assert fused.outcome is Outcome.OK
        assert "so is dead reckoning (quality 20), for as long as output.odometry" in fused.saw
        assert f"{name} = 0, with 30 it is refused at once" in fused.saw
        strict = stage(with_parameter(case, name, 30), "fused")
        assert f"dead reckoning (quality 20) is not fused: {name} = 30" in strict.saw


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("EKF2_HGT_REF", 1, "add 2 to EKF2_GPS_CTRL"),
        ("EKF2_HGT_REF", 0, ""),
        ("EKF2_HGT_REF", 3, ""),
        ("EKF2_EV_DELAY", 175, "Set EKF2_EV_DELAY = 0"),
        ("EKF2_EV_DELAY", 5, ""),
    ],
)
def test_parameters_that_spoil_the_fusion_are_named(well, name, value, said):
    found = stage(with_parameter(well, name, value), "fused")
    assert found.outcome is (Outcome.WARNING if said else Outcome.OK)
    assert said in words(found)


@pytest.mark.parametrize(
    ("feedback", "said"),
    [
        (Feedback(worst_ratio=1.4), "test ratio 1.4"),
        (Feedback(flags=1024, worst_ratio=0.1), "has not started yet"),
        (Feedback(flags=128 | 1, worst_ratio=0.1), "holds its position fixed"),
    ],
)
def test_an_autopilot_that_takes_nothing_in_the_end_says_so(arducopter, feedback, said):
    found = stage(replace(arducopter, feedback=feedback), "fused")
    assert found.outcome is Outcome.WARNING
    assert said in words(found)


def test_an_autopilot_that_fuses_is_well(arducopter):
    fusing = replace(arducopter, feedback=Feedback(flags=831, worst_ratio=0.1))
    assert stage(fusing, "fused").outcome is Outcome.OK


def test_odometry_that_is_rare_or_unwanted_is_judged_by_the_configuration(well):
    rare = replace(well, sent=Sent(count=30, rate=4.0, frames=frozenset({(20, 12)})))
    assert "output.odometry.rate = 30" in words(stage(rare, "sent"))
    never = replace(well, sent=Sent(), output=replace(well.output, mode="never"))
    assert stage(never, "sent").outcome is Outcome.OK
    silent = replace(well, sent=Sent())
    assert stage(silent, "sent").outcome is Outcome.FAILED


def test_a_heartbeat_that_has_stopped_ends_the_way(well):
    lost = replace(well, peer=replace(well.peer, is_heard=False))
    assert stage(lost, "source").outcome is Outcome.FAILED
    assert stage(lost, "rates").outcome is Outcome.UNKNOWN


def test_warnings_of_the_estimate_are_left_out_where_an_earlier_stage_fails(well):
    jumped = with_health(well, resets=2, reset_reason="inertial gap")
    assert any("inertial gap" in line and line.startswith("estimate:") for _, line in told(jumped))
    slow = replace(jumped, messages={**well.messages, "HIGHRES_IMU": replace(_imu(well), rate=5.0)})
    assert any(line.startswith("rates: HIGHRES_IMU comes at 5.0 Hz") for _, line in told(slow))
    assert not any(line.startswith("estimate:") for _, line in told(slow))


def told(evidence):
    return lines(diagnose(evidence))


def _imu(evidence):
    return evidence.messages["HIGHRES_IMU"]


def test_every_stage_has_its_finding_in_order_whatever_is_lacking():
    assert [result.stage for result in diagnose(evidence_of())] == list(Stage)


# Counting


def test_a_rate_is_measured_while_it_comes_and_anew_when_it_was_set():
    counter = MessageCounter()
    for k in range(11):
        counter.add(k * SECOND // 10)
    assert counter.rate() == pytest.approx(10.0)
    counter.restart()
    for k in range(51):
        counter.add(20 * SECOND + k * SECOND // 50)
    assert counter.rate() == pytest.approx(50.0)
    assert counter.rate(40 * SECOND) == 0.0
    assert counter.count == 62


def test_a_pause_counts_for_no_rate():
    counter = MessageCounter()
    for start in (0, 100):
        for k in range(21):
            counter.add(start * SECOND + k * SECOND // 10)
    assert counter.rate() == pytest.approx(10.0)


def test_stamps_are_counted_by_what_is_strange():
    stamps = Stamps(message="RAW_IMU")
    for stamp in (0, 1000, 3000, 3000, 2000, 4000, 6000, 90_000):
        stamps.add(stamp)
    assert (stamps.count, stamps.repeated, stamps.backward, stamps.gaps) == (8, 1, 1, 1)
    assert (stamps.zero, stamps.is_whole_ms) == (1, True)
    assert math.isnan(evidence_of().time.offset_s)
