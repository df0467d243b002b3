import numpy as np
import pytest

from ekf_companion.analysis import attitude
from ekf_companion.errors import LogError
from ekf_companion.filters import mahony
from ekf_companion.filters.mahony import MahonySettings
from ekf_companion.logs.recording import Counted
from ekf_companion.nav.measurements import Kind
from tests.filters.swings import Swing, swing
from tests.filters.trials import TRIALS, trial

CALM = Swing(seconds=60.0, turn=0.5, push=0.05, accel_bias=(0.0, 0.0, 0.0), start=(0.3, -0.2, 2.0))


def test_a_calm_motion_is_followed_and_the_bias_found():
    events, truth = swing(CALM)
    solution = mahony.run(events)
    errors = attitude.errors(solution.table, truth)
    assert np.degrees(errors.total[errors.t_ns > 20e9]).max() < 2.0
    bias = [solution.table.column(f"gyro_bias_{axis}")[3000:].mean() for axis in "xyz"]
    np.testing.assert_allclose(bias, CALM.gyro_bias, atol=0.004)


def test_without_its_integral_a_bias_leans_the_attitude():
    events, truth = swing(Swing(seconds=30.0, turn=0.0, gyro_bias=(0.1, 0.0, 0.0)))
    leaning = mahony.run(events, MahonySettings(integral=0.0))
    upright = mahony.run(events)
    late = Counted(t_ns=truth.att_t_ns, is_counted=truth.att_t_ns > 20e9)
    # the bias over the gain, less what the field adds to it
    assert 0.04 < attitude.score(leaning.table, truth, late).inclination < 0.11
    assert attitude.score(upright.table, truth, late).inclination < 0.02


def test_without_a_magnetometer_gravity_alone_is_followed():
    events, truth = swing(CALM)
    solution = mahony.run(events.take(events.kind == Kind.IMU))
    errors = attitude.errors(solution.table, truth)
    assert np.degrees(errors.inclination[errors.t_ns > 20e9]).max() < 2.0


def test_a_log_without_inertial_samples_is_refused():
    events, _ = swing(Swing(seconds=2.0))
    with pytest.raises(LogError, match="no inertial samples"):
        mahony.run(events.take(events.kind == Kind.MAG))


def test_slow_rotation_in_the_hand_is_followed():
    recording = trial(TRIALS[0])
    solution = mahony.run(recording.events)
    score = attitude.score(solution.table, recording.truth, recording.counted)
    assert np.degrees(score.total) == pytest.approx(2.17, abs=0.3)
