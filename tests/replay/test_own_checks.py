"""Aids and filters of a user's own: their times, and what they return."""

from dataclasses import replace
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from ekf_companion import OwnAid
from ekf_companion.errors import ConfigError, DataError
from ekf_companion.filters import mahony
from ekf_companion.nav.state import COLUMNS, Table
from tests.arrays.test_run import Flown


class Down(OwnAid):
    """Height below the first fix."""

    aid = "range"

    def __init__(self, answer=None, R=None, H=None):
        self.answer, self.R, self.H = answer, R, H

    def innovation(self, state):
        return 0.0 * state.pos_n[..., 2:3] if self.answer is None else self.answer(state)

    def covariance(self):
        return np.array([[25.0]]) if self.R is None else self.R

    def jacobian(self, state):
        return np.eye(15)[8:9] if self.H is None else self.H


@pytest.fixture(scope="module")
def flown():
    return Flown(duration=12.0)


class Seen(Down):
    """Counts how often it was asked."""

    asked = 0

    def innovation(self, state):
        type(self).asked += 1
        return super().innovation(state)


@pytest.mark.parametrize(
    "as_time",
    [
        lambda t: t,
        lambda t: np.float32(t),
        lambda t: np.float64(t),
        lambda t: round(t * 1e9),
        lambda t: np.int64(t * 1e9),
    ],
)
def test_times_of_aids_are_seconds_or_nanoseconds(flown, as_time):
    Seen.asked = 0
    aids = [(as_time(float(flown.time[-1]) - 1.0), Seen())]
    flown.estimate(filter="iterated", baro=None, aids=aids)
    assert Seen.asked > 0


def test_dates_are_times_of_aids_where_they_are_those_of_the_samples(flown):
    Seen.asked = 0
    begin = np.datetime64("2026-05-04T10:00:00", "ns")
    sensors = {
        name: {**table, "time": begin + np.rint(table["time"] * 1e9).astype("timedelta64[ns]")}
        for name, table in (("gnss", flown.gnss), ("mag", flown.mag))
    }
    at = datetime(2026, 5, 4, 12, 0, tzinfo=timezone(timedelta(hours=2))) + timedelta(
        seconds=float(flown.time[-1]) - 1.0
    )
    flown.estimate(
        time=begin + np.rint(flown.time * 1e9).astype("timedelta64[ns]"),
        **sensors,
        baro=None,
        filter="iterated",
        aids=[(at, Seen())],
    )
    assert Seen.asked > 0


@pytest.mark.parametrize(
    ("aids", "sentence"),
    [
        (lambda t: [(t + 100.0, Down())], "1 of 1 lie outside the time of the recording"),
        (lambda t: [(5, Down())], "floats are s and integers ns"),
        (lambda t: [(t * 1e9, Down())], "beyond every clock|lie outside the time"),
        (lambda t: [(float("nan"), Down())], "row 0: nan is no time"),
        (lambda t: [("now", Down())], "row 0: 'now' is no time"),
        (lambda t: [(None, Down())], "row 0: None is no time"),
        (lambda t: [(Down(), t)], "row 0: float .* has no aid; give pairs"),
        (lambda t: [Down()], "row 0 is Down .*; give pairs"),
        (
            lambda t: [(t, Down(lambda state: np.array([np.nan])))],
            r"Down at .*: innovation\(\).*nan",
        ),
        (lambda t: [(t, Down(lambda state: 0.0))], r"innovation\(\) returned the shape \(\), not"),
        (lambda t: [(t, Down(lambda state: None))], r"innovation\(\) returned"),
        (lambda t: [(t, Down(lambda state: "high"))], r"innovation\(\) returned str 'high', not n"),
        (lambda t: [(t, Down(lambda state: np.zeros(4)))], r"the shape \(4,\), not"),
        (lambda t: [(t, Down(lambda state: np.array([1j])))], "array.*, not numbers"),
        (lambda t: [(t, Down(lambda state: np.array(["2026"], "M8[s]")))], "array.*, not numbers"),
        (
            lambda t: [(t, Down(lambda state: np.ma.masked_all(1)))],
            r"innovation\(\) returned nan",
        ),
        (lambda t: [(t, Down(R=np.eye(2)))], r"covariance\(\) returned m = 2, and innovation"),
        (lambda t: [(t, Down(H=np.zeros((2, 15))))], r"jacobian\(\) returned m = 2, and innovatio"),
        (lambda t: [(t, Down(R=4.0))], r"covariance\(\) returned the shape \(\), not \(m, m\)"),
        (lambda t: [(t, Down(R=np.array([[-1.0]])))], "symmetric and positive definite"),
        (lambda t: [(t, Down(R=np.array([[1.0, 2.0], [0.0, 1.0]])))], "symmetric and positive"),
        (lambda t: [(t, Down(H=np.zeros((1, 9))))], r"jacobian\(\) returned the shape \(1, 9\)"),
    ],
)
def test_an_aid_that_cannot_be_meant_is_named(flown, aids, sentence):
    with pytest.raises(DataError, match=sentence):
        flown.estimate(filter="iterated", baro=None, aids=aids(float(flown.time[-1]) - 1.0))


def test_some_aids_outside_the_recording_are_noted(flown):
    aids = [(float(flown.time[-1]) - 1.0, Down()), (float(flown.time[-1]) + 9.0, Down())]
    found = flown.estimate(filter="iterated", baro=None, aids=aids)
    assert any("aids: 1 of 2 lie outside the time" in note for note in found.notes)


def solution(recording, settings, _):
    return mahony.run(recording.events, gap=settings.imu.gap_reset)


def with_column(name, value):
    """Return a filter whose estimates hold a value in a column."""

    def my_filter(recording, settings, option):
        found = solution(recording, settings, option)
        values = found.table.values.copy()
        values[7, COLUMNS.index(name) - 1] = value
        return replace(found, table=Table(stamp_ns=found.table.stamp_ns, values=values))

    return my_filter


def with_table(change):
    def my_filter(recording, settings, option):
        found = solution(recording, settings, option)
        return replace(found, table=change(found.table))

    return my_filter


@pytest.mark.parametrize(
    ("own", "sentence"),
    [
        (lambda *_: None, "returned None; a filter returns a Solution"),
        (lambda *given: solution(*given).table, "returned Table .*; a filter returns a Solution"),
        (with_column("q_w", 3.0), "my_filter: 1 of .* not of length 1, the first is row 7"),
        (with_column("sd_pos_n", -1.0), "hold a sigma below 0, the first is row 7"),
        (with_column("vel_n", np.inf), "hold infinity; what is not known is NaN"),
        (with_table(lambda one: one.values), "the table of its Solution is ndarray"),
        (
            with_table(lambda one: Table(stamp_ns=one.stamp_ns, values=one.values[:, :9])),
            r"the values of its table have the shape \(\d+, 9\)",
        ),
        (
            with_table(lambda one: Table(stamp_ns=one.stamp_ns[::-1], values=one.values)),
            "must be ascending integers",
        ),
        (
            with_table(lambda one: Table(stamp_ns=one.stamp_ns[:0], values=one.values[:0])),
            "returned no estimate",
        ),
    ],
)
def test_a_filter_that_returns_nonsense_is_named(flown, own, sentence):
    with pytest.raises(DataError, match=sentence):
        flown.estimate(baro=None, gnss=None, filter=own)


@pytest.mark.parametrize(
    ("own", "sentence"),
    [
        (None, "filter: None is none: give a name"),
        (5, "filter: 5 is none: give a name"),
        (lambda recording, settings: None, "a filter is a function of recording, settings and opt"),
    ],
)
def test_what_is_no_filter_is_named(flown, own, sentence):
    with pytest.raises((ConfigError, DataError), match=sentence):
        flown.estimate(baro=None, gnss=None, filter=own)


def test_a_filter_of_ones_own_that_means_it_passes(flown):
    assert len(flown.estimate(baro=None, gnss=None, filter=solution)) == 600
