"""Which fixes count: whose receiver, whether it is frozen, and the first after the autopilot's."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_GNSS, E_POS, E_VEL, Aid, Mode, N, Reset, Verdict
from ekf_companion.core.memory.overlay import as_parameters
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import GnssRow, Scratch
from ekf_companion.core.memory.state import State
from ekf_companion.core.settings.from_settings import parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import earth
from ekf_companion.nav.measurements import GnssFlag
from tests.core.interpreted import load
from tests.core.states import array

NOW = 100e9
LAT, LON, ALT = 0.82, 0.15, 480.0
FRAME = earth.LocalFrame(LAT, LON, ALT)
DERIVED, SECOND, SUSPECT = GnssFlag.DERIVED, GnssFlag.SECOND, GnssFlag.SUSPECT


def settings() -> Parameters:
    return as_parameters(parameters(FilterSettings(), "unknown"))


def navigating() -> State:
    """Return a state at rest at its origin, with a receiver that was used just now."""
    x = State()
    load().restart.forget_sensors(x)
    load().restart.start(x, 0.0)
    load().strapdown.set_origin(x, LAT, LON, ALT)
    x.t, x.mode, x.fix_t, x.fix_dt = NOW, Mode.NAVIGATE, NOW, 0.2
    array(x.P)[:] = 0.01 * np.eye(N)
    for aid in (Aid.POSITION, Aid.HEIGHT, Aid.VELOCITY):
        x.used_t[aid] = NOW
    x.gnss_offset_var[:] = [0.5, 2.0]
    return x


def a_fix(north: float = 0.0, east: float = 0.0, flags: GnssFlag = GnssFlag.NONE) -> GnssRow:
    lat, lon, alt = FRAME.to_geodetic(np.array([north, east, 0.0]))
    row = GnssRow(lat=float(lat), lon=float(lon), alt=float(alt), flags=float(flags))
    row.vel_n[:], row.std[:] = [0.0] * 3, [1.0, 1.5, 0.1]
    return row


def is_used(x: State, row: GnssRow) -> bool:
    return load().receiver.is_used(x, settings(), Scratch(), row)


@pytest.mark.parametrize(
    ("fix_dt", "fix_t", "patience"),
    [(0.2, NOW, 0.9), (0.1, NOW, 0.75), (1.0, NOW, 2.0), (0.2, -1e18, 2.0)],
)
def test_the_second_receiver_is_used_once_the_first_is_silent(fix_dt, fix_t, patience):
    for late, expected in ((-0.01, False), (0.01, True)):
        x = navigating()
        x.fix_dt, x.fix_t = fix_dt, fix_t
        assert not is_used(x, a_fix(flags=SECOND))
        x.t = NOW + (patience + late) * 1e9
        assert is_used(x, a_fix(flags=SECOND)) == expected
        assert x.receiver == expected


def test_silence_is_counted_from_the_last_fix_of_the_one_in_use():
    x = navigating()
    for _ in range(10):
        x.t += 0.8e9
        x.used_t[Aid.POSITION] = x.t
        assert not is_used(x, a_fix(flags=SECOND))
        assert is_used(x, a_fix())
    # and there is no way back but the same
    x.receiver = 1.0
    assert not is_used(x, a_fix())
    assert is_used(x, a_fix(flags=SECOND))


@pytest.mark.parametrize(
    ("refused", "unused", "east", "expected"),
    [
        (1.1, 1.2, 0.5, True),
        (0.9, 1.2, 0.5, False),  # a glitch
        (1.1, 1.2, 50.0, False),  # the second does not agree with us either
        (0.0, 3.1, 0.5, True),  # not refused but not used, as a suspect one
        (0.0, 2.9, 0.5, False),
    ],
)
def test_a_second_receiver_that_agrees_replaces_one_that_is_refused(
    refused, unused, east, expected
):
    x = navigating()
    x.used_t[Aid.POSITION] = NOW - unused * 1e9
    x.refused_t[Aid.POSITION] = NOW - refused * 1e9 if refused else -1e18
    assert is_used(x, a_fix(east=east, flags=SECOND)) == expected


def test_another_receiver_has_errors_of_its_own():
    x = navigating()
    x.gnss_offset[:], x.gnss_vel_offset[:] = [3.0, -2.0, 1.0], [0.1, 0.2, 0.3]
    array(x.P)[E_POS, E_GNSS] = array(x.P)[E_GNSS, E_POS] = 0.005
    x.refused_t[Aid.POSITION], x.run[0].n, x.slide.is_sliding = NOW, 4.0, 1.0
    x.innovation_mean[:], x.slide.led[:], x.is_force_denied = [0.5] * 3, [9.0] * 2, 1.0
    load().receiver.forget_receiver(x)
    assert not any([*x.gnss_offset, *x.gnss_vel_offset])
    np.testing.assert_allclose(np.diag(array(x.P))[E_GNSS : E_GNSS + 3], [0.5, 0.5, 2.0])
    assert np.count_nonzero(array(x.P)[E_GNSS]) == 1
    assert x.P[E_POS][E_POS] == 0.01
    assert x.refused_t[Aid.POSITION] == x.used_t[Aid.POSITION]
    assert (x.run[0].n, x.slide.is_sliding, x.is_force_denied) == (0.0, 0.0, 0.0)
    assert not any([*x.innovation_mean, *x.slide.led])


@pytest.mark.parametrize(
    ("use_derived", "flags", "had_raw", "verdict"),
    [
        (0.0, GnssFlag.NONE, False, None),
        (0.0, DERIVED, False, Verdict.SUPERSEDED),
        (1.0, DERIVED, False, None),
        (1.0, DERIVED, True, Verdict.SUPERSEDED),
        (2.0, DERIVED, True, None),
        (2.0, GnssFlag.NONE, True, Verdict.SUPERSEDED),
        (1.0, SUSPECT, True, Verdict.SUSPECT),
        (1.0, SUSPECT | SECOND, True, Verdict.SUSPECT),
    ],
)
def test_of_the_receiver_s_position_and_the_autopilot_s_one_is_allowed(
    use_derived, flags, had_raw, verdict
):
    x, k = navigating(), settings()
    k.use_derived, x.raw_fix_t = use_derived, NOW - 1e9 if had_raw else -1e18
    assert load().receiver.is_allowed(x, k, int(flags)) == (verdict is None)
    counts = list(x.count[Aid.POSITION])
    assert sum(counts) == (verdict is not None)
    assert verdict is None or counts[verdict] == 1.0
    if not flags & DERIVED:
        assert x.raw_fix_t == NOW


def repeated(x: State, times: int, vel: tuple[float, float] = (0.0, 0.0)) -> list[bool]:
    row = a_fix(north=1.0)
    row.vel_n[:2] = vel
    return [load().receiver.is_frozen(x, row) for _ in range(times)]


def test_a_position_repeated_to_the_bit_while_we_move_is_frozen():
    x = navigating()
    assert not any(repeated(x, 9))  # at rest
    x = navigating()
    x.vel_n[0] = 2.0
    assert repeated(x, 4) == [False, False, True, True]
    # once found it stays so, though we know our velocity no more
    x.P[E_VEL][E_VEL] = 100.0
    assert repeated(x, 1) == [True]
    assert not load().receiver.is_frozen(x, a_fix(north=1.000001))


@pytest.mark.parametrize(("speed", "is_frozen"), [(1.1, False), (1.15, True)])
def test_we_move_if_we_are_sure_of_that(speed, is_frozen):
    """At 1 m/s and three sigmas of 0.1 m/s an axis: 1.13 m/s."""
    x = navigating()
    x.vel_n[:] = speed * np.array([0.6, 0.0, 0.8])
    assert repeated(x, 4)[-1] == is_frozen


def test_a_velocity_repeated_to_the_bit_shows_a_frozen_receiver_unless_we_rest():
    x = navigating()
    assert repeated(x, 4, (3.0, 0.0)) == [False, False, True, True]
    x = navigating()
    x.at_rest = 1.0
    assert not any(repeated(x, 9, (3.0, 0.0)))


@pytest.mark.parametrize(
    ("east", "reset"), [(0.5, None), (60.0, Reset.POSITION), (5000.0, Reset.ORIGIN)]
)
def test_the_first_fix_of_a_receiver_judges_the_autopilot_s_position(east, reset):
    x, w, k = navigating(), Scratch(), settings()
    k.lever_arm_b[:] = [0.0] * 3
    x.q_nb[0], x.at_rest, x.run[2].n = 1.0, 1.0, 5.0
    x.pos_n[0], x.pos_n[2] = 0.25, -3.0
    row = a_fix(east=east)
    load().fix.read_fix(x, k, w.fix, row)
    assert load().receiver.replace_derived(x, k, w, True) == (reset is not None)
    if reset is None:
        assert x.resets == 0.0
        return
    assert x.reset_reason == reset
    # whatever the frame, what is reported as moved is the way to the new place
    np.testing.assert_allclose(x.moved.pos_n, [-0.25, east, 3.0], atol=1e-6)
    place = earth.LocalFrame(x.origin.lat, x.origin.lon, x.origin.alt).to_geodetic(
        np.array(x.pos_n)
    )
    np.testing.assert_allclose(place, [row.lat, row.lon, row.alt], atol=1e-9)
    assert (x.origin.lon == LON) == (reset == Reset.POSITION)
    assert x.run[2].n == 0.0
