from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_ATT, E_VEL, Mode
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings, ImuSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import LogError
from ekf_companion.filters import euler_article
from ekf_companion.filters.observation import Position
from ekf_companion.filters.sequence import MeasurementSequence
from ekf_companion.filters.strapdown import ATT, BA, BG, VEL
from ekf_companion.nav import so3
from ekf_companion.nav.earth import STANDARD_GRAVITY, earth_rate_n
from ekf_companion.nav.measurements import Events, Kind, VehicleState, merge

SECOND = 1_000_000_000
TRUE = so3.from_euler(0.15, -0.1, 2.5)
FIELD_N = np.array([0.215, 0.013, 0.433])
DECLINATION, DIP = float(np.arctan2(0.013, 0.215)), float(np.arctan2(0.433, np.hypot(0.215, 0.013)))
GYRO_BIAS = np.array([0.004, -0.003, 0.002])
LAT, LON, ALT = 0.83, 0.2, 300.0
LEVER = np.array([0.3, 0.0, -0.2])
SETTINGS = FilterSettings(
    imu=ImuSettings(accel_bias=0.05, gyro_bias=0.01),
    gnss=GnssSettings(delay=0.0, lever_arm=(0.3, 0.0, -0.2)),
)


def recording(
    rng,
    *,
    seconds=6.0,
    turn=0.0,
    shake=0.02,
    bias=(0.0, 0.0, 0.0),
    speed=0.0,
    has_mag=True,
    headings=(),
    fixes=None,
):
    """Stand, or turn about down at a steady rate (rad/s), or go north at a steady speed (m/s)."""
    t = np.arange(0.0, seconds, 0.01)
    q_nb = so3.multiply(so3.exp(np.outer(turn * t, [0.0, 0.0, 1.0])), TRUE)
    C_bn = np.swapaxes(so3.to_matrix(q_nb), 1, 2)
    rate_n = earth_rate_n(LAT) + np.array([0.0, 0.0, turn])
    gyro = C_bn @ rate_n + GYRO_BIAS + rng.normal(0.0, 0.002, (len(t), 3))
    accel = C_bn @ [0.0, 0.0, -STANDARD_GRAVITY] + bias + rng.normal(0.0, shake, (len(t), 3))
    t_ns = np.rint(t * 1e9).astype(np.int64) + SECOND
    parts = [Events.from_columns(t_ns, Kind.IMU, *gyro.T, *accel.T)]
    if has_mag:
        field = (C_bn @ FIELD_N)[::4] + rng.normal(0.0, 0.003, (len(t[::4]), 3))
        parts.append(Events.from_columns(t_ns[::4] + 1, Kind.MAG, *field.T))
    if len(headings):
        one = np.ones(len(headings))
        at = np.array(headings, dtype=np.int64) + SECOND
        parts.append(Events.from_columns(at, Kind.HEADING, 2.5 * one, 0.02 * one, 0.0 * one))
    at = np.arange(0.0, seconds, 0.2) + 0.003 if fixes is None else np.array(fixes)
    antenna = so3.rotate(TRUE, LEVER) + np.outer(speed * at, [1.0, 0.0, 0.0])
    lat, lon = LAT + antenna[:, 0] / 6.37e6, LON + antenna[:, 1] / (6.39e6 * np.cos(LAT))
    rest = np.broadcast_to(
        [speed, 0.0, 0.0, 1.0, 2.0, 0.1, DECLINATION, 0.0, DIP, 0.483], (len(at), 10)
    )
    parts.append(
        Events.from_columns(
            np.rint(at * 1e9).astype(np.int64) + SECOND,
            Kind.GNSS,
            lat,
            lon,
            ALT - antenna[:, 2],
            *rest.T,
        )
    )
    return merge(*parts)


def started(events, settings=SETTINGS):
    return MeasurementSequence(events, settings).setup().start


def error_n(start, turn=0.0):
    now = so3.multiply(so3.exp(np.array([0.0, 0.0, turn * (start.t_ns - SECOND) * 1e-9])), TRUE)
    return so3.log(so3.multiply(now, so3.conjugate(start.state.q_nb)))


def standing(events):
    reported = VehicleState(t_ns=int(events.t_ns[0]) + 50_000_000, is_armed=False, is_landed=True)
    return merge(Events.from_rows([reported.row()]), events)


def test_at_rest_it_finds_level_north_and_the_bias_of_the_gyro():
    start = started(standing(recording(np.random.default_rng(1))))
    assert 2.0 < start.t_ns / SECOND < 3.0
    assert np.abs(error_n(start)[:2]).max() < 2e-3
    assert abs(error_n(start)[2]) < 0.02
    # 4 sigma of 100 samples, and the rotation of the Earth, which no fix has shown by then
    np.testing.assert_allclose(start.state.gyro_bias, GYRO_BIAS, atol=9e-4)
    assert (np.sqrt(np.diag(start.P)[BG]) < 0.002).all()
    antenna = start.state.pos_n + so3.to_matrix(TRUE) @ LEVER
    assert np.abs(antenna - so3.to_matrix(TRUE) @ LEVER).max() < 0.5
    assert np.linalg.eigvalsh(start.P).min() > 0.0


@pytest.mark.parametrize("has_mag", [True, False])
@pytest.mark.parametrize("turn", [0.02, 0.05, 0.09])
def test_a_slow_steady_turn_is_no_bias(turn, has_mag):
    """As quiet as a rest; with a heading from elsewhere where there is no magnetometer."""
    headings = () if has_mag else np.arange(0, 6_000_000_000, 200_000_000)
    events = recording(np.random.default_rng(8), turn=turn, has_mag=has_mag, headings=headings)
    start = started(events)
    off = GYRO_BIAS - start.state.gyro_bias
    assert off @ np.linalg.solve(start.P[BG, BG], off) < 25.0  # 3 dof: five sigmas


def test_its_errors_are_as_large_and_tied_together_as_it_says():
    rng = np.random.default_rng(2)
    squares = []
    for _ in range(40):
        bias = rng.normal(0.0, 0.05, 3)
        start = started(recording(rng, seconds=3.0, bias=bias))
        C_nb = so3.to_matrix(start.state.q_nb)
        gap = np.concatenate([C_nb.T @ error_n(start), bias - start.state.accel_bias])
        both = np.r_[ATT, BA]
        squares.append(gap @ np.linalg.solve(start.P[np.ix_(both, both)], gap) / 6.0)
    # The field of this place has no slow error: so below 1
    assert 0.3 < np.mean(squares) < 1.2


def test_a_level_is_as_wrong_as_the_bias_makes_it():
    bias = so3.to_matrix(TRUE).T @ [0.3, 0.0, 0.0]
    start = started(recording(np.random.default_rng(3), bias=bias))
    assert error_n(start)[1] == pytest.approx(-0.3 / STANDARD_GRAVITY, rel=0.05)
    # Told the bias, the covariance turns the level back
    back = start.P[ATT, BA] @ np.linalg.solve(start.P[BA, BA], bias)
    left = so3.to_matrix(start.state.q_nb).T @ error_n(start) - back
    assert np.linalg.norm(left[:2]) < 0.1 * np.linalg.norm(error_n(start))


def test_in_motion_nothing_is_taken_for_rest():
    start = started(recording(np.random.default_rng(4), speed=5.0))
    assert np.abs(start.state.gyro_bias).max() < 1e-6
    assert start.state.vel_n[0] == pytest.approx(5.0, abs=0.3)
    assert np.sqrt(np.trace(start.P[ATT, ATT])) > 0.03
    assert np.sqrt(start.P[BG, BG].max()) == pytest.approx(0.01, rel=1e-5)


def test_a_fix_that_is_too_old_is_not_started_from():
    """Going north at 20 m/s: its only heading comes 25 s after the first fix."""
    late = np.arange(28.0, 33.0, 0.2)
    events = recording(
        np.random.default_rng(10),
        seconds=34.0,
        speed=20.0,
        has_mag=False,
        headings=np.arange(25_000_000_000, 34_000_000_000, 100_000_000),
        fixes=[0.5, *late],
    )
    start = started(events)
    true = 20.0 * (start.t_ns - SECOND) * 1e-9 - 10.0
    assert start.t_ns / SECOND > 28.0
    assert start.state.pos_n[0] == pytest.approx(true, abs=3.0)


def test_the_article_too_starts_at_a_fix_with_a_recent_heading():
    """Going north at 20 m/s: a fix at first, headings only 25 s later."""
    events = recording(
        np.random.default_rng(10),
        seconds=30.0,
        speed=20.0,
        has_mag=False,
        headings=np.arange(25_000_000_000, 30_000_000_000, 100_000_000),
        fixes=[0.5, *np.arange(27.0, 29.0, 0.2)],
    )
    table = euler_article.run(MeasurementSequence(events, SETTINGS)).table
    assert table.stamp_ns[0] / SECOND >= 28.0
    assert table.column("pos_n")[0] == pytest.approx(20.0 * 26.5, abs=2.0)


def test_the_start_is_that_of_the_main_estimator():
    events = recording(np.random.default_rng(12))
    start = started(events)
    pipeline = Pipeline(SETTINGS)
    for row in zip(events.t_ns.tolist(), events.kind.tolist(), events.values, strict=True):
        pipeline.process_row((row[0], row[1], tuple(row[2].tolist())))
        x = as_state(pipeline.state().block)
        if x.mode == Mode.NAVIGATE:
            break
    assert pipeline.stamp_ns == start.t_ns
    assert np.array(x.q_nb).tolist() == pytest.approx(start.state.q_nb.tolist(), abs=1e-12)
    P = np.array(x.P)
    C_nb = so3.to_matrix(start.state.q_nb)
    np.testing.assert_allclose(C_nb @ start.P[ATT, ATT] @ C_nb.T, P[:3, :3], atol=1e-15)
    assert E_ATT == 0
    np.testing.assert_allclose(start.P[VEL, VEL], P[E_VEL : E_VEL + 3, E_VEL : E_VEL + 3])


def test_the_sigma_of_the_first_position_is_what_the_receiver_states():
    rng = np.random.default_rng(5)
    start = started(recording(rng))
    first = next(
        aid
        for _, aid in MeasurementSequence(recording(rng), SETTINGS).aids
        if isinstance(aid, Position)
    )
    np.testing.assert_allclose(np.sqrt(np.diag(start.P)[6:9]), first.std, rtol=0.05)


def test_a_recording_that_ends_too_early_is_refused():
    rng = np.random.default_rng(6)
    with pytest.raises(LogError, match="ends before"):
        started(recording(rng, seconds=0.5))
    with pytest.raises(LogError, match="no heading"):
        started(recording(rng, has_mag=False))


def test_a_start_at_the_last_sample_leaves_nothing_to_estimate():
    events = recording(np.random.default_rng(11))
    t_ns = started(events).t_ns
    imu = np.unique(events.t_ns[events.kind == Kind.IMU])
    after = int(imu[np.searchsorted(imu, t_ns) + 1])
    assert started(events.take(events.t_ns <= after)).t_ns == t_ns
    with pytest.raises(LogError, match="ends before"):
        started(events.take(events.t_ns <= t_ns))


def test_another_receiver_delay_is_taken_off_first():
    events = recording(np.random.default_rng(12))
    late = replace(events, t_ns=events.t_ns + 100_000_000 * (events.kind == Kind.GNSS))
    settings = replace(SETTINGS, gnss=replace(SETTINGS.gnss, delay=0.1))
    assert started(late, settings).t_ns == started(events).t_ns
