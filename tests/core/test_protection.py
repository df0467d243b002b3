"""The protection level: the tails of all fault hypotheses together, and what flights exceed."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_POS, Shows, Source
from ekf_companion.core.memory.overlay import as_banks, as_parameters, as_state
from ekf_companion.core.memory.packing import unpack
from ekf_companion.core.memory.scratch import OUT
from ekf_companion.core.order.timeline import Timeline
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.core.settings.from_settings import delays_ns, parameters
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings, IntegritySettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status
from tests.core.flights import between, changed, flight
from tests.core.interpreted import load
from tests.engine.estimation import errors

RISK = 1e-2
SETTINGS = FilterSettings(
    weigh_faults="act", gnss=GnssSettings(delay=0.12), integrity=IntegritySettings(risk=RISK)
)
BEGIN = 30.0
"""s."""


def faulty(name: str, events: Events) -> Events:
    """Return a flight in which something begins to be wrong."""
    late = between(events, BEGIN, 99.0)
    if name == "position":
        return changed(events, late & (events.kind == Kind.GNSS), 0, 3.0 / 6.371e6)
    if name == "height":
        return changed(events, late & (events.kind == Kind.GNSS), 2, 4.0)
    if name == "both":
        events = changed(events, late & (events.kind == Kind.GNSS), 0, 4.0 / 6.371e6)
        return changed(events, late & (events.kind == Kind.BARO), 0, 3.0)
    return events


def sampled(pipeline: Pipeline, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of what is shown, drawn from the mixture: horizontal and vertical, m.

    Of one fault that shows in all rows, or else of one of the level or none, and of one of the
    vertical or none, each by its own probability.
    """
    rng = np.random.default_rng(seed)
    state = pipeline.state()
    x, memory = as_state(state.block), unpack(state.bank)[None]
    bank = as_banks(memory)[0]
    shows, p, means, roots = [], [], [], []
    for i in range(bank.n):
        h = bank.instance[i]
        prior = FAULTS[h.kind]
        if prior.source == Source.NOISE or h.p == 0.0:
            continue
        U = np.zeros((3, prior.rows))
        for c in range(prior.rows):
            ahead = np.zeros(9)
            load().columns.look_ahead(bank, i, c, ahead)
            U[:, c] = ahead[E_POS : E_POS + 3]
        rows = slice(prior.rows)
        shows.append(prior.shows)
        p.append(h.p)
        means.append(U @ np.array(h.b)[rows])
        M = np.array(h.M)[rows, rows]
        values, vectors = np.linalg.eigh(M)
        roots.append(
            np.pad(U @ vectors * np.sqrt(np.maximum(values, 0.0)), ((0, 0), (0, 3 - prior.rows)))
        )
    shows, p = np.array([*shows, -1]), np.array([*p, 0.0])
    means, roots = np.array([*means, np.zeros(3)]), np.array([*roots, np.zeros((3, 3))])

    def drawn(which: Shows, size: int, whole: float) -> np.ndarray:
        odds = np.where(shows == which, p, 0.0) / max(whole, 1e-300)
        odds[-1] = max(1.0 - odds.sum(), 0.0)
        return rng.choice(len(p), size, p=odds / odds.sum())

    everywhere = p[shows == Shows.ALL].sum()
    n = rng.binomial(count, everywhere)
    picks = [
        (drawn(Shows.ALL, n, everywhere), np.full(n, len(p) - 1)),
        (
            drawn(Shows.LEVEL, count - n, 1.0 - everywhere),
            drawn(Shows.VERTICAL, count - n, 1.0 - everywhere),
        ),
    ]
    first, second = (np.concatenate(one) for one in zip(*picks, strict=True))
    P = np.array(x.P)[E_POS : E_POS + 3, E_POS : E_POS + 3]
    error = rng.multivariate_normal(np.zeros(3), P, count)
    for one in (first, second):
        noise = rng.normal(size=(count, 3))
        error += means[one] + np.einsum("nij,nj->ni", roots[one], noise)
    k = as_parameters(parameters(SETTINGS, "unknown"))
    load().repair.mix(x, k, bank)
    error -= np.array(bank.mean)[E_POS : E_POS + 3]
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


@pytest.mark.parametrize("name", ["nothing", "position", "height", "both"])
@pytest.mark.parametrize("after", [-5.0, 0.5, 1.5, 20.0], ids=["before", "begun", "seen", "over"])
def test_it_bounds_what_is_drawn_from_the_mixture(name, after):
    events = faulty(name, flight("figure-eight", BEGIN + 21.0)[0])
    one = Pipeline(SETTINGS)
    one.run(events.take(between(events, 0.0, BEGIN + after)))
    levels, count = one._timeline.protection(), 200_000
    horizontal, vertical = sampled(one, count, seed=1)
    spare = 4.0 * np.sqrt(RISK / count)  # four sigmas of the count itself
    assert np.mean(horizontal > levels[0]) < RISK + spare
    assert np.mean(vertical > levels[1]) < RISK + spare
    # and it is no looser than what it is made of: the vertical one is exact but for the rounding up
    # and for what moves both ways, the horizontal one takes the larger axis and adds distances
    assert np.mean(vertical > 0.97 * levels[1]) > 0.5 * RISK
    assert np.mean(horizontal > 0.8 * levels[0]) > RISK


@pytest.mark.parametrize("scenario", ["figure-eight", "hover", "square-spiral"])
def test_flights_exceed_it_no_more_often_than_it_says(scenario):
    exceeded, count = np.zeros(2), 0
    for seed in (1, 2, 3, 4):
        for name in ("nothing", "position", "height", "both"):
            events, truth = flight(scenario, duration=60.0, seed=seed)
            one = Pipeline(SETTINGS)
            table = one.run(faulty(name, events))
            seen = one.fault_evidence()
            rows = np.searchsorted(table.stamp_ns, seen.t_ns)
            off = errors(table, truth, 0.0)["pos"][rows]
            known = np.isfinite(seen.protection[:, 0])
            assert (known == (table.column("status")[rows] >= Status.OK)).all()
            far = np.stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])], axis=1)
            exceeded += np.sum(far[known] > seen.protection[known], axis=0)
            count += int(np.count_nonzero(known))
    assert count > 800
    assert (exceeded <= RISK * count).all()


@pytest.mark.parametrize("mode", ["off", "report"])
def test_none_is_published_where_the_hypotheses_do_not_decide(mode):
    events, _ = flight("hover", 12.0)
    one = Pipeline(replace(SETTINGS, weigh_faults=mode))
    one.run(events)
    health = one.health()
    assert health.status == Status.OK
    assert np.isnan([health.protection_horizontal, health.protection_vertical]).all()


def test_a_smaller_risk_is_a_larger_distance():
    events, _ = flight("figure-eight", 20.0)
    levels = []
    for risk in (0.1, 1e-2, 1e-3, 1e-5):
        one = Pipeline(replace(SETTINGS, integrity=IntegritySettings(risk=risk)))
        one.run(events)
        levels.append(one._timeline.protection())
    assert (np.diff(np.array(levels), axis=0) > 0.0).all()


def test_interpreted_and_compiled_agree_to_the_last_bit():
    events, _ = flight("figure-eight", 8.0, rate=50.0)
    levels = []
    for kind in (Timeline, load().timeline.Timeline):
        numbers, late = parameters(SETTINGS, "unknown"), delays_ns(SETTINGS, "unknown")
        timeline = kind(numbers, late, 2_000_000_000)
        samples = int(np.count_nonzero(events.kind == Kind.IMU))
        out, stamps = np.zeros((samples, OUT)), np.zeros(samples, dtype=np.int64)
        timeline.run_log(events.t_ns, events.kind, events.values, stamps, out)
        levels.append((timeline.protection(), timeline.evidence().tobytes()))
    assert levels[0] == levels[1]
    assert 0.1 < levels[0][0][1] < 50.0
