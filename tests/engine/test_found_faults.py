"""What the fault hypotheses found is said: in words, in numbers, over time."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Fault, Source
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.engine.faults import (
    ENDS,
    OF_NO_SIZE,
    SIZES,
    SOURCES,
    WORDS,
    FoundFault,
    by_source,
    suspicions,
)
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Kind
from tests.core.flights import between, changed, flight

SETTINGS = FilterSettings(weigh_faults="report", gnss=GnssSettings(delay=0.12))
BEGIN = 25.0
"""s."""


def probabilities(**named: float) -> np.ndarray:
    found = np.zeros(len(Source))
    for name, p in named.items():
        found[Source[name.upper()]] = p
    return found


@pytest.fixture(scope="module")
def jumped():
    """Return a pipeline whose barometer jumped, and its events."""
    events, _ = flight("figure-eight", 40.0)
    rows = between(events, BEGIN, 99.0) & (events.kind == Kind.BARO)
    events = changed(events, rows, 0, 8.0)
    one = Pipeline(SETTINGS)
    one.run(events)
    return one, events


def test_every_source_has_its_words():
    assert set(SOURCES) == set(Source) - {Source.NOISE}


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({}, ()),
        ({"baro": 0.3, "height": 0.1}, ()),
        ({"baro": 0.93}, ("height: barometer (0.93)",)),
        ({"height": 0.5, "baro": 0.44}, ("height: GNSS height or barometer (0.94)",)),
        ({"height": 0.9, "baro": 0.05}, ("height: GNSS height (0.95)",)),
        (
            {"position": 0.6, "baro": 0.7},
            ("position: GNSS position (0.60)", "height: barometer (0.70)"),
        ),
        (
            {"accel": 0.2, "gyro": 0.2, "state": 0.21, "delay": 0.19},
            ("motion: our own state or accelerometer or gyro (0.80)",),
        ),
    ],
)
def test_what_is_more_likely_wrong_than_right_is_suspected(named, words):
    assert suspicions(probabilities(**named)) == words


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({"baro": 0.93}, "height: barometer (0.93), barometer not used"),
        ({"height": 0.45, "baro": 0.44}, "height: GNSS height or barometer (0.89)"),
        ({"accel": 0.93}, "motion: accelerometer (0.93)"),
        ({"drag": 0.6}, "position: GNSS position with its velocity (0.60)"),
    ],
)
def test_what_is_not_used_meanwhile_is_said_where_the_hypotheses_decide(named, words):
    assert suspicions(probabilities(**named), decides=True) == (words,)


def test_a_source_that_is_hardly_wrong_is_left_out():
    assert by_source(probabilities(baro=0.25, height=0.0005)) == {"baro": 0.25}


@pytest.mark.parametrize("kind", OF_NO_SIZE)
def test_what_is_erratic_has_no_size(kind):
    one = FoundFault(kind, 10**10, 2 * 10**10, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 12.0)
    words, sigma = one.size_words
    assert words.endswith((" erratic", " lost"))
    assert sigma == ""
    assert one.words(5 * 10**9) == f"{words}, 5 to 15 s"
    found = one.to_dict(0)
    assert (found["size"], found["std"]) == ([], [])


@pytest.mark.parametrize("kind", [kind for kind in WORDS if kind not in OF_NO_SIZE])
def test_each_fault_says_its_size_and_a_sigma_in_the_same_unit(kind):
    rows = SIZES.get(kind, FAULTS[kind].rows)
    size = [0.3, 0.4, 1.2][:rows] + [0.0] * (3 - rows)
    std = [0.05] * rows + [0.0] * (3 - rows)
    one = FoundFault(kind, 10**10, 2 * 10**10, tuple(size), tuple(std), 12.0)
    words, sigma = one.size_words
    scale = WORDS[kind][1]
    shown = float(next(part for part in words.split() if part[0].isdigit()))
    assert shown == pytest.approx(scale * np.linalg.norm(size), abs=0.51)
    assert float(sigma) == pytest.approx(scale * 0.05, abs=0.51)
    assert one.words(5 * 10**9) == f"{words}, 5 to 15 s"
    assert one.words_ago(3 * 10**10) == f"{words}, 20 to 10 s ago"
    when = "20 to 10 s ago" if kind in ENDS else "since 20 s, repaired 10 s ago"
    assert one.words_ago(3 * 10**10, repaired=True) == f"{words}, {when}"
    found = one.to_dict(0)
    assert (found["from_s"], found["to_s"], len(found["size"])) == (10.0, 20.0, rows)


def test_a_fault_is_found_with_size_sigma_and_evidence(jumped):
    one, events = jumped
    (fault,) = one.found_faults()
    assert (fault.kind, fault.source) == (Fault.BARO_STEP, Source.BARO)
    assert fault.size[0] == pytest.approx(8.0, abs=3.0 * fault.std[0])
    assert 0.01 < fault.std[0] < 1.0
    assert fault.evidence > 10.0
    health = one.health()
    assert health.found == (fault.words_ago(int(events.t_ns.max())),)
    assert health.found_counts == {"baro": 1}
    assert health.suspected == ("height: barometer (1.00)",)
    assert health.faults["baro"] > 0.99


def test_its_probability_is_kept_once_a_second(jumped):
    one, events = jumped
    seen = one.fault_evidence()
    t = (seen.t_ns - events.t_ns[0]) * 1e-9
    assert len(t) == 40
    assert np.diff(t) == pytest.approx(1.0, abs=0.02)
    baro = seen.probability[:, Source.BARO]
    assert (baro[t < BEGIN] < 0.1).all()
    assert (baro[t > BEGIN + 3.0] > 0.99).all()
    assert seen.probability.shape == (40, len(Source))


def test_of_a_long_flight_it_is_kept_less_often_in_the_same_memory():
    one = Pipeline(SETTINGS)
    for t_ns in range(0, 5000 * 10**9, 10**9):
        one.process_row((t_ns, int(Kind.IMU), (0.0, 0.0, 0.0, 0.0, 0.0, -9.8, *[0.0] * 7)))
    seen = one.fault_evidence()
    assert len(seen.t_ns) == 2048 + (5000 - 4096) // 2
    assert (np.diff(seen.t_ns) == 2 * 10**9).all()


@pytest.mark.parametrize("mode", ["off", "report"])
def test_without_being_asked_nothing_is_said(mode):
    events, _ = flight("hover", 12.0)
    one = Pipeline(replace(SETTINGS, weigh_faults=mode))
    one.run(events)
    health = one.health()
    assert (health.found, health.found_counts) == ((), {})
    assert (len(one.fault_evidence().t_ns) > 0) == (mode == "report")
    assert (health.faults == {}) == (mode == "off")


@pytest.mark.parametrize("gap", [1.0, 4.0])
@pytest.mark.parametrize(
    ("kind", "column", "size"),
    [(Kind.GNSS, 0, 20.0 / 6.371e6), (Kind.GNSS, 2, 15.0), (Kind.GNSS, 3, 1.0)],
    ids=["position", "height", "velocity"],
)
def test_a_reset_to_a_fix_leaves_out_what_is_known_to_be_wrong_with_it(kind, column, size, gap):
    """After a gap of all samples the estimate is found anew by fixes that are still off."""
    events, _ = flight("figure-eight", 60.0)
    events = changed(events, between(events, BEGIN, 99.0) & (events.kind == kind), column, size)
    settings = replace(SETTINGS, weigh_faults="act")
    whole, parted = Pipeline(settings), Pipeline(settings)
    whole.run(events)
    parted.run(events.take(~between(events, 40.0, 40.0 + gap)))
    assert parted.resets == 1
    off = np.abs(parted.values() - whole.values())[3:9]
    assert off[:3].max() < 1.5
    assert off[3:].max() < 0.3


@pytest.mark.parametrize("mode", ["report", "act"])
def test_what_was_found_outlives_a_reboot_and_the_hypotheses_do_not(mode):
    events, _ = flight("figure-eight", 40.0)
    jumped = changed(events, between(events, BEGIN, 99.0) & (events.kind == Kind.BARO), 0, 8.0)
    one = Pipeline(replace(SETTINGS, weigh_faults=mode))
    one.run(jumped)
    (before,) = one.found_faults()
    one.process_row((0, int(Kind.RESTART), (0.0,) * 13))
    assert one._timeline.hypotheses() == []
    later, _ = flight("figure-eight", 50.0, seed=2)
    again, fresh = one.run(later), Pipeline(replace(SETTINGS, weigh_faults=mode)).run(later)
    assert one.found_faults() == [before]
    assert one.health().found == ()
    assert again.values[-1, 3:6] == pytest.approx(fresh.values[-1, 3:6], abs=1.0)
