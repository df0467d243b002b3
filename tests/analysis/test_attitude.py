import numpy as np
import pytest

from ekf_companion.analysis import attitude
from ekf_companion.filters import vqf_adapter
from ekf_companion.filters.marg import MargSamples
from ekf_companion.filters.solution import AttitudeEstimates, attitude_solution
from ekf_companion.logs.recording import Counted
from ekf_companion.nav import so3
from ekf_companion.nav.state import Trajectory
from tests.filters.trials import TRIALS, trial

STEP_NS = 10_000_000


def table(q_nb, t_ns):
    nothing = np.zeros((len(t_ns), 3))
    samples = MargSamples(
        t_ns=t_ns,
        gyro_b=nothing,
        accel_b=nothing,
        mag_b=nothing * np.nan,
        declination=0.0,
        notes=(),
    )
    return attitude_solution("made", samples, AttitudeEstimates(q_nb=q_nb)).table


def truth(q_nb, t_ns):
    return Trajectory(name="made", att_t_ns=t_ns, q_nb=q_nb)


def turning(t_ns):
    t = t_ns * 1e-9
    return so3.from_euler(0.5 * np.sin(t), 0.4 * np.cos(t), 3.0 * t)


T_NS = np.arange(200, dtype=np.int64) * STEP_NS


def test_turns_about_the_vertical_and_across_it_are_told_apart():
    q = turning(T_NS)
    level = attitude.score(table(so3.multiply(so3.exp([0, 0, 0.3]), q), T_NS), truth(q, T_NS))
    assert level.total == pytest.approx(0.3)
    assert level.heading == pytest.approx(0.3)
    assert level.inclination == pytest.approx(0.0, abs=1e-7)
    tilted = attitude.score(table(so3.multiply(so3.exp([0.12, 0.16, 0]), q), T_NS), truth(q, T_NS))
    assert tilted.total == pytest.approx(0.2)
    assert tilted.heading == pytest.approx(0.0, abs=1e-7)
    assert tilted.inclination == pytest.approx(0.2)
    both = attitude.score(
        table(so3.multiply(so3.exp([0, 0, 3.0]), so3.multiply(so3.exp([0.2, 0, 0]), q)), T_NS),
        truth(q, T_NS),
    )
    assert both.heading == pytest.approx(3.0)
    assert both.inclination == pytest.approx(0.2)


def test_only_what_counts_counts():
    q = turning(T_NS)
    wrong = q.copy()
    wrong[100:] = so3.multiply(so3.exp([0, 0, 1.0]), q[100:])
    counted = Counted(t_ns=T_NS, is_counted=np.arange(200) < 100)
    found = attitude.score(table(wrong, T_NS), truth(q, T_NS), counted)
    assert found.total == pytest.approx(0.0, abs=1e-7)
    assert found.samples == 100


def test_nothing_is_compared_where_the_truth_is_hidden():
    q = turning(T_NS)
    seen = np.ones(200, dtype=bool)
    seen[50:150] = False
    wrong = q.copy()
    wrong[50:150] = so3.multiply(so3.exp([0, 0, 1.0]), q[50:150])
    hidden = q.copy()
    hidden[~seen] = np.nan
    for each in (truth(q[seen], T_NS[seen]), truth(hidden, T_NS)):
        found = attitude.score(table(wrong, T_NS), each)
        assert found.samples == 100
        assert found.total == pytest.approx(0.0, abs=1e-7)


def test_estimates_at_other_times_are_turned_between_but_not_across_a_gap():
    q = turning(T_NS)
    between = T_NS[:-1] + STEP_NS // 2
    found = attitude.score(table(q, T_NS), truth(turning(between), between))
    assert found.total < 1e-4  # rad; the rate changes within a step
    assert found.samples == 199
    few = np.concatenate([T_NS[:50], T_NS[100:]])
    lost = attitude.score(table(turning(few), few), truth(q, T_NS))
    # The last before the gap is at its edge
    assert lost.samples == 149


def test_no_estimate_gives_no_score():
    q = turning(T_NS)
    found = attitude.score(table(q, T_NS + 10**12), truth(q, T_NS))
    assert found.samples == 0
    assert np.isnan(found.total)


@pytest.mark.parametrize(
    ("name", "published"),
    [(TRIALS[0], (1.99, 1.89, 0.60)), (TRIALS[1], (2.31, 2.26, 0.47))],
)
def test_vqf_scores_as_it_does_elsewhere(name, published):
    pytest.importorskip("vqf", reason="the package vqf is not installed")
    recording = trial(name)
    found = attitude.score(
        vqf_adapter.run(recording.events).table, recording.truth, recording.counted
    )
    degrees = np.degrees([found.total, found.heading, found.inclination])
    np.testing.assert_allclose(degrees, published, atol=0.006)
