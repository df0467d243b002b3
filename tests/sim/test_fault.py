import itertools
import math

import pytest

from ekf_companion.errors import ConfigError
from sim_autopilot.faults.fault import KINDS, VARIETY, parse, schedule


def test_every_kind_can_be_read_with_nothing_said_and_written_as_it_is_read():
    for name, kind in KINDS.items():
        fault = parse(name)
        assert (fault.start, fault.duration, fault.kind) == (0.0, kind.duration, kind)
        assert set(fault.values) == set(kind.values)
        assert parse(str(fault)) == fault


def test_values_are_read():
    fault = parse("loss:start=20,duration=5,share=0.3,way=in")
    assert (fault.start, fault.end, fault.values) == (20.0, 25.0, {"share": 0.3, "way": "in"})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fire", "no such fault; there are loss, duplicate, "),
        ("los:share=1", "did you mean loss"),
        ("loss:sahre=0.3", "no such value of loss; there are start, duration, share, way"),
        ("loss:share=1.5", "share=1.5: must be a number from 0 to 1"),
        ("loss:share=nan", "must be a number"),
        ("loss:share=", "is not key=value"),
        ("loss:way=up", "no such value of way; there are both, out, in"),
        ("gnss-frozen:time=fast", "there are advancing, same"),
        ("cut:start=61", "starts at 61 s, but the flight ends at 60 s"),
        ("cut:start=1,start=2", "start stands twice"),
    ],
)
def test_a_fault_that_cannot_be_meant_is_refused_with_a_remedy(text, words):
    with pytest.raises(ConfigError, match=words):
        parse(text, 60.0)


def test_a_schedule_holds_every_kind_in_random_order_with_quiet_between():
    faults = schedule(VARIETY, seed=3, duration=1500.0, gap=20.0)
    setups = {
        "mounting",
        "own-estimate",
        "accel-drift",
        "imu-step",
        "imu-noise",
    }  # wrong from the start, and to its end
    assert {fault.kind.name for fault in faults} == set(KINDS) - setups
    assert sum(fault.values.get("how") == "nofix" for fault in faults) >= 1
    assert faults[0].start == 30.0
    for before, after in itertools.pairwise(faults):
        assert after.start == pytest.approx(before.end + 20.0)
    assert faults[-1].end <= 1480.0
    # The first round holds all of them
    assert len({str(fault.kind.name) for fault in faults[: len(VARIETY)]}) == len(KINDS) - 5
    again = schedule(VARIETY, seed=3, duration=1500.0, gap=20.0)
    assert [str(fault) for fault in again] == [str(fault) for fault in faults]
    other = schedule(VARIETY, seed=4, duration=1500.0, gap=20.0)
    assert [str(fault) for fault in other] != [str(fault) for fault in faults]


def test_a_schedule_that_does_not_fit_says_what_it_needs():
    with pytest.raises(ConfigError, match=r"need 80 s .* the flight has 60 s"):
        schedule(["cut", "loss"], seed=1, duration=60.0, gap=20.0)
    assert schedule([], seed=1, duration=60.0, gap=20.0) == []
    assert math.isclose(schedule(["cut"], 1, 60.0, 20.0)[0].end, 35.0)
