"""What a refusal rests on: a ratio is a ratio, and other evidence is named beside it."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Kind, Source
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.engine.publisher import _estimator_status, is_caught
from ekf_companion.mavlink.encode import StatusFlag
from ekf_companion.mavlink.messages import by_name
from ekf_companion.nav.measurements import Events
from ekf_companion.nav.state import COLUMNS, Reason, Status
from tests.core.flights import between, flight
from tests.engine.estimation import KNOWN, run

METRE = 1.0 / 6.367e6
"""Of latitude, rad."""


def dragged(start=40.0, speed=1.0):
    """Return a hover whose receiver leaves it at a walk, its own velocity denying it."""
    events, _ = flight("hover", duration=70.0, noise=(0.1, 1.0))
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    chosen = between(events, start, 99.0) & (events.kind == Kind.GNSS)
    values = events.values.copy()
    values[chosen, 0] += speed * (t[chosen] - start) * METRE
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


def looked(weigh):
    """Return the health after each fix of such a flight."""
    events, found = dragged(), []
    pipeline = Pipeline(replace(KNOWN, weigh_faults=weigh))
    ends = np.flatnonzero(events.kind == Kind.GNSS) + 1
    for first, last in zip([0, *ends[:-1]], ends, strict=True):
        pipeline.run(events.take(np.arange(first, last)))
        found.append(pipeline.health())
    return found


@pytest.fixture(scope="module")
def seen():
    """Return the same by the gates' own rules."""
    return looked("off")


def test_a_receiver_that_is_dragged_is_wrong_by_its_way_where_the_hypotheses_decide():
    found = looked("act")
    quiet = [health for health in found if health.samples < 4000]
    assert not any(health.wrong or health.is_receiver_refused for health in quiet)
    late = [health for health in found if health.samples > 4500]
    layout = by_name("ESTIMATOR_STATUS")
    for health in late:
        message = layout.record._make(layout.unpack(_estimator_status(health, 0)))
        assert message.flags & StatusFlag.GPS_GLITCH
        assert is_caught(health)
        (words,) = [one.words for one in health.wrong if one.source is Source.POSITION]
        way = (health.samples - 4000) * 0.01
        assert words.startswith("GNSS slides, ")
        assert float(words.split()[2]) == pytest.approx(way, rel=0.1, abs=1.0)
    assert len(late) > 100


def test_a_receiver_that_is_dragged_has_a_true_ratio_and_a_verdict_beside_it(seen):
    denied = [health for health in seen if health.denied[Aid.POSITION]]
    assert len(denied) > 10
    within = [health for health in denied if health.ratios[Aid.POSITION] < 1.0]
    assert within, "it is refused before any single fix is outside its gate"
    # 30 m at a sigma of decimetres: of the order of (30 / 0.3)^2, not 1e28
    assert max(health.ratios[Aid.POSITION] for health in seen) < 1e5
    assert seen[-1].verdicts[Aid.POSITION][Verdict.DENIED] >= len(within)
    assert all(health.is_receiver_refused for health in denied)


def test_estimator_status_has_the_true_ratio_and_the_flag_of_a_glitch(seen):
    health = next(h for h in seen if h.denied[Aid.POSITION] and h.ratios[Aid.POSITION] < 1.0)
    layout = by_name("ESTIMATOR_STATUS")
    message = layout.record._make(layout.unpack(_estimator_status(health, 0)))
    assert message.pos_horiz_ratio == pytest.approx(health.ratios[Aid.POSITION] ** 0.5)
    assert message.flags & StatusFlag.GPS_GLITCH


@pytest.mark.parametrize("weigh", ["off", "act"])
def test_the_status_of_each_estimate_is_the_worst_of_its_reasons(weigh):
    table, _ = run(dragged(), replace(KNOWN, weigh_faults=weigh))
    status = table.column("status")
    reasons = table.column("reasons").astype(int)
    assert (reasons[status <= Status.OK] == 0).all()
    assert (reasons[status == Status.DEGRADED] != 0).all()
    assert not (reasons[status == Status.DEGRADED] & (Reason.UNAIDED | Reason.UNCERTAIN)).any()
    is_off = Reason.POSITION_OFF in Reason(int(np.bitwise_or.reduce(reasons)))
    assert is_off == (weigh == "off")
    assert COLUMNS[-1] == "reasons"


def test_a_compass_that_is_refused_is_not_counted_for_two_antennas():
    events, _ = flight("figure-eight", duration=60.0)
    values = events.values.copy()
    bad = between(events, 20.0, 99.0) & (events.kind == Kind.MAG)
    assert bad.any()
    values[bad, 0] += 3.0  # gauss
    _, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    health = pipeline.health()
    compass, antennas = health.headings["compass"], health.headings["antennas"]
    assert compass[Verdict.DISTURBED] == health.verdicts[Aid.HEADING][Verdict.DISTURBED] > 100
    assert sum(antennas.values()) == 0
    for why in Verdict:
        by_sensor = sum(counts[why] for counts in health.headings.values())
        assert by_sensor == health.verdicts[Aid.HEADING][why]


@pytest.mark.parametrize("mode", ["off", "act"])
def test_a_frozen_receiver_is_told_from_a_silent_one(mode):
    events, _ = flight("figure-eight", duration=60.0)
    later = between(events, 30.0, 99.0) & (events.kind == Kind.GNSS)
    values = events.values.copy()
    values[later] = values[np.flatnonzero(later)[0]]
    frozen = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    for flown, words in ((frozen, "GNSS repeats one position"), (events.take(~later), "no GNSS")):
        _, pipeline = run(flown, replace(KNOWN, weigh_faults=mode))
        assert any(words in one for one in pipeline.health().reasons.values())
