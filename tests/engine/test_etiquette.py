"""How the companion behaves on the link, in flights of the simulated autopilot."""

import itertools
import logging
from dataclasses import replace

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.keys import with_value
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.statustext import Severity
from ekf_companion.nav.state import Status
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import parse
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench
from tests.engine.conversation import as_messages, named

ALLOWED = {
    *("HEARTBEAT", "ODOMETRY", "ESTIMATOR_STATUS", "GPS_GLOBAL_ORIGIN", "TIMESYNC", "STATUSTEXT"),
    *("COMMAND_LONG", "COMMAND_ACK", "REQUEST_DATA_STREAM", "PARAM_VALUE", "PARAM_ERROR"),
    "PARAM_REQUEST_READ",
    *("AUTOPILOT_VERSION", "COMPONENT_INFORMATION_BASIC", "PROTOCOL_VERSION", "MESSAGE_INTERVAL"),
}
"""What we may say: nothing that an autopilot says of itself."""


class Flown:
    """A companion and an autopilot that hear one another, and anybody who interrupts."""

    def __init__(self, duration=4.0, kind=Kind.PX4, config=None):
        sim = SimConfig()
        self.companion = Companion(config or Config())
        self.autopilot = Autopilot(sim, kind)
        self.cycles = Flight.plan("hover", sim, duration=duration).cycles()
        self.station = Sender(255, 190)
        self.said = []
        self.start_ns = None

    def fly(self, until, interrupt=None, change=None):
        """Fly up to a time since the start, s; give what the companion said in this part."""
        part = []
        for cycle in self.cycles:
            self.start_ns = cycle.t_ns if self.start_ns is None else self.start_ns
            self.autopilot.cycle(cycle)
            frames = self.autopilot.data_to_send()
            if change is not None:
                frames = change(frames)
            self.companion.receive(b"".join(frames), cycle.t_ns)
            if interrupt is not None and (data := interrupt(cycle.t_ns)):
                self.companion.receive(data, cycle.t_ns)
            self.companion.tick(cycle.t_ns)
            data = self.companion.data_to_send()
            for frame in data:
                self.autopilot.receive(frame, cycle.t_ns)
            part += as_messages(data, cycle.t_ns)
            if cycle.t_ns - self.start_ns >= until * 1e9:
                break
        self.said += part
        return part

    def command(self, number, *params):
        fields = {f"param{k}": value for k, value in enumerate(params, 1)}
        return self.station.message(
            "COMMAND_LONG", target_system=1, target_component=194, command=number, **fields
        )

    def set_parameter(self, name, value):
        return self.station.message(
            "PARAM_SET",
            **{"target_system": 1, "target_component": 194, "param_type": 9},
            param_id=name.encode(),
            param_value=value,
        )


def once(data):
    """Return the bytes the first time, then none."""
    waiting = [data]
    return lambda now_ns: waiting.pop() if waiting else b""


def texts(said):
    return [m.text.decode() for m in named("STATUSTEXT", said)]


def periods(said, name="ODOMETRY"):
    stamps = [m.time_usec for m in named(name, said)]
    return {after - before for before, after in itertools.pairwise(stamps)}


@pytest.mark.parametrize("kind", Kind)
def test_rule_26_nothing_is_said_that_only_an_autopilot_may_say(kind):
    """Rule 26."""
    flown = Flown(5.0, kind)
    flown.fly(2.0)
    # Somebody asks for every message that there is, in both ways, and for all parameters
    wishes = [flown.command(512, float(number)) for number in LAYOUTS]
    wishes += [flown.command(511, float(number), 1e5) for number in LAYOUTS]
    wishes.append(flown.station.message("PARAM_REQUEST_LIST"))
    flown.fly(2.5, once(b"".join(wishes)))
    flown.fly(5.0)
    names = {one.name for one in flown.said}
    assert names <= ALLOWED
    assert {"ODOMETRY", "PARAM_VALUE", "AUTOPILOT_VERSION"} <= names
    impersonating = {"ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "GPS_RAW_INT"}
    assert not names & (impersonating | {"HIGHRES_IMU"})


@pytest.mark.parametrize(("kind", "rate"), [(Kind.ARDUPILOT, 50.0), (Kind.PX4, 100.0)])
def test_rule_22_an_ardupilot_is_sent_no_more_than_it_takes(kind, rate):
    """Rule 22."""
    config = Config(output=OutputConfig(odometry=OdometryConfig(rate=100.0)))
    stamps = [m.time_usec for m in named("ODOMETRY", Flown(4.0, kind, config).fly(4.0))]
    assert (len(stamps) - 1) / (stamps[-1] - stamps[0]) * 1e6 == pytest.approx(rate, rel=0.01)


def without_fixes(frames):
    away = {IDS["GPS_RAW_INT"], IDS["GLOBAL_POSITION_INT"]}
    return [frame for frame in frames if int.from_bytes(frame[7:10], "little") not in away]


def test_rule_22_nothing_is_sent_before_there_is_a_position():
    """Rule 22."""
    flown = Flown(4.0)
    flown.fly(2.0, change=without_fixes)
    wish = once(flown.command(512, IDS["ODOMETRY"]))
    part = flown.fly(3.0, wish, change=without_fixes)
    assert [m.result for m in named("COMMAND_ACK", part)] == [1]  # temporarily rejected
    assert not named("ODOMETRY", flown.said)


def test_rule_21_no_stamp_is_repeated_however_often_it_is_asked_for():
    """Rule 21."""
    flown = Flown(4.0)
    flown.fly(2.0)
    wish = flown.command(512, IDS["ODOMETRY"])
    part = flown.fly(3.0, lambda now_ns: wish * 3)
    stamps = [m.time_usec for m in named("ODOMETRY", flown.said)]
    assert all(after > before for before, after in itertools.pairwise(stamps))
    asked = [m.result for m in named("COMMAND_ACK", part)]
    assert set(asked) == {0, 1}  # four times a second, whoever asks; else temporarily rejected
    assert asked.count(0) in {4, 5}  # in the last second of the flight


def test_rule_31_an_interval_is_obeyed_at_once():
    """Rule 31."""
    flown = Flown(6.0)
    flown.fly(2.0)
    part = flown.fly(3.0, once(flown.command(511, IDS["ODOMETRY"], 100_000.0)))
    assert max(periods(part)) == 100_000
    assert named("ODOMETRY", flown.fly(4.0, once(flown.command(511, IDS["ODOMETRY"], -1.0)))) == []
    part = flown.fly(5.0, once(flown.command(511, IDS["ODOMETRY"], 0.0)))
    assert len(named("ODOMETRY", part)) == pytest.approx(30, abs=1)
    assert named("ESTIMATOR_STATUS", part)


def test_rule_30_a_parameter_is_obeyed_at_once_and_told():
    """Rule 30."""
    flown = Flown(4.0)
    flown.fly(2.0)
    part = flown.fly(3.0, once(flown.set_parameter("EC_ODOM_RATE", 10.0)))
    assert [m.param_value for m in named("PARAM_VALUE", part)] == [10.0]
    assert max(periods(part)) == 100_000
    assert "Companion: EC_ODOM_RATE is 10" in texts(part)
    assert flown.companion.tuning.config.output.odometry.rate == 10.0


def test_rule_30_a_parameter_is_told_as_it_counts_after_a_reload_too():
    """Rule 30."""
    flown = Flown(4.0)
    flown.fly(1.0)
    usual = Config().baro.std
    flown.companion.reload(with_value(Config(), "baro.std", 7.0))
    part = flown.fly(2.0)
    assert [m.param_value for m in named("PARAM_VALUE", part)] == [7.0]
    part = flown.fly(3.0, once(flown.set_parameter("EC_BARO_NSE", usual)))
    assert [m.param_value for m in named("PARAM_VALUE", part)] == [usual]
    assert flown.companion.tuning.config.baro.std == usual


def test_rule_30_what_counts_from_the_next_start_only_is_said_to():
    """Rule 30."""
    flown = Flown(3.0)
    flown.fly(1.0)
    part = flown.fly(2.0, once(flown.set_parameter("EC_GPS_DELAY", 0.3)))
    assert [m.param_value for m in named("PARAM_VALUE", part)] == [pytest.approx(0.3)]
    assert "Companion: EC_GPS_DELAY is 0.3 from the next start" in texts(part)


def test_rule_29_a_flood_of_settings_drowns_nothing_that_matters(caplog):
    """Rule 29."""
    caplog.set_level(logging.INFO)
    flown = Flown(8.0)
    flown.fly(2.0)
    numbers = itertools.count()
    statustext = flown.companion.session.statustext

    def flood(now_ns):
        number = next(numbers)
        if number == 500:
            statustext.send(Severity.CRITICAL, "Companion: all is lost")
        return flown.set_parameter("EC_BARO_NSE", 1.0 + 0.01 * number)

    part = flown.fly(7.0, flood)
    assert next(numbers) > 1000
    assert "Companion: all is lost" in texts(part)
    assert statustext.dropped == 0
    assert 3 <= caplog.text.count("Parameter EC_BARO_NSE set to") <= 7


def test_rule_30_the_mode_is_obeyed_at_once():
    """Rule 30."""
    flown = Flown(5.0)
    flown.fly(2.0)
    part = flown.fly(3.0, once(flown.set_parameter("EC_ODOM_MODE", 2.0)))
    assert len(named("ODOMETRY", part)) <= 1
    part = flown.fly(4.0, once(flown.set_parameter("EC_ODOM_MODE", 1.0)))
    assert len(named("ODOMETRY", part)) == pytest.approx(30, abs=1)


def test_rule_4_no_odometry_is_sent_while_somebody_else_speaks_as_us():
    """Rule 4."""
    flown = Flown(13.0)
    flown.fly(2.0)
    assert named("ODOMETRY", flown.said)
    other = Sender(1, 194)
    other.sequence = 99

    def beat():
        return once(other.message("HEARTBEAT", type=18, autopilot=8))

    flown.fly(3.0, beat())
    part = flown.fly(3.5, beat())
    assert len(named("ODOMETRY", part)) <= 1
    assert "Companion: id 194 is taken twice, not sending" in "".join(texts(part))
    part = flown.fly(7.9, once(flown.command(512, IDS["ODOMETRY"])))
    assert not named("ODOMETRY", part)
    assert named("HEARTBEAT", part)
    assert [m.result for m in named("COMMAND_ACK", part)] == [1]
    flown.fly(8.2)
    assert named("ODOMETRY", flown.fly(9.0))


@pytest.mark.parametrize(("weigh", "begin"), [("off", 6.0), ("act", 16.0)])
def test_rule_29_the_pilot_is_told_what_changes_and_only_that(weigh, begin):
    """Rule 29; that a receiver may settle yet takes ten seconds to be ruled out."""
    flown = Flown(begin + 8.0, config=replace(Config(), weigh_faults=weigh))
    flown.fly(begin)
    assert texts(flown.said).count("Companion: estimate OK") == 1
    lost = texts(flown.fly(begin + 4.0, change=without_fixes))
    assert lost[:2] == [
        "Companion: GNSS lost, dead reckoning",
        "Companion: no ODOMETRY: dead reckoning over 2 s",
    ]
    assert texts(flown.fly(begin + 8.0))[-2:] == [
        "Companion: estimate OK",
        "Companion: ODOMETRY is sent again",
    ]
    assert len(texts(flown.said)) <= 8
    state = [(m.system_status, m.custom_mode) for m in named("HEARTBEAT", flown.said)]
    assert state[-1] == (4, 3)
    assert (5, 5) in state


def as_raw(frames):
    """Return RAW_IMU for HIGHRES_IMU, as an ArduPilot whose first sensor has died."""
    out = []
    for frame in frames:
        (one,) = Splitter().feed(frame)
        if one.message_id != IDS["HIGHRES_IMU"]:
            out.append(frame)
            continue
        m = unpack(one)
        sender = Sender(1, 1)
        sender.sequence = one.sequence
        fields = {
            f"{axis}{kind}": round(getattr(m, f"{axis}{kind}") * scale)
            for axis in "xyz"
            for kind, scale in (("acc", 1e3 / 9.80665), ("gyro", 1e3), ("mag", 1e3))
        }
        out.append(sender.message("RAW_IMU", time_usec=m.time_usec, **fields))
    return out


def test_rule_7_a_switch_of_the_inertial_source_counts_as_a_reset_and_is_told():
    """Rule 7."""
    flown = Flown(14.0, Kind.ARDUPILOT)
    flown.fly(4.0)
    before = named("ODOMETRY", flown.said)[-1].reset_counter
    # Not used until the better source has been silent for 3 s; then begun anew
    part = flown.fly(6.9, change=as_raw)
    assert not [m for m in named("ODOMETRY", part) if m.time_usec * 1000 > flown.start_ns + 4.1e9]
    part = flown.fly(14.0, change=as_raw)
    after = named("ODOMETRY", part)
    assert after[-1].reset_counter > before
    assert "Companion: IMU is RAW_IMU, was HIGHRES_IMU" in "".join(texts(part))


def test_rule_7_an_ardupilot_with_a_slow_loop_is_asked_for_less_until_it_grants_it(caplog):
    """Rule 7: A Plane's loop of 50 Hz: 40 Hz at the most, and nobody says so."""
    caplog.set_level(logging.INFO)
    personality = parse("ardupilot-old:loop_rate=50")
    flight = Flight.plan("figure-eight", personality.suited(SimConfig()), duration=15.0)
    companion = Companion(Config())
    Bench(flight, companion, personality=personality).run()
    assert companion.session.requests.results["HIGHRES_IMU"] == "denied"
    assert companion.session.requests.expected_rate("RAW_IMU") == 40.0
    assert companion.pipeline.health().status is Status.OK
    words = "RAW_IMU is granted at 40 Hz, and 250 were asked for: raise SCHED_LOOP_RATE"
    assert caplog.text.count(words) == 1
