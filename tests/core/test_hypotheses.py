"""What began to be wrong is named, when and how large; and nothing is where nothing is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Fault, Source
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.core.settings.settings import (
    FilterSettings,
    GnssSettings,
    VisualVelocitySettings,
)
from ekf_companion.engine.faults import OF_NO_SIZE, WORDS
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import SIGMA, Status
from tests.core.flights import between, flight

METRE = 1.0 / 6.371e6
"""rad of latitude."""
BEGIN, END = 30.0, 60.0
"""s."""
KNOWN = FilterSettings(gnss=GnssSettings(delay=0.12))


def pipeline(mode: str = "report") -> Pipeline:
    """Return an estimator that knows how late the simulated fixes are."""
    return Pipeline(replace(KNOWN, weigh_faults=mode))


def faulty(events: Events, kind: Kind, column: int, by: float, slope: float = 0.0) -> Events:
    """Return a flight with an error that begins in it: a step and a rate, in SI."""
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    mask = (events.kind == kind) & between(events, BEGIN, END)
    values = events.values.copy()
    values[mask, column] += by + slope * (t[mask] - BEGIN)
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


def found(events: Events, mode: str = "report"):
    """Return what was found, with onsets in s after the first event."""
    one = pipeline(mode)
    one.run(events)
    first = int(events.t_ns[0])
    return [(f, 1e-9 * (f.onset_ns - first)) for f in one.found_faults()]


CASES = {
    "position": (Kind.GNSS, 0, 20 * METRE, 0.0, Source.POSITION, 20.0),
    "far": (Kind.GNSS, 0, 400 * METRE, 0.0, Source.POSITION, 400.0),
    "slide": (Kind.GNSS, 0, 0.0, 1.0 * METRE, Source.POSITION, 1.0),
    "height": (Kind.GNSS, 2, 15.0, 0.0, Source.HEIGHT, 15.0),
    "velocity": (Kind.GNSS, 3, 1.0, 0.0, Source.VELOCITY, 1.0),
    "climb": (Kind.GNSS, 5, 1.0, 0.0, Source.CLIMB, 1.0),
    "barometer": (Kind.BARO, 0, 8.0, 0.0, Source.BARO, 8.0),
    "accelerometer": (Kind.IMU, 3, 0.3, 0.0, Source.ACCEL, 0.3),
    "gyro": (Kind.IMU, 2, 0.03, 0.0, Source.GYRO, 0.03),
}
MODES = [(mode, name) for mode in ("report", "act") for name in CASES]
MODES.remove(("report", "accelerometer"))
"""The filter's own rules take that for noise, so that a report sees little of it."""


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("mode", "name"), MODES)
def test_the_source_is_named_with_onset_and_size(name, mode, seed):
    kind, column, step, slope, source, size = CASES[name]
    events, _ = flight("figure-eight", END, seed=seed)
    told = found(faulty(events, kind, column, step, slope), mode)
    first, onset = told[0]
    assert FAULTS[first.kind].source == source
    if mode == "act":
        # what a report finds comes later, beside a filter that has followed the fault by then
        assert abs(onset - BEGIN) < 2.0
        assert np.linalg.norm(first.size) == pytest.approx(size, rel=0.35)


@pytest.mark.parametrize("mode", ["report", "act"])
@pytest.mark.parametrize("name", ["figure-eight", "hover", "loiter"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_named_where_nothing_is_wrong(name, seed, mode):
    events, _ = flight(name, 90.0, seed=seed)
    assert found(events, mode) == []


def test_a_report_changes_no_bit():
    events, _ = flight("figure-eight", END)
    events = faulty(events, Kind.GNSS, 0, 20 * METRE)
    off, report = (pipeline(mode).run(events).values for mode in ("off", "report"))
    assert np.array_equal(off, report, equal_nan=True)


@pytest.mark.parametrize(
    ("mode", "kind", "column", "step"),
    [
        ("report", Kind.GNSS, 0, 20 * METRE),
        ("act", Kind.GNSS, 0, 20 * METRE),
        ("act", Kind.MAG, 1, 0.15),
    ],
    ids=["report", "act", "field"],
)
def test_late_fixes_find_the_same_to_the_bit(mode, kind, column, step):
    """Whatever the order of arrival within the window, each is weighed in its place, and once."""
    events, _ = flight("figure-eight", END)
    events = faulty(events, kind, column, step)
    arrival = events.t_ns + np.where(events.kind == Kind.GNSS, 400_000_000, 0)
    arrival[events.kind == Kind.BARO] += 150_000_000
    late = events.take(np.argsort(arrival, kind="stable"))
    in_order, shuffled = pipeline(mode), pipeline(mode)
    in_order.run(events)
    shuffled.run(late)
    assert in_order.found_faults()
    assert in_order.found_faults() == shuffled.found_faults()
    assert in_order._timeline.hypotheses() == shuffled._timeline.hypotheses()
    assert np.array_equal(in_order.values(), shuffled.values(), equal_nan=True)


def test_probabilities_are_those_of_exclusive_explanations():
    """All of what is level and nothing vertical, and so on: each alone sums to one at most."""
    events, _ = flight("figure-eight", END)
    one = pipeline()
    one.run(faulty(events, Kind.GNSS, 0, 20 * METRE))
    held = [(Fault(kind), p) for kind, p, _, _ in one._timeline.hypotheses()]
    assert all(0.0 <= p <= 1.0 for _, p in held)
    for shows in (1, 2):
        of = sum(p for kind, p in held if FAULTS[kind].shows in (0, shows))
        assert of <= 1.0 + 1e-9


@pytest.mark.parametrize(
    ("kind", "column", "step", "slope"),
    [
        (Kind.GNSS, 0, 20 * METRE, 0.0),
        (Kind.GNSS, 0, 0.0, 1.0 * METRE),
        (Kind.GNSS, 2, 15.0, 0.0),
        (Kind.GNSS, 3, 1.0, 0.0),
        (Kind.BARO, 0, 8.0, 0.0),
    ],
    ids=["position", "slide", "height", "velocity", "barometer"],
)
def test_what_is_named_is_repaired(kind, column, step, slope):
    """With ``act`` the estimate ends where it would have ended without the fault."""
    events, _ = flight("figure-eight", END)
    right = pipeline("act").run(events).values[-1, 3:9]
    wrong = pipeline("act").run(faulty(events, kind, column, step, slope))
    std = wrong.columns(SIGMA[:6])[-1]
    off = wrong.values[-1, 3:9] - right
    assert np.all(np.abs(off[:3]) < np.maximum(3.0 * std[:3], 1.0))
    assert np.all(np.abs(off[3:]) < 0.3)


@pytest.mark.parametrize("seconds", [0.0, 5.0], ids=["at once", "within seconds"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_ends_is_not_held(seconds, seed):
    """A receiver that was 40 m off is right again, and nothing is taken off it any more."""
    events, _ = flight("figure-eight", 90.0, seed=seed)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    values = events.values.copy()
    share = np.where(t < 50.0, 1.0, np.exp(-(t - 50.0) / seconds) if seconds else 0.0)
    mask = (events.kind == Kind.GNSS) & (t > BEGIN)
    values[mask, 0] += 40 * METRE * share[mask]
    right = pipeline("act").run(events).values[-1]
    one = pipeline("act")
    wrong = one.run(Events(t_ns=events.t_ns, kind=events.kind, values=values)).values[-1]
    assert one.found_faults()
    assert np.all(np.abs(wrong[3:6] - right[3:6]) < np.maximum(3.0 * wrong[23:26], 1.0))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_fault_in_all_axes_is_not_taken_for_two(seed):
    """What a level and a vertical fault would both explain counts for one of them."""
    events, _ = flight("figure-eight", END, seed=seed)
    values = events.values.copy()
    mask = (events.kind == Kind.IMU) & between(events, BEGIN, END)
    values[mask, 3:6] += np.array([-0.16, 0.04, 0.24])
    told = found(Events(t_ns=events.t_ns, kind=events.kind, values=values), "act")
    assert FAULTS[told[0][0].kind].source == Source.ACCEL


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_descent_of_the_receiver_alone_is_no_fault_of_the_barometer(seed):
    """Its height and vertical velocity fall away for 12 s, faster and slower, in a hover."""
    events, _ = flight("hover", END, seed=seed)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    since = np.clip(t - BEGIN, 0.0, 12.0)
    values = events.values.copy()
    mask = events.kind == Kind.GNSS
    values[mask, 5] += (7.0 * np.sin(np.pi * since / 12.0) ** 2)[mask]
    values[mask, 2] -= 3.5 * (since - 6.0 / np.pi * np.sin(np.pi * since / 6.0))[mask]
    right = pipeline("act").run(events).values[-1]
    one = pipeline("act")
    wrong = one.run(Events(t_ns=events.t_ns, kind=events.kind, values=values)).values[-1]
    sources = {FAULTS[fault.kind].source for fault in one.found_faults()}
    assert sources <= {Source.HEIGHT, Source.CLIMB, Source.FALL}
    assert abs(wrong[5] - right[5]) < max(3.0 * wrong[25], 2.0)


def erratic(events: Events, seed: int, axes: tuple[int, ...], *, follows: bool) -> Events:
    """Return a flight whose receiver's velocity wanders by 4 m/s within a second, and goes nowhere.

    Its position follows, or does not.
    """
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero((events.kind == Kind.GNSS) & between(events, BEGIN, END))
    dt = np.diff(events.t_ns[rows], prepend=events.t_ns[rows[0]]) * 1e-9
    values = events.values.copy()
    for axis in axes:
        wander = np.zeros(len(rows))
        for i in range(1, len(rows)):
            kept = np.exp(-dt[i])
            wander[i] = kept * wander[i - 1] + 4.0 * np.sqrt(1.0 - kept**2) * rng.normal()
        way = np.cumsum(wander * dt)
        values[rows, 3 + axis] += wander
        if follows:
            values[rows, axis] += way * METRE if axis < 2 else -way
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", ["figure-eight", "hover"])
@pytest.mark.parametrize(
    ("axes", "follows"),
    [((0, 1), False), ((2,), False), ((2,), True)],
    ids=["velocity", "climb", "height"],
)
def test_what_is_wrong_in_no_shape_leads_nowhere(name, axes, follows, seed):
    """And nobody else is blamed for it."""
    events, _ = flight(name, END + 20.0, seed=seed)
    right = pipeline("act").run(events).values
    one = pipeline("act")
    wrong = one.run(erratic(events, seed, axes, follows=follows)).values
    kinds = {fault.kind for fault in one.found_faults()}
    assert kinds & set(OF_NO_SIZE)
    receiver = {Source.POSITION, Source.DRAG, Source.VELOCITY}
    receiver |= {Source.CLIMB, Source.HEIGHT, Source.FALL}
    assert {FAULTS[kind].source for kind in kinds} <= receiver
    off = np.abs(wrong[:, 3:6] - right[:, 3:6])
    assert np.nanmax(off) < 6.0
    assert np.all(off[-1] < np.maximum(5.0 * wrong[-1, 23:26], 2.0))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", ["figure-eight", "hover", "loiter"])
def test_a_receiver_that_wanders_is_known_to_be_as_wide_as_it_does(name, seed):
    """Position and velocity go together, so that nothing but the inertial samples contradicts."""
    events, _ = flight(name, END + 60.0, seed=seed)
    right = pipeline("act").run(events).values
    one = pipeline("act")
    wrong = one.run(erratic(events, seed, (0, 1), follows=True)).values
    assert Fault.RECEIVER_WILD in {fault.kind for fault in one.found_faults()}
    off = np.hypot(*(wrong[:, 3:5] - right[:, 3:5]).T)
    sigma = np.hypot(*wrong[:, 23:25].T)
    known = np.isfinite(off)
    assert known.mean() > 0.9
    assert np.mean(off[known] < 5.0 * sigma[known] + 1.0) > 0.99
    # once it has been right for a minute it is believed
    assert off[-1] < 5.0 * sigma[-1] < 25.0


@pytest.mark.parametrize("seed", [1, 2])
def test_a_slide_goes_on_through_a_gap(seed):
    """What is held goes on meanwhile, and is known the worse for it."""
    events, _ = flight("loiter", 90.0, seed=seed)
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    values = events.values.copy()
    mask = events.kind == Kind.GNSS
    values[mask, 0] += (1.0 * METRE * np.clip(t - BEGIN, 0.0, None))[mask]
    kept = (t < 55.0) | (t > 75.0)
    gaps = [
        Events(t_ns=events.t_ns, kind=events.kind, values=v).take(kept)
        for v in (events.values, values)
    ]
    right, wrong = (pipeline("act").run(gap).values[-1] for gap in gaps)
    off = np.abs(wrong[3:6] - right[3:6])
    assert np.all(off < np.maximum(5.0 * wrong[23:26], 2.0))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("begin", [0.0, BEGIN], ids=["always", "later"])
@pytest.mark.parametrize("name", ["figure-eight", "hover"])
def test_no_receiver_is_blamed_for_a_vibration(name, begin, seed):
    """One that is sampled as a slow wave, of which the samples themselves show nothing."""
    events, _ = flight(name, END + 20.0, seed=seed)
    rng = np.random.default_rng(seed)
    shaken = (events.kind == Kind.IMU) & between(events, begin, END + 20.0)
    t = (events.t_ns[shaken, None] - events.t_ns[0]) * 1e-9
    wave = np.sin(2.0 * np.pi * (0.4 * t + 0.1 * np.sin(t / 7.0)) + rng.uniform(0.0, 6.0, 6))
    values = events.values.copy()
    values[shaken, :6] += [0.02, 0.02, 0.02, 3.0, 3.0, 3.0] * wave
    one = pipeline("act")
    table = one.run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
    receiver = {Source.POSITION, Source.DRAG, Source.VELOCITY, Source.HEIGHT, Source.FALL}
    assert not receiver & {FAULTS[fault.kind].source for fault in one.found_faults()}
    is_ok = table.column("status") == Status.OK
    right = pipeline("act").run(events).values
    # a window of a second shows it, and it may begin in the middle of one
    since = (table.stamp_ns - events.t_ns[0]) * 1e-9 - begin
    is_known = (since < 0.0) | (since > 2.0)
    for first, floor in ((3, 2.0), (6, 0.5)):  # position, velocity
        off = np.linalg.norm((table.values - right)[:, first : first + 3], axis=1)
        sigma = np.linalg.norm(table.values[:, first + 20 : first + 23], axis=1)
        assert not (is_known & is_ok & (off > 5.0 * sigma) & (off > floor)).any()


@pytest.mark.parametrize("seed", [1, 2])
def test_no_receiver_is_blamed_for_where_an_aid_has_led_us_without_it(seed):
    events, truth = flight("figure-eight", 100.0, seed=seed)
    t_ns = np.arange(events.t_ns[0], events.t_ns[-1], 50_000_000)
    vel_n = np.stack([np.interp(t_ns, truth.vel_t_ns, one) for one in truth.vel_n.T], axis=1)
    at = np.clip(np.searchsorted(truth.att_t_ns, t_ns), 0, len(truth.q_nb) - 1)
    said = so3.rotate(so3.conjugate(truth.q_nb[at]), vel_n)
    said += np.random.default_rng(seed).normal(0.0, 0.1, said.shape)
    said[(t_ns - t_ns[0] > 55e9) & (t_ns - t_ns[0] < 70e9)] *= 0.5
    unknown, level = np.full(len(t_ns), np.nan), np.zeros(len(t_ns))
    own = Events.from_columns(t_ns, Kind.VELOCITY, *said.T, unknown, level)
    cut = events.take(~((events.kind == Kind.GNSS) & between(events, 50.0, 80.0)))
    right = pipeline("act").run(events).values
    used = VisualVelocitySettings(use=True)
    one = Pipeline(replace(KNOWN, weigh_faults="act", visual_velocity=used))
    table = one.run(merge(cut, own))
    led = table.values
    alone = np.abs(table.stamp_ns - t_ns[0] - 65e9) < 12e9
    assert Status.OK not in table.column("status")[alone]  # nothing contradicts the aid then
    assert Source.POSITION not in {FAULTS[fault.kind].source for fault in one.found_faults()}
    off = np.abs(led[-1, 3:6] - right[-1, 3:6])
    assert np.all(off < np.maximum(5.0 * led[-1, 23:26], 2.0))


def test_each_fault_has_its_numbers_and_its_words():
    assert set(FAULTS) == set(Fault)
    named = {kind for kind, prior in FAULTS.items() if prior.source != Source.NOISE}
    assert set(WORDS) == named
