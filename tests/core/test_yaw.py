"""The heading: which source counts, and what a refused one resets."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import (
    E_ATT,
    E_BG,
    E_HEADING,
    E_IRON,
    Aid,
    Azimuth,
    HeadingChoice,
    Mode,
    N,
    Reset,
    Verdict,
)
from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import HeadingRow, Observation
from ekf_companion.core.memory.state import Reference, State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import HeadingSource
from tests.core.interpreted import load
from tests.core.states import array, copy
from tests.core.test_slow_error import is_covariance

NOW = 100e9
YAW = 1.0
FIELD_N = np.array([0.2, 0.01, 0.43])


def settings() -> Parameters:
    return as_parameters(parameters(FilterSettings(weigh_faults="off"), "unknown"))


def flown(mode: Mode = Mode.NAVIGATE, azimuth: float = Azimuth.ANTENNA) -> State:
    """Return a state of known yaw, whose heading in use was fused just now."""
    x = State()
    load().restart.forget_sensors(x)
    load().restart.start(x, 0.0)
    x.t, x.mode, x.has_yaw, x.azimuth, x.heading_std = NOW, mode, 1.0, azimuth, 0.02
    x.q_nb[:] = so3.from_euler(0.1, -0.2, YAW)
    x.used_t[Aid.HEADING] = NOW
    array(x.P)[:] = np.diag([1e-4] * 6 + [0.1] * 3 + [1e-6] * 3 + [1e-3] * 3 + [1e-4] * (N - 15))
    return x


def fuse(x: State, error: float, source: HeadingSource = HeadingSource.GNSS, std=0.01) -> None:
    """Fuse a heading that is further to the right than ours by an error."""
    forward = so3.rotate(np.array(x.q_nb), np.array([1.0, 0.0, 0.0]))
    heading = float(so3.wrap(np.arctan2(forward[1], forward[0]) + error))
    row = HeadingRow(heading=heading, std=std, source=float(source))
    load().yaw.fuse_heading(x, settings(), Observation(), Reference(), row)


def yaw(x: State) -> float:
    return float(so3.to_euler(np.array(x.q_nb))[2])


@pytest.mark.parametrize(
    ("choice", "ages", "used"),
    [
        # seconds since each source, and a field, came; which sources are used then
        (HeadingChoice.AUTO, (0, 0, 0, 9), [True, False, False]),
        (HeadingChoice.AUTO, (4.9, 0, 0, 9), [True, False, False]),
        (HeadingChoice.AUTO, (5.1, 0, 0, 9), [True, True, False]),
        (HeadingChoice.AUTO, (9, 9, 0, 9), [True, True, True]),
        (HeadingChoice.AUTO, (9, 9, 0, 4.9), [True, False, False]),
        (HeadingChoice.GNSS, (9, 9, 9, 9), [True, False, False]),
        (HeadingChoice.MAG, (0, 0, 0, 0), [False, True, False]),
        (HeadingChoice.AUTOPILOT, (0, 0, 0, 0), [False, False, True]),
    ],
)
def test_the_best_source_that_is_not_silent_is_used_or_the_configured_one(choice, ages, used):
    k = settings()
    k.heading = choice
    for source in HeadingSource:
        x = flown()
        x.heading_t[:] = [NOW - 1e9 * age for age in ages[:3]]
        x.mag_t = NOW - 1e9 * ages[3]
        assert load().yaw.is_heading_used(x, k, int(source)) == used[source]
        assert x.heading_t[source] == NOW
        if choice == HeadingChoice.AUTO and source == HeadingSource.GNSS:
            x.heading_t[0] = NOW - 1e9 * ages[0]
            assert load().yaw.is_field_used(x, k) == (ages[0] >= 5.0)


def test_while_levelling_a_heading_is_kept_and_moves_nothing():
    x = flown(Mode.LEVEL)
    before = list(x.q_nb)
    fuse(x, 0.5)
    r = x.alignment.reference
    assert (r.is_known, r.t, list(r.direction_b)) == (1.0, NOW, [1.0, 0.0, 0.0])
    assert r.azimuth == pytest.approx(YAW + 0.5)
    assert list(x.q_nb) == before
    assert x.count[Aid.HEADING][Verdict.BEFORE_ALIGNMENT] == 1.0


def test_the_first_heading_sets_yaw_and_a_later_one_corrects_it():
    x = flown()
    x.has_yaw = 0.0
    fuse(x, 2.0, std=0.05)
    assert yaw(x) == pytest.approx(YAW + 2.0)
    assert (x.has_yaw, x.moved.yaw) == (1.0, pytest.approx(2.0))
    # its own error, white and slow; and tilt, as steep as the axis is
    expected = 0.05**2 + 1e-4 + 1e-4 * np.tan(0.2) ** 2
    assert x.P[E_ATT + 2][E_ATT + 2] == pytest.approx(expected, rel=1e-3)

    x = flown()
    tilt = so3.to_euler(np.array(x.q_nb))[:2]
    fuse(x, 0.05, std=0.05)
    share = 1e-4 / (1e-4 + expected)
    assert yaw(x) - YAW == pytest.approx(share * 0.05, rel=1e-3)
    np.testing.assert_allclose(so3.to_euler(np.array(x.q_nb))[:2], tilt, atol=1e-12)
    assert is_covariance(x)


def test_another_source_has_another_slow_error():
    x = flown(azimuth=Azimuth.OTHER)
    x.heading_offset, x.P[E_HEADING][E_HEADING], x.P[E_ATT + 2][E_HEADING] = 0.2, 1e-6, 1e-7
    fuse(x, 0.0, HeadingSource.AUTOPILOT, std=0.1)
    assert x.heading_offset == pytest.approx(0.2, abs=0.02)
    x.azimuth_t = NOW
    fuse(x, 0.0)
    assert (x.azimuth, x.azimuth_t) == (Azimuth.ANTENNA, -1e18)
    assert x.heading_offset == pytest.approx(0.0, abs=1e-9)
    assert x.heading_std == 0.005
    assert x.P[E_HEADING][E_HEADING] <= 0.005**2


def refused(x: State, source: HeadingSource, error: float, std: float) -> None:
    """Refuse a heading for as long as it can be, then look at it once more."""
    x.used_t[Aid.HEADING] = NOW - 1e9 * settings().timeout_heading
    for late in (0.0, 0.2, 0.8, 1.0):
        x.t = NOW + 1e9 * late
        assert x.resets == 0.0
        fuse(x, error, source, std)


def test_a_precise_heading_that_is_refused_for_long_resets_yaw():
    x = flown()
    refused(x, HeadingSource.GNSS, 1.0, 0.01)
    assert yaw(x) == pytest.approx(YAW + 1.0, abs=1e-6)
    assert (x.resets, x.reset_reason) == (1.0, Reset.HEADING)
    assert x.moved.yaw == pytest.approx(1.0)


def test_a_poor_one_shares_the_contradiction_between_yaw_and_itself():
    x = flown(azimuth=Azimuth.OTHER)
    refused(x, HeadingSource.AUTOPILOT, 0.8, 0.1)
    moved = yaw(x) - YAW
    assert moved == pytest.approx(x.moved.yaw, abs=1e-6)
    # yaw may be wrong by what it is off, the other by a radian; together they make up for it
    assert moved == pytest.approx(0.8 * 0.64 / 1.64, abs=0.01)
    assert moved + x.heading_offset == pytest.approx(0.8, abs=0.01)
    assert x.P[E_ATT + 2][E_ATT + 2] == pytest.approx(0.64 / 1.64, abs=0.01)
    assert x.redrawn[E_ATT + 2] == 1.0
    assert is_covariance(x)


def test_a_poor_one_that_the_yaw_bank_contradicts_moves_nothing_but_its_error():
    x = flown(azimuth=Azimuth.OTHER)
    x.yaw_bank.q_sb[:], x.yaw_bank.yaw_std, x.yaw_bank.good = x.q_nb, 0.05, 5.0
    x.azimuth_t = NOW
    refused(x, HeadingSource.AUTOPILOT, 1.0, 0.1)
    assert yaw(x) == pytest.approx(YAW, abs=1e-3)
    assert x.heading_offset == pytest.approx(1.0, abs=0.01)
    assert (x.resets, x.azimuth_t) == (0.0, -1e18)


def see(x: State, field_n: np.ndarray) -> None:
    """Fuse the field of a compass."""
    field_b = so3.rotate(so3.conjugate(np.array(x.q_nb)), field_n) + np.array(x.hard_iron)
    load().yaw.fuse_field(x, settings(), Observation(), Reference(), field_b)


def test_a_field_points_to_the_declination_once_that_is_known():
    for declination, source in ((float("nan"), Azimuth.MAGNETIC), (0.3, Azimuth.FIELD)):
        x = flown(azimuth=0.0)
        x.has_yaw, x.field.declination = 0.0, declination
        see(x, FIELD_N)
        north = 0.0 if np.isnan(declination) else declination
        assert yaw(x) == pytest.approx(YAW + north - np.arctan2(0.01, 0.2))
        assert x.azimuth == source


def test_after_a_disturbed_field_ten_natural_ones_must_follow():
    x = flown(azimuth=Azimuth.FIELD)
    x.field.declination = float(np.arctan2(0.01, 0.2))
    x.field.strength, x.field.inclination = 0.474, float(np.arcsin(0.43 / 0.474))
    see(x, FIELD_N)
    counts = x.count[Aid.HEADING]
    assert [counts[i] for i in (Verdict.FUSED, Verdict.DISTURBED)] == [1.0, 0.0]
    see(x, 2.0 * FIELD_N)
    for n in range(9):
        x.t += 0.1e9
        see(x, FIELD_N)
        assert counts[Verdict.DISTURBED] == 2.0 + n
        assert x.azimuth_t == x.t  # the next azimuth follows on the last before
    x.t += 0.1e9
    see(x, FIELD_N)
    assert [counts[i] for i in (Verdict.FUSED, Verdict.DISTURBED)] == [2.0, 10.0]


def test_another_compass_is_as_uncertain_as_at_first_and_yaw_stays():
    x, k = flown(azimuth=Azimuth.FIELD), settings()
    x.hard_iron[:], x.azimuth_t = [0.01, 0.02, 0.03], NOW
    before = copy(x)
    load().yaw.use_compass(x, k, 0.0)
    assert bytes(x) == bytes(before)
    load().yaw.use_compass(x, k, 1.0)
    variances = np.diag(array(x.P))
    np.testing.assert_allclose(variances[E_IRON : E_IRON + 3], k.iron_std**2)
    assert (variances[E_HEADING], x.azimuth_t) == (0.02**2, -1e18)
    assert list(x.hard_iron) == list(before.hard_iron)
    assert list(x.q_nb) == list(before.q_nb)
    np.testing.assert_array_equal(variances[: E_BG + 3], np.diag(array(before.P))[: E_BG + 3])
