"""What every aid that declares itself has to keep: bounds, Jacobian, first reading, words."""

import dataclasses
import math
import re

import numpy as np
import pytest

from ekf_companion.core.memory.aid import BY_KIND, DECLARED, SlowError, Value, aid, declared_in
from ekf_companion.core.memory.enums import SLOW_ERRORS, Aid, Mode, N
from ekf_companion.core.memory.overlay import as_parameters, errors
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.core.order.timeline import Timeline
from ekf_companion.core.settings.from_settings import delays_ns, parameters
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.health import Arrival
from ekf_companion.nav.earth import PRESSURES, TROPOSPHERE, pressure_altitude
from ekf_companion.nav.measurements import WIDTH, Kind, VehicleType
from ekf_companion.status.aids import sources_of
from tests.core.interpreted import load
from tests.core.jacobian import check
from tests.core.states import a_state, array, some_parameters
from tests.paths import ROOT

OFF = (Kind.POSE, Kind.VELOCITY)
"""Of which nobody can say whether GNSS is in them: off unless told."""
ALL = pytest.mark.parametrize("aid", DECLARED, ids=[one.name for one in DECLARED])


def number_of(aid):
    return Aid[aid.name.upper()]


def usual(aid):
    """Return a row in the middle of what the sensor says, what is optional not known.

    Of a range the configuration knows where the anchor is.
    """
    known = {"north", "east", "down"}
    return [
        math.nan if one.is_optional and name not in known else min(0.5 * one.high, 7.0)
        for name, one in aid.row.items()
    ]


PRIORS = (Kind.FLOW, Kind.ANCHOR)
"""Whose slow errors no single reading shows: they begin with what is known of such sensors."""


MOVING = {Kind.AIRSPEED: VehicleType.FIXED_WING, Kind.WHEEL: VehicleType.GROUND}
"""How a vehicle moves of which an aid assumes more."""


def level(seed, aid):
    """Return a state above ground that is tilted by less than any aid refuses, and moves ahead."""
    x = a_state(seed)
    x.mode, x.armed, x.has_yaw = Mode.NAVIGATE, 1.0, 1.0
    x.vehicle = MOVING.get(aid.kind, VehicleType.UNKNOWN)
    x.vel_n[:] = np.array([4.4, 5.5, 0.3]) + 0.2 * np.array(x.vel_n)
    x.at_rest = float(aid.kind in OFF)  # where readings may repeat
    tilt = np.random.default_rng(seed).uniform(-0.2, 0.2, 2)
    x.q_nb[:] = np.array([1.0, *tilt, 0.4]) / np.linalg.norm([1.0, *tilt, 0.4])
    for name, first in SLOW_ERRORS.items():
        own = next(one for one in DECLARED if one.name == name).slow_errors.values()
        for i, error in enumerate(own):
            errors(x)[first - 3 + i] = x.pos_n[2] + 5.0 if error.unit == "m" else 0.1
    x.has_aid[Aid.RANGE_FINDER] = 1.0
    return x


def parameters_of(aid):
    """Return a lever arm and what the settings say of an aid, whose noise is 0.5."""
    k, settings = some_parameters(), FilterSettings()
    found = Parameters.from_buffer(parameters(settings, "px4")).aid[number_of(aid)]
    k.aid[number_of(aid)] = found
    k.aid[number_of(aid)].std = 0.5
    if aid.kind in PRIORS:
        k.aid[number_of(aid)].own[:] = [0.1] * len(k.aid[number_of(aid)].own)
    return k


@ALL
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_jacobian_is_the_slope_of_the_prediction(aid, seed):
    if aid.kind in OFF:  # have tests of their own: their slope is that where they are right
        return
    module, number, x = load().dispatch, number_of(aid), level(seed, aid)
    tilt, own = list(x.q_nb), parameters_of(aid).aid[number_of(aid)]
    down, ground = x.pos_n[2], x.range_finder_ground
    if aid.kind == Kind.WHEEL:  # its lever arm and mounting
        own.own[2:6] = [0.6, -0.4, 0.8, 0.1]

    def observe(moved, k, o):
        if aid.kind == Kind.RANGE:  # it takes the tilt as it is
            moved.q_nb[:] = tilt
        if aid.kind == Kind.FLOW:  # it takes the height as it is
            moved.pos_n[2], moved.range_finder_ground = down, ground
        k.aid[number] = own
        assert module.observe(moved, k, o, number, usual(aid))

    check(observe, x, 1e-5)


@ALL
def test_its_first_reading_shows_its_slow_errors_and_nothing_else(aid):
    """After it the same reading is no news, and its error is the estimate's and white noise.

    Where no single reading shows them, they are none, and owe to nothing else.
    """
    x, k, o, module = level(1, aid), parameters_of(aid), Observation(), load().dispatch
    root = np.random.default_rng(1).normal(size=(N, N))
    P = array(x.P)
    P[:] = root @ root.T * 1e-4  # as sure as where an aid may begin
    before, kept = P.copy(), np.array(errors(x))
    assert module.begin(x, k, number_of(aid), usual(aid))
    if aid.kind != Kind.VELOCITY:  # which shows nothing of its errors alone
        assert module.observe(x, k, o, number_of(aid), usual(aid))
    first = SLOW_ERRORS[aid.name]
    own = range(first, first + len(aid.slow_errors))
    others = [i for i in range(N) if i not in own]
    if aid.kind in PRIORS:
        assert not np.array(errors(x))[first - 3 : own.stop - 3].any()
        assert not P[np.ix_(own, others)].any()
    else:
        assert o.z[0] == pytest.approx(0.0, abs=1e-12)
    assert np.array_equal(P[np.ix_(others, others)], before[np.ix_(others, others)])
    assert {i + 3 for i in np.flatnonzero(np.array(errors(x)) != kept)} <= {*own}
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > -1e-9 * np.linalg.eigvalsh(P).max()


@ALL
def test_its_bounds_are_kept_at_the_door(aid):
    settings = FilterSettings()
    row = usual(aid)
    bad = []
    for i, value in enumerate(aid.row.values()):
        bad += [[*row[:i], one, *row[i + 1 :]] for one in (value.low, value.high, -math.inf)]
        if not value.is_optional:
            bad.append([*row[:i], math.nan, *row[i + 1 :]])
    timeline = Timeline(parameters(settings, "px4"), delays_ns(settings, "px4"), 2.0)
    for n, values in enumerate([row, *bad]):
        filled = (*values, *[0.0] * (WIDTH - len(values)))
        arrival = timeline.insert(1_000_000_000 + n, aid.kind, filled)
        assert (arrival == Arrival.MALFORMED) == (n > 0), values


@ALL
def test_it_is_found_by_whoever_speaks_of_it(aid):
    assert BY_KIND[aid.kind] is aid
    own = getattr(FilterSettings(), aid.name)
    assert own.use is (aid.kind not in OFF)
    walks = {name for one in aid.slow_errors.values() for name in (one.walk, one.speed_walk)}
    assert min(own.std, *(getattr(own, name) for name in walks - {None})) > 0.0
    sources = sources_of(0, is_autopilots=False, ranks=(0, 0, 0, 0), receiver=0)
    assert sources[number_of(aid)].endswith(aid.sensor)
    assert aid.advice.endswith(".")
    assert f"{aid.name}.std" in aid.advice
    assert aid.words == aid.words.lower() != aid.sensor


def test_a_row_that_is_too_wide_is_refused():
    declared = type("Wide", (), {f"v{i}": Value("m", 0.0, 1.0) for i in range(WIDTH + 1)})
    with pytest.raises(ValueError, match=f"a row has {WIDTH} numbers, this {WIDTH + 1}"):
        aid(Kind.BARO, words="", sensor="", advice="")(declared)


def test_the_class_of_an_aid_is_read_as_it_is_compiled():
    for one in DECLARED:
        module = load().__dict__[one.name]
        found = next(c.found for c in vars(module).values() if hasattr(c, "found"))
        assert found == one
        assert all(isinstance(error, SlowError) for error in one.slow_errors.values())


@ALL
def test_its_file_finds_each_of_its_own_settings_where_the_kernel_has_it(aid):
    text = (ROOT / "ekf_companion/core/aids" / f"{aid.name}.py").read_text(encoding="utf-8")
    places = re.findall(r"^([A-Z_]+) = cython.declare\(cython\.\w+, (\d+)\)$", text, re.M)
    places = {name: int(place) for name, place in places}
    for name in set(re.findall(r"\bown\[([A-Z_]+)", text)):
        usual = getattr(FilterSettings(), aid.name)
        old = getattr(usual, name.lower())
        new = (7.25, 7.5, 7.75) if isinstance(old, tuple) else 7.25
        changed = dataclasses.replace(usual, **{name.lower(): new})
        settings = dataclasses.replace(FilterSettings(), **{aid.name: changed})
        k = as_parameters(parameters(settings, "unknown"))
        found = np.array(k.aid[number_of(aid)].own)[places[name] :]
        assert found[: np.size(new)].tolist() == np.atleast_1d(new).tolist(), name


def test_no_name_is_declared_twice(tmp_path):
    """The second would take the place of the first: a column of the row would be gone."""
    path = tmp_path / "double.py"
    lines = ["north = Value('m', 0.0, 1.0)", "north = SlowError('m')"]
    body = "\n".join(f"    {line}" for line in lines)
    path.write_text(f'\n@aid(Kind.RANGE, words="", sensor="", advice="")\nclass Double:\n{body}\n')
    with pytest.raises(ValueError, match=r"double\.py: Double declares a name twice"):
        declared_in(path)


def test_a_barometer_can_say_what_the_standard_atmosphere_has():
    alt = BY_KIND[Kind.BARO].row["alt"]
    assert (alt.low, alt.high) == TROPOSPHERE
    assert [pressure_altitude(one) for one in PRESSURES] == pytest.approx([alt.high, alt.low])
    assert pytest.approx(PRESSURES, rel=1e-3) == (22_632.0, 177_700.0)
