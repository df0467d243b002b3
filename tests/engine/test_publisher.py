"""Estimates as messages, and when something periodic is due."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Health
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.engine.publisher import STREAMS, Due, Publisher
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import StatusFlag
from ekf_companion.mavlink.messages import by_name
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.state import Odometry, Status

SLOW = np.where(np.isin(np.arange(21), (0, 6)), 0.01, 1.0)
NUMBERS = np.array([1, 2, 3, 1, 0, 0, 0, *[0.0] * 6, *np.ones(21), *SLOW], dtype="<f4").tobytes()
"""At rest, level, with its nose to the north; the velocity over ground is known to 0.14 m/s."""
ORIGIN = (0.1, 0.2, 300.0)


@dataclass(frozen=True, kw_only=True)
class Given:
    """What the publisher asks of an estimate, without a filter behind it."""

    t_ns: int
    quality: int | None = 100
    sample: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, -9.81)
    unaided_s: float = 0.0
    is_reset_due: bool = False
    origin: tuple[float, float, float] | None = ORIGIN
    health: Health = field(default_factory=lambda: Pipeline(FilterSettings()).health())

    @property
    def odometry(self):
        if self.quality is None:
            return None
        return Odometry(self.t_ns, NUMBERS, 0, self.quality, origin=self.origin)


@dataclass(frozen=True, kw_only=True)
class WithRelative(Given):
    """An estimate that knows its covariance apart from the slow error of the receiver, too."""

    @property
    def odometry(self):
        relative = np.full(21, 7.0, dtype="<f4").tobytes()
        numbers = np.frombuffer(NUMBERS, dtype="<f4").copy()
        numbers[[13, 45]] = 13.0, 45.0
        return Odometry(self.t_ns, numbers.tobytes(), 0, 100, relative, self.origin)


def publisher(rate=50.0):
    config = Config(output=OutputConfig(odometry=OdometryConfig(rate=rate)))
    return Publisher(config, Family.PX4)


def names(messages):
    return [message.name for message in messages]


def test_an_estimate_becomes_messages_of_which_odometry_alone_is_replaceable():
    messages = publisher().due(Given(t_ns=SECOND_NS))
    assert names(messages) == ["GPS_GLOBAL_ORIGIN", "ODOMETRY", "ESTIMATOR_STATUS"]
    assert [message.is_replaceable for message in messages] == [False, True, False]


def test_each_message_comes_at_its_rate_and_odometry_once_for_one_estimate():
    ours, found = publisher(rate=50.0), Counter()
    for k in range(1000):
        estimate = Given(t_ns=k * 4_000_000)
        found.update(names(ours.due(estimate)))
        assert "ODOMETRY" not in names(ours.due(estimate))
    # the first origin is out of turn
    assert found == {"GPS_GLOBAL_ORIGIN": 4, "ODOMETRY": 200, "ESTIMATOR_STATUS": 4}


def test_without_a_position_nothing_is_published_and_nothing_can_be_requested():
    ours, nowhere = publisher(), Given(t_ns=0, quality=None, origin=None)
    assert ours.due(nowhere) == []
    assert not any(ours.request(name, nowhere) for name in STREAMS)


@pytest.mark.parametrize("is_monitor", [False, True])
def test_an_invalid_estimate_is_published_once_until_it_is_valid_again(is_monitor):
    config = Config(output=OutputConfig(odometry=OdometryConfig(rate=10.0)))
    ours = Publisher(config, Family.PX4, is_monitor=is_monitor)
    qualities = [100, -1, -1, -1, 50, -1, -1]
    published = [
        "ODOMETRY" in names(ours.due(Given(t_ns=k * SECOND_NS // 10, quality=quality)))
        for k, quality in enumerate(qualities)
    ]
    assert published == [True, True, False, False, True, True, False]
    assert not ours.request("ODOMETRY", Given(t_ns=SECOND_NS, quality=-1))


@pytest.mark.parametrize("status", [Status.INIT, Status.ALIGNING, Status.ATTITUDE])
def test_without_a_position_of_now_no_flag_claims_one(status):
    """After a long outage the filter keeps an attitude only, while the origin is still known."""
    health = replace(Pipeline(FilterSettings()).health(), status=status)
    *_, message = publisher().due(Given(t_ns=SECOND_NS, quality=None, health=health))
    layout = by_name("ESTIMATOR_STATUS")
    (flags,) = np.frombuffer(message.payload.ljust(layout.size, b"\0"), layout.dtype)["flags"]
    assert message.name == "ESTIMATOR_STATUS"
    assert flags == (StatusFlag.ATTITUDE if status == Status.ATTITUDE else 0)


def test_an_origin_that_moves_is_published_before_the_odometry_about_it():
    ours = publisher()
    ours.due(Given(t_ns=0))
    moved = ours.due(Given(t_ns=20_000_000, origin=(0.1, 0.2, 301.0)))
    assert names(moved) == ["GPS_GLOBAL_ORIGIN", "ODOMETRY"]


def test_an_origin_that_is_lost_is_not_published_and_keeps_its_turn():
    """Samples come once in 0.6 s, so that each ODOMETRY is due and only some origins are."""
    ours, period_ns = publisher(), SECOND_NS * 3 // 5
    origins = [ORIGIN, ORIGIN, ORIGIN, None, ORIGIN, ORIGIN, ORIGIN]
    published = [
        "GPS_GLOBAL_ORIGIN" in names(ours.due(Given(t_ns=k * period_ns, origin=origin)))
        for k, origin in enumerate(origins)
    ]
    # the first, and the first after the loss, are out of turn
    assert published == [True, True, False, False, True, True, True]


def test_a_message_that_is_off_comes_once_when_requested():
    ours = publisher()
    ours.set_rate("ODOMETRY", 0.0)
    first = Given(t_ns=0)
    assert "ODOMETRY" not in names(ours.due(first))
    assert ours.request("ODOMETRY", first)
    found = [names(ours.due(Given(t_ns=k * 4_000_000))) for k in (1, 2)]
    assert found == [["GPS_GLOBAL_ORIGIN", "ODOMETRY"], []]


def test_what_is_due_keeps_its_rate_over_uneven_stamps():
    due = Due(10.0)
    stamps = [k * 7_000_000 for k in range(1000)]
    kept = [t for t in stamps if due.is_due(t)]
    assert abs(len(kept) - 70) <= 1
    assert all(93_000_000 <= b - a <= 107_000_000 for a, b in itertools.pairwise(kept))


@pytest.mark.parametrize("leap_ns", [-3600 * SECOND_NS, 3600 * SECOND_NS])
def test_what_is_due_follows_a_clock_that_begins_anew(leap_ns):
    due = Due(10.0)
    assert due.is_due(5_000_000_000)
    assert not due.is_due(5_050_000_000)
    assert due.is_due(5_050_000_000 + leap_ns)
    assert not due.is_due(5_100_000_000 + leap_ns)


@pytest.mark.parametrize(
    ("states", "family", "is_monitor", "is_relative"),
    [
        ("auto", Family.PX4, False, True),
        ("auto", Family.ARDUPILOT, False, True),
        ("auto", Family.UNKNOWN, False, False),
        ("auto", Family.PX4, True, False),
        ("whole", Family.PX4, False, False),
        ("relative", Family.UNKNOWN, False, True),
    ],
)
def test_who_fuses_a_message_is_told_the_covariance_without_the_slow_error(
    states, family, is_monitor, is_relative
):
    config = Config(output=OutputConfig(odometry=OdometryConfig(rate=30.0, covariance=states)))
    ours = encode.label(Family.UNKNOWN, "LOCAL_NED", "auto") if is_monitor else None
    sent = Publisher(config, family, ours, is_monitor=is_monitor).due(WithRelative(t_ns=SECOND_NS))
    (payload,) = (one.payload for one in sent if one.name == "ODOMETRY")
    first = np.frombuffer(payload[8:228], dtype="<f4")[13]
    assert first == (7.0 if is_relative else 13.0)


@pytest.mark.parametrize(
    ("rate", "time", "factor"), [(30.0, 0.5, 30.0), (10.0, 0.5, 10.0), (30.0, 0.01, 1.0)]
)
def test_an_error_of_the_climb_is_stated_as_large_as_it_is_often_repeated(rate, time, factor):
    config = Config(output=OutputConfig(odometry=OdometryConfig(rate=rate, climb_time=time)))
    assert stated(Publisher(config, Family.PX4)) == (7.0, factor * 45.0)


@pytest.mark.parametrize(("family", "states"), [(Family.UNKNOWN, "auto"), (Family.PX4, "whole")])
def test_where_nobody_takes_it_for_noise_it_is_stated_as_it_is(family, states):
    config = Config(output=OutputConfig(odometry=OdometryConfig(covariance=states)))
    assert stated(Publisher(config, family)) == (13.0, 45.0)


def stated(publisher):
    """Return the variances north and of the velocity down; the estimate's are 13 (7) and 45."""
    sent = publisher.due(WithRelative(t_ns=SECOND_NS))
    (payload,) = (one.payload for one in sent if one.name == "ODOMETRY")
    numbers = np.frombuffer(payload[8:228], dtype="<f4")
    return numbers[13], numbers[45]
