"""Our parameters, as a ground station reads and sets them."""

import math
import struct
from dataclasses import replace

import hypothesis.strategies as st
import pytest
from hypothesis import given
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink.event import ParameterSet
from ekf_companion.mavlink.parameters import Parameter
from tests.mavlink.conversation import MS, SECOND, met, sent, station

RATE = Parameter(name="EC_RATE", key="output.rate", value=30.0, lowest=1.0, highest=200.0)
MODE = Parameter(
    name="EC_SIXTEEN_CHARS", key="mode", value=0.0, lowest=0.0, highest=2.0, is_whole=True
)
NOISE = Parameter(name="EC_NOISE", key="noise", value=0.002, lowest=1e-5, highest=0.1)
TABLE = (RATE, MODE, NOISE)
ALL, OURS, OTHERS = (0, 0), (1, 194), (1, 1)


def served():
    session, _ = met(parameters=TABLE)
    return session, station()


def ask(session, who, name, target=OURS, now_ns=0, **fields):
    target = {"target_system": target[0], "target_component": target[1]}
    session.receive(who.say(name, **target, **fields), now_ns)
    return sent(session, "PARAM_VALUE", "PARAM_ERROR")


def put(session, who, name, value, param_type=9):
    fields = {"param_id": name.encode(), "param_value": value, "param_type": param_type}
    return ask(session, who, "PARAM_SET", **fields)


@pytest.mark.parametrize("target", [ALL, OURS, (1, 0), (0, 194)])
def test_rule_30_a_list_is_told_whole_in_order_and_slowly(target):
    """Rule 30."""
    session, who = served()
    ask(session, who, "PARAM_REQUEST_LIST", target)
    told = []
    for now_ns in range(0, 2 * SECOND, MS):
        session.tick(now_ns)
        told += [(now_ns, m) for m in sent(session, "PARAM_VALUE")]
    assert [m.param_id.decode() for _, m in told] == ["EC_RATE", "EC_SIXTEEN_CHARS", "EC_NOISE"]
    assert [m.param_index for _, m in told] == [0, 1, 2]
    assert {(m.param_count, m.param_type) for _, m in told} == {(3, 9)}
    assert [m.param_value for _, m in told] == pytest.approx([30.0, 0.0, 0.002])
    # 37 bytes each: less than 30 % of a wire at 57600 baud
    span = (told[-1][0] - told[0][0]) * 1e-9
    assert 2 * 37 / span <= 0.3 * 5760


def test_rule_30_many_who_ask_for_the_list_get_it_once():
    """Rule 30."""
    session, who = served()
    for _ in range(1000):
        ask(session, who, "PARAM_REQUEST_LIST")
    told = []
    for now_ns in range(0, 2 * SECOND, 10 * MS):
        session.tick(now_ns)
        told += sent(session, "PARAM_VALUE")
    assert len(told) == 3


def test_rule_30_one_is_read_by_name_or_by_place():
    """Rule 30."""
    session, who = served()
    by_name = ask(session, who, "PARAM_REQUEST_READ", param_id=b"EC_SIXTEEN_CHARS", param_index=-1)
    by_place = ask(session, who, "PARAM_REQUEST_READ", param_index=1)
    assert by_name == by_place
    assert [m.param_id for m in by_name] == [b"EC_SIXTEEN_CHARS"]


@pytest.mark.parametrize("fields", [{"param_id": b"NOPE", "param_index": -1}, {"param_index": 3}])
def test_rule_30_what_there_is_not_is_an_error_for_who_asked_us_and_silence_for_all(fields):
    """Rule 30."""
    session, who = served()
    (error,) = ask(session, who, "PARAM_REQUEST_READ", **fields)
    assert type(error).__name__ == "PARAM_ERROR"
    assert (error.target_system, error.target_component, error.error) == (255, 190, 1)
    assert error.error == dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert ask(session, who, "PARAM_REQUEST_READ", ALL, **fields) == []
    (error,) = put(session, who, "NOPE", 1.0)
    assert type(error).__name__ == "PARAM_ERROR"


def test_rule_30_a_value_in_range_is_taken_and_told_to_all():
    """Rule 30."""
    session, who = served()
    (told,) = put(session, who, "EC_NOISE", 0.1)
    assert told.param_value == pytest.approx(0.1)
    # As a person would write it: a float32 holds 0.10000000149
    assert session.events() == [ParameterSet("EC_NOISE", "noise", 0.1)]
    (again,) = put(session, who, "EC_NOISE", told.param_value)
    assert again == told
    assert session.events() == []


@pytest.mark.parametrize(
    ("name", "value", "param_type"),
    [
        ("EC_RATE", 0.99, 9),
        ("EC_RATE", 200.1, 9),
        ("EC_RATE", math.nan, 9),
        ("EC_RATE", math.inf, 9),
        ("EC_SIXTEEN_CHARS", 1.5, 9),
        ("EC_SIXTEEN_CHARS", -1.0, 9),
        ("EC_RATE", struct.unpack("<f", struct.pack("<i", 50))[0], 6),
        ("EC_RATE", 50.0, 6),
    ],
)
def test_rule_30_what_is_refused_is_answered_with_the_old_value(name, value, param_type):
    """Rule 30."""
    session, who = served()
    (told,) = put(session, who, name, value, param_type)
    assert type(told).__name__ == "PARAM_VALUE"
    assert told.param_value == (30.0 if name == "EC_RATE" else 0.0)
    assert session.events() == []


def test_rule_30_what_is_for_others_is_theirs():
    """Rule 30."""
    session, who = served()
    assert ask(session, who, "PARAM_REQUEST_READ", OTHERS, param_index=0) == []
    fields = {"param_id": b"EC_RATE", "param_value": 50.0, "param_type": 9}
    assert ask(session, who, "PARAM_SET", OTHERS, **fields) == []
    ask(session, who, "PARAM_REQUEST_LIST", OTHERS)
    session.tick(SECOND)
    assert sent(session, "PARAM_VALUE") == []


def test_rule_30_without_a_table_nothing_is_served():
    """Rule 30."""
    session, _ = met()
    who = station()
    ask(session, who, "PARAM_REQUEST_LIST")
    session.tick(0)
    assert sent(session, "PARAM_VALUE") == []
    assert ask(session, who, "PARAM_REQUEST_READ", param_id=b"X", param_index=-1) == []
    assert put(session, who, "X", 1.0) == []


@given(
    st.sampled_from(["PARAM_SET", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST"]),
    st.binary(max_size=40),
)
def test_rule_30_no_request_raises_or_leaves_the_range(name, payload):
    """Rule 30."""
    session, who = served()
    session.receive(who.sender.frame(name, payload), 0)
    session.tick(0)
    for message in sent(session, "PARAM_VALUE"):
        parameter = TABLE[message.param_index]
        assert parameter.lowest * 0.999 <= message.param_value <= parameter.highest


def test_rule_30_what_another_way_has_turned_is_told_and_can_be_set_back():
    """Rule 30: a reload of the file turns parameters too."""
    session, who = served()
    turned = replace(RATE, value=70.0)
    session.parameters.retune((turned, MODE, NOISE))
    session.tick(0)
    session.tick(SECOND)
    (told,) = sent(session, "PARAM_VALUE")
    assert (told.param_id, told.param_value) == (b"EC_RATE", 70.0)
    assert put(session, who, "EC_RATE", 30.0)[0].param_value == 30.0
    assert session.events() == [ParameterSet("EC_RATE", "output.rate", 30.0)]
    session.parameters.retune((RATE, MODE, NOISE))
    session.tick(2 * SECOND)
    assert sent(session, "PARAM_VALUE") == []


def test_rule_30_what_is_not_followed_is_counted_by_reason():
    """Rule 30."""
    session, who = served()
    put(session, who, "EC_RATE", 0.5)
    put(session, who, "EC_RATE", math.nan)
    put(session, who, "EC_RATE", 50.0, param_type=6)
    put(session, who, "NOPE", 1.0)
    ask(session, who, "PARAM_REQUEST_READ", param_index=3)
    ask(session, who, "PARAM_REQUEST_READ", OTHERS, param_index=0)
    put(session, who, "EC_RATE", 60.0)  # and this one is followed
    counters = session.counters()
    assert {name: n for name, n in counters.items() if name.startswith("refused: ")} == {
        "refused: PARAM_SET: EC_RATE is not in 1 to 200": 2,
        "refused: PARAM_SET: is no REAL32": 1,
        "refused: PARAM_SET: no such parameter": 1,
        "refused: PARAM_REQUEST_READ: no such parameter": 1,
        "refused: PARAM_REQUEST_READ: addressed to another": 1,
    }
