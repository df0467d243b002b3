"""Flights without a compass, and with one that lies: the motion itself shows where north is."""

import numpy as np
import pytest

from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, HeadingSource, Kind, merge
from ekf_companion.nav.state import Status, Table, Trajectory
from tests.core.flights import between, flight, without

KNOWN = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.05))
FLIGHTS = ["figure-eight", "loiter", "square-spiral"]


class Run:
    """A flight estimated, beside its truth."""

    def __init__(self, events: Events, truth: Trajectory) -> None:
        self.pipeline = Pipeline(KNOWN)
        self.table: Table = self.pipeline.run(events)
        rows = np.searchsorted(truth.att_t_ns, self.table.stamp_ns)
        self.t = (self.table.stamp_ns - self.table.stamp_ns[0]) * 1e-9
        yaw = so3.to_euler(truth.q_nb[rows])[:, 2]
        speed = np.linalg.norm(truth.vel_n[rows, :2], axis=1)
        self.moves = float(self.t[np.argmax(speed > 1.0)])
        """When the vehicle begins to move, s."""
        self.is_navigating = self.table.column("status") >= Status.OK
        self.error = np.abs(np.degrees(so3.wrap(self.table.column("yaw") - yaw)))
        """Of the yaw, deg; NaN: none."""

    @property
    def begins(self) -> float:
        """Return when it begins to navigate, s."""
        return float(self.t[np.argmax(self.is_navigating)]) if self.is_navigating.any() else np.inf

    @property
    def repairs(self) -> int:
        return int(as_state(self.pipeline._timeline.block()).yaw_bank.repairs)


def lying(events: Events, start: float = 0.0, end: float = np.inf) -> Events:
    """Turn the compass half round from start to end, s."""
    values = events.values.copy()
    rows = (events.kind == Kind.MAG) & between(events, start, end)
    values[np.ix_(rows, [0, 1])] *= -1.0
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@pytest.mark.parametrize("name", FLIGHTS)
@pytest.mark.parametrize("seed", [1, 2])
def test_without_a_compass_the_first_manoeuvre_shows_north(name, seed):
    events, truth = flight(name, duration=75.0, seed=seed, rate=50.0)
    run = Run(without(events, Kind.MAG), truth)
    assert run.begins < run.moves + 10.0
    after = run.t >= run.begins
    assert run.error[after].max() < 10.0
    assert run.error[run.t >= run.begins + 60.0].max() < 3.0
    assert run.table.column("status")[-1] == Status.OK
    assert run.pipeline.health().resets == 0


def test_a_start_in_flight_without_a_compass_finds_down_and_north():
    events, truth = flight("figure-eight", duration=30.0, skip=15.0, rate=50.0)
    run = Run(without(events, Kind.MAG), truth)
    assert run.begins < 10.0
    assert run.error[run.t >= run.begins].max() < 10.0
    assert run.error[run.t >= 20.0].max() < 3.0
    sure = np.degrees(run.table.column("sd_roll")[run.t >= 20.0])
    assert sure.max() < 1.5


def test_a_board_mounted_upside_down_starts_in_flight_as_well():
    events, truth = flight("figure-eight", duration=30.0, skip=15.0, rate=50.0)
    values = events.values.copy()
    rows = np.flatnonzero(events.kind == Kind.IMU)
    values[np.ix_(rows, [1, 2, 4, 5])] *= -1.0  # turned half round about the forward axis
    turned = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    run = Run(without(turned, Kind.MAG), truth)
    late = run.t >= 20.0
    assert run.error[late].max() < 3.0
    assert np.degrees(np.abs(run.table.column("roll")[late])).min() > 120.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_hover_shows_no_heading(seed):
    events, truth = flight("hover", duration=120.0, seed=seed, rate=50.0)
    run = Run(without(events, Kind.MAG), truth)
    assert not run.is_navigating.any()
    assert run.table.column("status")[-1] == Status.ATTITUDE


@pytest.mark.parametrize("name", FLIGHTS)
@pytest.mark.parametrize("end", [15.0, np.inf], ids=["at first", "always"])
def test_a_compass_that_points_south_is_found_out(name, end):
    events, truth = flight(name, duration=60.0, rate=50.0)
    run = Run(lying(events, end=end), truth)
    assert run.error[run.t < run.moves][-1] > 150.0
    # no rest has shown the bias about the vertical, and there is no compass to be had
    assert run.error[run.t >= run.moves + 20.0].max() < 8.0
    health = run.pipeline.health()
    assert run.repairs == health.resets == 1
    assert health.reset_reason == "heading against the motion"


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_compass_that_jumps_in_flight_moves_nothing(name):
    events, truth = flight(name, duration=70.0, rate=50.0)
    run = Run(lying(events, start=35.0), truth)
    assert run.error[run.t >= 20.0].max() < 6.0
    assert run.pipeline.health().resets == 0
    assert run.pipeline.health().verdicts[Aid.HEADING][Verdict.GATED] > 0


def test_at_the_first_fix_the_compass_gives_true_north_before_an_autopilot_may():
    """ArduPilot's heading is magnetic until it has an origin, seconds after the first fix."""
    events, truth = flight("hover", duration=12.0)
    events = events.take((events.kind != Kind.GNSS) | ~between(events, 0.0, 4.0))
    events = Events(
        t_ns=events.t_ns + np.where(events.kind == Kind.GNSS, 5_000_000, 0),
        kind=events.kind,
        values=events.values,
    )
    first = events.t_ns[events.kind == Kind.GNSS][0]
    # one of its headings comes between the first fix, 0.12 s old, and the next field
    stamps = first - 118_000_000 + np.arange(-30, 30) * 100_000_000
    yaw = so3.to_euler(truth.q_nb[np.searchsorted(truth.att_t_ns, stamps)])[:, 2]
    told = Events.from_columns(
        stamps, Kind.HEADING, yaw - 0.35, 0.087, float(HeadingSource.AUTOPILOT)
    )
    run = Run(merge(events, told), truth)
    assert run.error[run.t > (first - run.table.stamp_ns[0]) * 1e-9 + 0.5].max() < 3.0


def test_a_compass_that_comes_to_its_senses_is_heard_again():
    events, truth = flight("loiter", duration=60.0, rate=50.0)
    run = Run(lying(events, end=15.0), truth)
    x = as_state(run.pipeline._timeline.block())
    assert abs(np.degrees(x.heading_offset)) < 5.0
    assert x.heading_std == FilterSettings().heading.magnetometer_std


@pytest.mark.parametrize("name", [*FLIGHTS, "hover"])
@pytest.mark.parametrize("seed", [21, 22])
def test_a_healthy_filter_is_left_alone(name, seed):
    events, truth = flight(name, duration=60.0, seed=seed, rate=50.0)
    run = Run(events, truth)
    assert run.repairs == run.pipeline.health().resets == 0
    assert run.error[run.t >= 5.0].max() < 10.0


def spoilt(events: Events, noise: float, wild: float, seed: int) -> Events:
    """Add noise to all velocities (m/s), and 20 m/s to a share of them."""
    rng = np.random.default_rng(seed)
    values = events.values.copy()
    rows = np.flatnonzero(events.kind == Kind.GNSS)
    values[np.ix_(rows, [3, 4])] += rng.normal(0.0, noise, (len(rows), 2))
    wrong = rows[rng.random(len(rows)) < wild]
    values[np.ix_(wrong, [3, 4])] += rng.normal(0.0, 20.0, (len(wrong), 2))
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


def claims(events: Events, truth: Trajectory) -> np.ndarray:
    """Return how wrong the bank's heading was whenever it had one, deg."""
    timeline = Pipeline(KNOWN)._timeline
    errors = []
    for row in zip(events.t_ns.tolist(), events.kind.tolist(), events.values, strict=True):
        timeline.insert(*row)
        if row[1] != Kind.GNSS:
            continue
        bank = as_state(timeline.block()).yaw_bank
        if bank.good >= 5.0:
            told = so3.multiply(so3.exp(np.array([0.0, 0.0, bank.yaw])), np.array(bank.q_sb))
            true = truth.q_nb[np.searchsorted(truth.att_t_ns, timeline.stamp_ns)]
            errors.append(so3.log(so3.multiply(told, so3.conjugate(true)))[2])
    return np.abs(np.degrees(errors))


@pytest.mark.parametrize(("noise", "wild"), [(1.0, 0.0), (0.1, 0.1), (0.1, 0.3)])
@pytest.mark.parametrize("name", [*FLIGHTS, "hover"])
def test_bad_velocities_show_no_wrong_heading(name, noise, wild):
    events, truth = flight(name, duration=60.0, rate=50.0)
    errors = claims(spoilt(without(events, Kind.MAG), noise, wild, 1), truth)
    # a claim is of one sigma below 10 degrees
    assert errors.max(initial=0.0) < 30.0
    assert np.median(errors) < 10.0 if len(errors) else name == "hover" or wild == 0.3


def test_after_a_gap_the_bank_finds_the_heading_again():
    events, truth = flight("figure-eight", duration=45.0, rate=50.0)
    events = without(events, Kind.MAG)
    gap = (events.kind == Kind.IMU) & between(events, 25.0, 25.5)
    run = Run(events.take(~gap), truth)
    x = as_state(run.pipeline._timeline.block())
    assert x.yaw_bank.good >= 5.0
    assert x.gaps == 1.0
    assert run.error[-1] < 3.0


def test_a_start_in_motion_levels_without_a_velocity_of_the_receiver():
    events, truth = flight("figure-eight", duration=60.0, skip=15.0, rate=50.0)
    values = events.values.copy()
    values[events.kind == Kind.GNSS, 3:6] = np.nan
    run = Run(Events(t_ns=events.t_ns, kind=events.kind, values=values), truth)
    assert run.begins < 10.0
    late = run.t > 30.0
    assert run.error[late].max() < 5.0
    assert (run.table.column("status")[late] == Status.OK).mean() > 0.9
