import numpy as np
import pytest

from ekf_companion.analysis import attitude
from ekf_companion.errors import LogError
from ekf_companion.filters import ahrs_article
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from tests.filters.swings import FIELD_N, Swing, swing
from tests.filters.trials import TRIALS, trial

CALM = Swing(seconds=40.0, turn=0.3, push=0.05, accel_bias=(0.0, 0.0, 0.0))


def southward(yaw):
    events, truth = swing(
        Swing(seconds=20.0, turn=0.2, push=0.0, start=(0.0, 0.0, yaw), gyro_bias=(0.0, 0.0, 0.0))
    )
    return events, truth


@pytest.mark.parametrize("yaw", [0.3, 2.0, np.pi, -2.5])
def test_corrected_it_follows_any_heading(yaw):
    events, truth = southward(yaw)
    errors = attitude.errors(ahrs_article.run(events).table, truth)
    assert np.degrees(np.abs(errors.heading)).max() < 4.0


def test_as_printed_it_takes_south_for_north():
    events, truth = southward(2.8)
    errors = attitude.errors(ahrs_article.run(events, "article").table, truth)
    assert np.degrees(np.abs(errors.heading[-1])) == pytest.approx(180.0, abs=15.0)


def test_as_printed_it_follows_a_northward_heading():
    events, truth = southward(0.3)
    errors = attitude.errors(ahrs_article.run(events, "article").table, truth)
    assert np.degrees(np.abs(errors.heading)).max() < 4.0


def test_hard_iron_and_scale_are_found_in_a_rotation_about_all_axes():
    rng = np.random.default_rng(3)
    q = so3.normalise(rng.standard_normal((4000, 4)))
    clean = so3.rotate(q, FIELD_N)
    found, note = ahrs_article.calibrated(clean * [1.1, 0.9, 1.0] + [0.1, -0.2, 0.05])
    assert note == ""
    strength = np.linalg.norm(found, axis=1)
    assert strength.std() / strength.mean() < 0.01
    np.testing.assert_allclose(
        found / strength[:, None], clean / np.linalg.norm(clean, axis=1)[:, None], atol=0.02
    )


def test_a_rotation_about_one_axis_is_refused_politely():
    turn = so3.from_euler(0.0, 0.0, np.linspace(0.0, 6.3, 500))
    field = so3.rotate(turn, FIELD_N)
    found, note = ahrs_article.calibrated(field)
    np.testing.assert_array_equal(found, field)
    assert "turn the vehicle about all three axes" in note
    events, _ = swing(CALM)
    assert any("not calibrated" in note for note in ahrs_article.run(events).notes)


def test_acceleration_is_taken_for_gravity_which_is_the_methods_own_flaw():
    calm, pushed = (swing(Swing(seconds=40.0, turn=0.3, push=push)) for push in (0.05, 5.0))
    errors = [
        attitude.score(ahrs_article.run(events).table, truth).inclination
        for events, truth in (calm, pushed)
    ]
    assert errors[1] > 4.0 * errors[0]


def test_a_log_without_inertial_samples_is_refused():
    with pytest.raises(LogError, match="no inertial samples"):
        ahrs_article.run(Events.from_columns(np.zeros(1, dtype=np.int64), Kind.MAG, [0.2]))


def test_the_slips_show_in_the_hand():
    recording = trial(TRIALS[0])
    heading = {
        preset: attitude.score(
            ahrs_article.run(recording.events, preset).table, recording.truth, recording.counted
        ).heading
        for preset in ("corrected", "article")
    }
    assert np.degrees(heading["corrected"]) < 5.0
    assert np.degrees(heading["article"]) > 60.0
