"""How soon a receiver that has gone bad shows, however long it was good."""

import math

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Aid
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Kind
from ekf_companion.status.observer import SPAN, RecentNis
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight

GOOD, BAD, SILENT = 120.0, 150.0, 180.0
"""Seconds until the receiver goes bad, and until it falls silent, and until the end."""


def fly():
    """Return the pipeline's own mean, and that of the last seconds, by the second of a flight."""
    rng = np.random.default_rng(1)
    config = SimConfig(imu=ImuConfig(rate=50.0))
    log = events(Flight.plan("figure-eight", config, duration=SILENT))
    pipeline, recent, told, next_s = Pipeline(FilterSettings()), RecentNis(), {}, 1
    begin_ns = int(log.t_ns[0])
    for t_ns, kind, row in zip(log.t_ns.tolist(), log.kind.tolist(), log.values, strict=True):
        values, t = row.tolist(), (t_ns - begin_ns) * 1e-9
        if kind == int(Kind.GNSS):
            if t > BAD:
                continue
            if t > GOOD:
                values[3:6] = [v + rng.normal(0.0, 1.5) for v in values[3:6]]
        pipeline.process_row((t_ns, kind, tuple(values)))
        if t > next_s:
            recent.update(pipeline, t_ns)
            told[next_s] = pipeline.health().nis, recent.mean()
            next_s += 1
    return told


@pytest.fixture(scope="module")
def told():
    return fly()


def test_a_receiver_that_goes_bad_shows_within_seconds(told):
    """Rule 40: the consistency that is exported is that of now."""
    life, recent = told[int(GOOD)]
    assert max(life[Aid.VELOCITY], recent[Aid.VELOCITY]) < 2.0
    life, recent = told[int(GOOD) + SPAN // 2]
    assert recent[Aid.VELOCITY] > 2.5 > 1.5 * life[Aid.VELOCITY]


def test_an_aid_that_is_silent_has_none(told):
    assert told[int(BAD) + 5][1][Aid.VELOCITY] > 2.5
    assert math.isnan(told[int(SILENT) - 2][1][Aid.VELOCITY])


def test_at_the_beginning_it_is_that_of_all_and_another_filter_begins_anew(told):
    life, recent = told[SPAN]
    assert recent[Aid.POSITION] == pytest.approx(life[Aid.POSITION])
    window, empty = RecentNis(), Pipeline(FilterSettings())
    assert all(map(math.isnan, window.mean().values()))
    window.update(empty, 0)
    assert all(map(math.isnan, window.mean().values()))
