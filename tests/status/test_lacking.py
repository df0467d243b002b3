"""Why an estimate has no position yet, as the status says it: each cause with its remedy."""

from dataclasses import replace

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.nav.state import Status
from ekf_companion.status.judge import judge
from sim_autopilot.autopilot import Kind
from tests.engine.conversation import cycles
from tests.status.test_observer import Watched

NO_HEADING = ("ATTITUDE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")
MAG_UPDATED = 0x1C0


def with_field(flight, field):
    """Yield a flight's messages with one reading of a magnetometer in each inertial one."""
    sender, splitter = Sender(1, 1), Splitter()
    for t_ns, data in flight:
        said = []
        for frame in splitter.feed(data):
            message = unpack(frame)
            fields = message._asdict()
            if "xmag" in fields:
                fields |= dict(zip(("xmag", "ymag", "zmag"), field, strict=True))
                fields["fields_updated"] |= MAG_UPDATED
            said.append(sender.message(LAYOUTS[frame.message_id].name, **fields))
        yield t_ns, b"".join(said)


def told(flight):
    """Return the status of a companion that was fed, and what it is judged to be."""
    snapshot = Watched().feed(flight).snapshot()
    check = judge(replace(snapshot, link=replace(snapshot.link, is_open=True)))
    assert (check.is_healthy, check.is_ok) == (True, False)
    assert snapshot.estimator.status is Status.ATTITUDE
    assert check.line.startswith("no position yet: the estimate is ATTITUDE; ")
    return check.line


def test_a_magnetometer_without_noise_as_in_ardupilots_simulator_is_named():
    flight = cycles(12.0, "hover", kind=Kind.ARDUPILOT, without=NO_HEADING)
    line = told(with_field(flight, (0.2, 0.0, 0.4)))
    assert "north is not found: the magnetometer repeats one reading" in line
    assert "set SIM_MAG_RND 5" in line


def test_that_no_magnetic_field_comes_is_named():
    line = told(with_field(cycles(12.0, "hover", without=NO_HEADING), (0.0, 0.0, 0.0)))
    assert "no magnetic field comes: check that the autopilot has a magnetometer" in line


def test_that_no_fix_comes_is_named():
    line = told(cycles(6.0, "hover", without=("GPS_RAW_INT", "GLOBAL_POSITION_INT")))
    assert "no fix has come: check that the autopilot has a receiver" in line


def test_a_magnetometer_that_does_not_measure_the_earth_is_named():
    flight = cycles(12.0, "hover", without=NO_HEADING)
    assert "the magnetometer's field is not the Earth's" in told(with_field(flight, (2.0, 0, 3.0)))
