"""How an autopilot is asked for what the guard does not read."""

import pytest

from ekf_companion.doctor.parameters import FURTHER, ParameterReader
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.fusion import NAMES

MS = 1_000_000


def asked(reader, answers=lambda name: ()):
    """Return how often each is asked for, in ten seconds; ``answers`` gives none or one."""
    names = []
    for now_ns in range(0, 10_000 * MS, 10 * MS):
        payload = reader.request(1, 1, now_ns)
        if payload is None:
            continue
        frame = Sender(1, 194).frame("PARAM_REQUEST_READ", payload)
        names.append(unpack(next(iter(Splitter().feed(frame)))).param_id.decode())
        for answer in answers(names[-1]):
            reader.receive(names[-1], answer, Family.PX4)
    return {name: names.count(name) for name in names}


def test_each_parameter_is_asked_three_times_and_then_given_up():
    reader = ParameterReader()
    reader.begin(Family.PX4, is_deciding=False)
    assert not reader.is_done
    assert asked(reader) == dict.fromkeys(FURTHER[Family.PX4], 3)
    assert reader.is_done


@pytest.mark.parametrize(("answer", "value"), [(0.0, 0.0), (None, None)])
def test_what_is_answered_is_asked_once_whether_or_not_it_exists(answer, value):
    reader = ParameterReader()
    reader.begin(Family.PX4, is_deciding=False)
    assert asked(reader, lambda name: (answer,)) == dict.fromkeys(FURTHER[Family.PX4], 1)
    assert reader.is_done
    assert set(reader.answers.values()) == {value}
    assert bool(reader.values) == (value is not None)


def test_what_decides_is_asked_only_where_the_guard_asks_nothing():
    """Rule 25."""
    reader = ParameterReader()
    reader.begin(Family.PX4, is_deciding=True)
    counts = asked(reader, lambda name: (15.0,) if name == "EKF2_EV_CTRL" else ())
    assert counts["EKF2_EV_CTRL"] == 1
    assert counts["EKF2_GPS_CTRL"] == 3
    assert "EKF2_EV_CTRL" not in FURTHER[Family.PX4]


def test_parameters_that_nobody_wants_are_not_kept():
    reader = ParameterReader()
    for name in (*NAMES[Family.ARDUPILOT], *FURTHER[Family.ARDUPILOT], "SYSID_THISMAV", "A" * 16):
        reader.receive(name, 1.0, Family.ARDUPILOT)
    assert len(reader.values) == len(NAMES[Family.ARDUPILOT]) + len(FURTHER[Family.ARDUPILOT])
