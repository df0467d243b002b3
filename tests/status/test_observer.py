"""What the daemon knows of itself, counted while a companion is fed, by a clock that is said."""

import errno
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig, OdometryConfig, OutputConfig
from ekf_companion.engine.checkpoint import Clocks
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.health import Aid
from ekf_companion.engine.warm_start import WarmStart
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link
from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav.state import Status
from ekf_companion.status import past
from ekf_companion.status.host import Host, read_host
from ekf_companion.status.judge import judge, to_json
from ekf_companion.status.latency import BUCKETS_MS, Latency
from ekf_companion.status.observer import Observer
from ekf_companion.status.snapshot import ReloadState
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import ImuConfig, SimConfig, StreamConfig
from sim_autopilot.flight import Flight
from sim_autopilot.personality import Kind
from tests.engine.conversation import cycles

BOARD = Host(rss_mb=50.0, temperatures={"cpu": 61.5})
MS = 1_000_000


class Watched:
    """A companion that is fed as the service does it, on a clock of its own."""

    def __init__(self, delay_ns=MS // 4, config=None, url="udpin:127.0.0.1:14550", warm_start=None):
        self.now_ns = 1_000 * MS
        self.delay_ns = delay_ns
        self.begin_ns = None
        self.last_ns = 0
        self.link = Link(
            parse_url(url), clock=lambda: self.now_ns, on_sent=lambda ns: self.observer.on_sent(ns)
        )
        self.companion = Companion(config or Config(), warm_start=warm_start)
        self.observer = Observer(self.link, self.companion, lambda: self.now_ns)

    def fly(self, duration, name="hover", kind=Kind.PX4, **options):
        """Feed what an autopilot says, which hears what we say and answers it."""
        config = SimConfig(**options)
        flight = Flight.plan(name, config, duration=duration)
        flown = flight.scenario
        autopilot = Autopilot(config, kind, is_wing=flown.is_wing, is_rolling=flown.is_rolling)
        for cycle in flight.cycles():
            autopilot.cycle(cycle)
            said = self._turn(cycle.t_ns, b"".join(autopilot.data_to_send()))
            autopilot.receive(b"".join(said), cycle.t_ns)
        return self

    def feed(self, flight):
        """Feed stamps and bytes of somebody who is deaf to what we say."""
        for t_ns, data in flight:
            self._turn(t_ns, data)
        return self

    def _turn(self, t_ns, data):
        if self.begin_ns is None or t_ns < self.last_ns:
            self.begin_ns = self.now_ns - t_ns
        self.last_ns = t_ns
        self.now_ns = read_ns = t_ns + self.begin_ns
        self.link.bytes_in += len(data)
        self.companion.receive(data, read_ns)
        self.companion.tick(read_ns)
        self.now_ns += self.delay_ns
        said = self.companion.frames_to_send()
        for frame, is_replaceable, _ in said:
            if self.link.is_open:
                self.link.send(frame, is_replaceable=is_replaceable)
            elif is_replaceable:
                self.observer.on_sent(0)  # as a link says that has room
        self.observer.tick(read_ns)
        return [frame for frame, *_ in said]

    def hear(self, *frames):
        """Feed what somebody else says."""
        self.companion.receive(b"".join(frames), self.now_ns)
        return self

    def snapshot(self):
        return self.observer.snapshot(BOARD)


@pytest.fixture(scope="module")
def flown():
    watched = Watched().fly(12.0)
    return watched, watched.snapshot()


def test_rates_are_those_of_the_last_seconds(flown):
    _, snapshot = flown
    rates = {name: message.rate for name, message in snapshot.messages.items()}
    assert rates["HIGHRES_IMU"] == pytest.approx(250.0, rel=0.02)
    assert rates["GPS_RAW_INT"] == pytest.approx(5.0, rel=0.1)
    assert rates["SYSTEM_TIME"] == pytest.approx(1.0, abs=0.25)
    assert snapshot.messages["HIGHRES_IMU"].asked == 250.0
    assert snapshot.messages["HIGHRES_IMU"].count > 2900


def test_a_message_that_comes_no_more_has_no_rate():
    watched = Watched().feed(cycles(3.0))
    for _ in range(60):
        watched.now_ns += 100 * MS
        watched.observer.tick(watched.now_ns)
    snapshot = watched.snapshot()
    assert snapshot.messages["HIGHRES_IMU"].rate == 0.0
    assert snapshot.messages["HIGHRES_IMU"].count > 700
    assert snapshot.link.silent_s == pytest.approx(6.0, abs=0.6)
    assert snapshot.sample_age_s == pytest.approx(6.0, abs=0.6)
    assert not snapshot.output.is_streaming


def test_every_odometry_is_in_the_histogram_once(flown):
    _, snapshot = flown
    process = snapshot.process
    assert process.latency_count == snapshot.output.sent["ODOMETRY"] > 200
    assert process.latency[0.2] == 0
    assert process.latency[0.3] == process.latency_count
    assert process.latency_sum_ms == pytest.approx(0.25 * process.latency_count)
    assert snapshot.output.is_streaming


@pytest.mark.parametrize("bound", BUCKETS_MS)
def test_a_bound_of_the_histogram_belongs_to_its_bucket(bound):
    latency = Latency()
    latency.add(round(bound * MS))
    latency.add(round(bound * MS) + 1)
    assert latency.cumulative()[bound] == 1
    assert list(latency.cumulative()) == list(BUCKETS_MS)
    assert latency.count == 2


def test_the_longest_wait_is_kept_for_seconds_and_then_forgotten():
    """Rule 37: the loop's lag is exported."""
    watched = Watched()
    watched.now_ns += 80 * MS
    watched.observer.tick(watched.now_ns - 80 * MS)
    assert watched.snapshot().process.loop_lag_ms == pytest.approx(80.0)
    watched.observer.on_late_timer(0.3)
    assert watched.snapshot().process.loop_lag_ms == pytest.approx(300.0)
    assert watched.observer.loop_lag_ns == pytest.approx(300 * MS)
    for _ in range(20):
        watched.now_ns += 100 * MS
        watched.observer.tick(watched.now_ns)
    assert watched.observer.loop_lag_ns == 0
    assert watched.snapshot().process.loop_lag_ms == pytest.approx(300.0)
    for _ in range(50):
        watched.now_ns += 100 * MS
        watched.observer.tick(watched.now_ns)
    assert watched.snapshot().process.loop_lag_ms == 0.0


def test_the_stages_are_counted_from_bytes_to_what_is_sent(flown):
    """Rule 40: counters of every stage."""
    watched, snapshot = flown
    assert snapshot.link.bytes_in == watched.link.bytes_in > 100_000
    heard = sum(message.count for message in snapshot.messages.values())
    assert snapshot.frames.frames == heard + sum(snapshot.frames.ignored.values()) > 3000
    assert (snapshot.frames.bad_crc, snapshot.frames.lost) == (0, 0)
    assert (snapshot.peer.system_id, snapshot.peer.family) == (1, "px4")
    assert snapshot.peer.is_heard
    assert snapshot.peer.is_armed
    assert snapshot.peer.silent_s < 1.1
    assert snapshot.estimator.status is Status.OK
    assert snapshot.sample_age_s < 0.5
    assert snapshot.resets == {}
    assert (snapshot.process.rss_mb, snapshot.process.pid) == (50.0, os.getpid())


def test_a_reset_is_counted_under_its_reason():
    watched = Watched().feed(cycles(6.0))
    before = watched.companion.resets
    # Two seconds without a sample: position, velocity and attitude begin anew
    watched.feed(later(cycles(14.0), 8.0))
    assert watched.companion.resets > before
    assert sum(watched.snapshot().resets.values()) == watched.companion.resets


def test_after_a_warm_restart_the_resets_are_those_of_this_run_each_under_its_reason():
    """Rule 40: what was counted before the restart is not booked to the newest reason."""
    flight, clocks = list(cycles(20.0)), Clocks(1_800_000_000 * 1000 * MS, 0, bytes(16))
    before = Watched().feed([*flight[:1500], *flight[2000:3000]])
    assert before.companion.resets >= 1
    found = before.companion.checkpoint(clocks)
    begin_ns, after = 1_000 * MS, clocks.later(500 * MS)
    again = Watched(warm_start=WarmStart(found, after, begin_ns))
    again.feed([*flight[3125:3250], *flight[3850:4900]])
    counts = again.snapshot().resets
    assert counts["restart"] == 1
    assert sum(counts.values()) == again.companion.resets - before.companion.resets >= 2


def later(flight, seconds):
    """Return the part of a flight that begins so many seconds after its start."""
    first = None
    for t_ns, data in flight:
        first = t_ns if first is None else first
        if t_ns - first >= seconds * 1e9:
            yield t_ns, data


# What the services have learnt


def test_the_guards_verdict_is_told_with_what_it_read():
    """Rule 25: why ODOMETRY is withheld, and the parameter to change."""
    watched = Watched().fly(8.0, parameters={"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 7.0})
    output = watched.snapshot().output
    assert (output.is_allowed, output.is_streaming, output.is_settled) == (False, False, True)
    assert output.parameters == {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 7.0}
    assert output.withheld > 100
    assert output.rate == 0.0
    watched.link._port = object()  # open
    words = judge(watched.snapshot()).line
    assert words == (
        f"ok: the estimate is OK, 250 Hz IMU, ODOMETRY withheld: {output.reason}; {output.remedy}"
    )
    assert "EKF2_" in output.remedy


def test_somebody_else_under_our_ids_is_told_as_the_reason():
    other = Sender(1, Config().link.component_id)
    watched = Watched().fly(3.0)
    for _ in range(2):  # one may be an echo
        watched.now_ns += 1000 * MS
        watched.hear(other.message("HEARTBEAT", type=18, autopilot=8))
    output = watched.snapshot().output
    assert (output.is_clash, output.is_allowed) == (True, False)
    assert output.reason == "somebody else speaks as system 1, component 194"
    assert "link.component_id" in output.remedy


def test_a_rate_that_is_asked_for_in_vain_is_told_with_its_cause():
    slow = Watched().fly(45.0, imu=ImuConfig(rate=50.0), streams=StreamConfig(HIGHRES_IMU=50.0))
    message = slow.snapshot().messages["HIGHRES_IMU"]
    assert message.rate == pytest.approx(50.0, rel=0.05)
    assert "lower link.imu_rate" in message.cause
    slow.link._port = object()  # open
    assert f"; HIGHRES_IMU at 50 of 250 Hz: {message.cause}" in judge(slow.snapshot()).line


def test_who_is_not_admitted_is_counted_apart_from_who_is_not_ours():
    config = Config(link=LinkConfig(allow_systems=(1, 255)))
    stranger, station = Sender(9, 1), Sender(255, 190)
    watched = Watched(config=config).fly(1.0)
    before = watched.snapshot().frames
    again = station.message("HEARTBEAT", type=6)
    frames = watched.hear(stranger.message("HEARTBEAT", type=2), again).snapshot().frames
    assert frames.refused == {"system is not in link.allow_systems": 1}
    assert sum(frames.ignored.values()) == sum(before.ignored.values()) + 1
    assert frames.signed == 0


def test_what_was_set_over_mavlink_is_told_by_its_key():
    watched = Watched().fly(0.5)
    assert watched.snapshot().tuned == {}
    station = Sender(255, 190)
    for name, value in ((b"EC_GPS_DELAY", 0.125), (b"EC_ODOM_MODE", 2.0)):
        fields = {"target_system": 1, "target_component": Config().link.component_id}
        request = {**fields, "param_id": name, "param_value": value, "param_type": 9}
        watched.hear(station.message("PARAM_SET", **request))
    snapshot = watched.snapshot()
    assert snapshot.tuned == {"gnss.delay": 0.125, "output.odometry.mode": "never"}
    assert snapshot.output.mode == "never"


def test_a_clock_that_is_known_is_told_with_how_well(flown):
    _, snapshot = flown
    assert snapshot.time.is_locked
    assert snapshot.time.residual_us < 1e3
    assert snapshot.time.rtt_p50_ms == pytest.approx(4.0)


def test_the_inertial_source_is_told(flown):
    _, snapshot = flown
    assert (snapshot.imu.message, snapshot.imu.instance) == ("HIGHRES_IMU", 0)
    assert snapshot.imu.rate == snapshot.messages["HIGHRES_IMU"].rate
    assert not snapshot.imu.is_dejittered


def test_the_last_reload_is_told_in_its_words():
    watched = Watched()
    assert watched.snapshot().reload == ReloadState()
    changed = Config(output=OutputConfig(odometry=OdometryConfig(rate=10.0)))
    watched.companion.reload("a.yaml: cannot be read")
    watched.companion.reload(changed)
    told = ReloadState(count=2, words="Taken: output.odometry.rate: 30.0 -> 10.0")
    assert watched.snapshot().reload == told


def test_a_bug_in_the_status_line_stops_no_flight(caplog):
    watched = Watched()
    assert watched.observer.health_line() == judge(watched.snapshot()).line
    watched.observer._link = None
    assert [watched.observer.health_line() for _ in range(3)] == ["", "", ""]
    assert caplog.text.count("The state cannot be sent") == 1


# Judged


def test_a_silent_link_is_not_ok_and_no_fault_of_the_process():
    finding = judge(Watched().snapshot())
    assert (finding.is_healthy, finding.is_ok) == (True, False)
    assert finding.line == (
        "waiting for an autopilot; the link udpin:127.0.0.1:14550 is being opened"
    )


def test_a_link_that_does_not_open_is_told_with_the_reason():
    watched = Watched()
    watched.link.failure = FileNotFoundError(errno.ENOENT, "No such file or directory")
    words = judge(watched.snapshot()).line
    assert "14550 is closed (No such file or directory): check the device" in words


def test_a_filter_that_does_not_go_round_is_stalled():
    watched = Watched().feed(cycles(1.0))
    assert judge(watched.snapshot()).is_healthy
    watched.now_ns += 3_000 * MS
    finding = judge(watched.snapshot())
    assert not finding.is_healthy
    assert finding.line == "stalled: the filter's task has not run for 3.0 s"


def test_an_estimate_is_of_now_for_a_second(flown):
    _, snapshot = flown
    snapshot = replace(snapshot, link=replace(snapshot.link, is_open=True))
    assert judge(replace(snapshot, sample_age_s=0.9)).is_ok
    words = "no estimate, the last was OK; no inertial sample has come for 1.1 s"
    assert judge(replace(snapshot, sample_age_s=1.1)) == (True, words, False)


@pytest.mark.parametrize(
    ("status", "words"),
    [(Status.DEGRADED, "degraded: 250 Hz"), (Status.DEAD_RECKONING, "dead reckoning: 250 Hz")],
)
def test_the_line_of_an_estimate_that_is_worse_than_ok_begins_with_that(flown, status, words):
    _, snapshot = flown
    link = replace(snapshot.link, is_open=True)
    health = replace(snapshot.estimator, status=status)
    finding = judge(replace(snapshot, link=link, estimator=health))
    assert (finding.is_healthy, finding.is_ok) == (True, True)
    assert finding.line.startswith(words)


@pytest.mark.parametrize(
    ("url", "remedy"),
    [
        ("udpin:127.0.0.1:14550", ": lower output.odometry.rate"),
        ("serial:/dev/ttyS1:921600", ": check RTS and CTS, raise the rate of the line or lower "),
    ],
)
def test_a_full_link_is_told_with_what_helps_on_such_a_link(flown, url, remedy):
    _, snapshot = flown
    link = replace(snapshot.link, is_open=True, url=url)
    output = replace(snapshot.output, unsent_rate=30.0)
    words = judge(replace(snapshot, link=link, output=output)).line
    assert f"30 Hz thrown away as the link takes no more{remedy}" in words


def test_an_invalid_estimate_is_not_healthy(flown):
    _, snapshot = flown
    link = replace(snapshot.link, is_open=True)
    words = "ok: the estimate is OK, 250 Hz IMU, ODOMETRY 30 Hz"
    assert judge(replace(snapshot, link=link)) == (True, words, True)
    invalid = replace(snapshot.estimator, status=Status.INVALID)
    finding = judge(replace(snapshot, estimator=invalid))
    assert not finding.is_healthy
    assert finding.line.startswith("invalid: the error has passed its limit")


# Told


def test_a_recording_that_misses_something_is_told_and_is_no_fault_of_the_process(flown):
    _, snapshot = flown
    process = replace(snapshot.process, recording_trouble="/a.tlog: the disk does not answer")
    link = replace(snapshot.link, is_open=True)
    found = judge(replace(snapshot, link=link, process=process))
    assert found.is_healthy
    assert found.line.endswith("; not all is recorded: /a.tlog: the disk does not answer")


def test_json_holds_all_of_it_and_null_for_what_is_not_known(flown):
    _, snapshot = flown
    data = json.loads(to_json(snapshot))
    assert data["health"]["is_healthy"] is True
    assert data["estimator"]["status"] == "ok"
    assert data["estimator"]["verdicts"]["position"]["fused"] > 0
    assert data["estimator"]["arrivals"]["imu"]["estimated"] > 2000
    assert data["messages"]["HIGHRES_IMU"]["rate"] == snapshot.messages["HIGHRES_IMU"].rate
    assert data["process"]["latency"]["0.3"] == snapshot.process.latency_count
    unheard = Watched().snapshot()
    assert math.isnan(unheard.time.offset_s)
    assert json.loads(to_json(unheard))["time"]["offset_s"] is None
    assert set(data) == {"health", *type(snapshot).__dataclass_fields__}


# The board


def test_temperatures_are_read_by_name_and_what_is_broken_is_left_out(tmp_path):
    def put(name, content):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)

    put("thermal/thermal_zone0/type", "cpu-thermal\n")
    put("thermal/thermal_zone0/temp", "48312\n")
    put("thermal/thermal_zone1/type", "cpu-thermal\n")
    put("thermal/thermal_zone1/temp", "50000\n")
    put("thermal/thermal_zone2/type", "off\n")
    put("thermal/thermal_zone2/temp", "-274000\n")
    put("thermal/thermal_zone3/type", "odd\n")
    put("thermal/thermal_zone3/temp", "no number\n")
    put("hwmon/hwmon0/name", "rp1_adc\n")
    put("hwmon/hwmon0/temp1_input", "41000\n")
    put("hwmon/hwmon1/name", "nvme\n")
    put("hwmon/hwmon1/temp1_input", "39850\n")
    put("hwmon/hwmon1/temp1_label", "Composite\n")
    (tmp_path / "hwmon/hwmon1/temp2_input").mkdir()
    board = read_host(tmp_path)
    assert board.temperatures == pytest.approx(
        {"cpu-thermal": 48.312, "cpu-thermal 2": 50.0, "rp1_adc": 41.0, "Composite": 39.85}
    )


def test_a_board_with_a_hundred_sensors_tells_some(tmp_path):
    for number in range(100):
        zone = tmp_path / f"thermal/thermal_zone{number}"
        zone.mkdir(parents=True)
        (zone / "type").write_text("core")
        (zone / "temp").write_text("40000")
    assert len(read_host(tmp_path).temperatures) == 32


def test_the_memory_is_this_process_own():
    # One that maps little: pages of files that are not read for a while are no longer resident
    code = (
        "from ekf_companion.status.host import read_host; before = read_host().rss_mb; "
        "block = b'x' * 300_000_000; print(read_host().rss_mb - before)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(found.stdout) == pytest.approx(300_000_000 / 2**20, rel=0.2)


def test_the_last_estimates_are_kept_one_a_second_for_a_page_that_opens(monkeypatch):
    monkeypatch.setattr(past, "KEPT", 5)
    watched = Watched().fly(9.0)
    kept = json.loads(watched.observer.past())
    assert len(kept) == 5
    ages = [age_s for age_s, _ in kept]
    assert [round(older - newer) for older, newer in pairwise(ages)] == [1, 1, 1, 1]
    assert kept[-1][1]["lat_deg"] == pytest.approx(kept[0][1]["lat_deg"], abs=1e-4)
    assert all(live["age_s"] < 0.1 for _, live in kept)
    shown = json.loads(watched.observer.live())["nis"]
    assert kept[-1][1]["nis"]["position"] == pytest.approx(shown["position"], rel=0.5)
    assert {*shown} == {aid.name.lower() for aid in Aid}


def test_a_bug_in_what_is_kept_for_the_page_is_logged_once_and_ends_nothing(caplog):
    kept = past.Past()
    for second in range(3):
        kept.keep(second * 1_000 * MS, lambda: 1 // 0)
    assert json.loads(kept.to_json(2_000 * MS)) == [[2.0, None], [1.0, None], [0.0, None]]
    assert caplog.text.count("The past cannot be sent to the page") == 1
