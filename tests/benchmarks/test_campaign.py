"""The instruments that all campaigns share, and one property that each flight of them has."""

import numpy as np

from benchmarks import campaign
from benchmarks.accuracy.consistency import settings_of
from benchmarks.campaign import (
    DELAY_STD,
    band,
    each,
    errors,
    fly,
    median_and_worst,
    nees,
    pieces,
    settled,
)
from benchmarks.matched import matched
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Kind


def test_errors_are_of_the_time_of_the_block():
    flown = fly("square-spiral", 3, duration=61.0)
    settings = matched(flown.nominal, DELAY_STD)
    stop = flown.flight.first_ns + 60_000_000_000
    piece = next(pieces(settings, flown.events, [stop]))
    assert piece.snapshot.t_ns == stop == piece.table.stamp_ns[-1]
    assert piece.snapshot.x.t == stop  # the clock's first epoch begins at zero
    now = errors(piece.snapshot, flown, settings)
    # the estimate of the same stamp is as far from the truth by its latitude and longitude
    place = np.radians([piece.table.column("lat_deg")[-1], piece.table.column("lon_deg")[-1]])
    true = flown.flight.truth_at(np.array([stop]))
    frame = flown.flight.trajectory.frame
    other = true.pos_n[0] - frame.to_ned(*place, piece.table.column("alt_m")[-1])
    np.testing.assert_allclose(now["position"][0], other, atol=1e-3)  # two origins, 1 km apart
    # 10 ms later at 18 m/s it would not be
    late = errors(type(piece.snapshot)(stop + 10_000_000, piece.snapshot.x), flown, settings)
    assert np.linalg.norm(late["position"][0] - now["position"][0]) > 0.1


def test_the_attitude_error_turns_the_estimate_into_the_truth_in_n():
    flown = fly("figure-eight", 3, duration=30.0)
    settings = matched(flown.nominal, DELAY_STD)
    stop = flown.flight.first_ns + 29_000_000_000
    snapshot = next(pieces(settings, flown.events, [stop])).snapshot
    theta_n = np.array([0.01, -0.02, 0.03])
    q_nb = flown.flight.truth_at(np.array([stop])).q_nb[0]
    snapshot.x.q_nb[:] = so3.multiply(so3.exp(-theta_n), q_nb)
    found = errors(snapshot, flown, settings)["attitude"][0]
    np.testing.assert_allclose(found, theta_n, atol=1e-12)  # rounding


def test_nees_of_samples_of_a_covariance_is_chi_square():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((3, 3))
    squares = [nees(root @ rng.standard_normal(3), root @ root.T) for _ in range(400)]
    low, high = band(1200, 0.999)
    assert low < np.mean(squares) / 3.0 < high


def test_any_order_of_arrival_gives_the_same_bits():
    flown = fly("figure-eight", 5, duration=60.0)
    settings, family = settings_of("matched", flown)
    events, rng = flown.events, np.random.default_rng(5)
    late = rng.uniform(0.0, 0.5e9, len(events))
    # the last ones must come in time
    late[events.t_ns > events.t_ns.max() - 2_000_000_000] = 0.0
    is_imu = events.kind == Kind.IMU
    arrivals = {
        "all late": late,
        "aids late": np.where(is_imu, 0.0, late),
        "inertial samples late": np.where(is_imu, late, 0.0),
    }
    ways = {
        name: events.take(np.argsort(events.t_ns + delay, kind="stable"))
        for name, delay in arrivals.items()
    }
    again = np.flatnonzero(rng.random(len(events)) < 1.0 / 3.0)
    rows = np.concatenate([np.arange(len(events)), again])
    arrival = events.t_ns[rows] + np.concatenate([np.zeros(len(events)), late[again]])
    ways["a third repeated"] = events.take(rows[np.argsort(arrival, kind="stable")])
    dropped = ~is_imu & (rng.random(len(events)) < 0.05)
    ways["5 % of the aids dropped"] = events.take(~dropped)

    before, after = (
        errors_and_state(way, flown, settings, family)
        for way in (events, ways.pop("5 % of the aids dropped"))
    )
    for name, way in ways.items():
        assert errors_and_state(way, flown, settings, family)[1] == before[1], name
    # of the information 5 % is lost: sigma times the root of that, and 4.5 sigma of luck at most
    moved = np.abs((after[0] - before[0]) / before[2])
    assert 0.0 < moved.max() < 4.5 * 0.05**0.5 + 0.5


def errors_and_state(events, flown, settings, family):
    """Return errors of motion, the state's bytes and sigmas at the end of all events."""
    *_, last = pieces(settings, events, [], family)
    refused = [row["STALE"] + row["MALFORMED"] for row in _arrivals(last.pipeline).values()]
    assert sum(refused) == 0
    found = errors(last.snapshot, flown, settings, family)
    motion = [found[name] for name in ("position", "velocity", "attitude")]
    sigmas = np.concatenate([np.sqrt(np.diag(P)) for _, P in motion])
    return np.concatenate([error for error, _ in motion]), bytes(last.snapshot.x), sigmas


def _arrivals(pipeline):
    return {
        kind: {why.name: count for why, count in row.items()}
        for kind, row in pipeline.health().arrivals.items()
    }


def test_when_all_is_good_again_is_found_to_the_sample():
    t = np.arange(-2.0, 5.0)
    assert settled(t, t >= 0.0) == 0.0
    assert settled(t, t != 1.0) == 2.0
    assert settled(t, t < 4.0) == np.inf
    assert settled(t - 10.0, t > 0.0) == np.inf


def test_what_never_came_is_named_with_how_often():
    assert median_and_worst([1.0, 2.0, np.inf], 1) == "2.0 (never in 1 of 3)"
    assert median_and_worst([np.inf, np.inf, 1.0], 1) == "never in 2 of 3"
    assert median_and_worst([np.inf], 1) == "never"


def test_jobs_are_done_by_several_processes_and_come_back_in_their_order(monkeypatch, capfd):
    assert each(abs, [-3, 2, -1], "numbers") == [3, 2, 1]
    assert "numbers: 3 of 3" in capfd.readouterr().err
    monkeypatch.setattr(campaign, "PROCESSES", 1)
    assert each(abs, [-3, 2, -1], "numbers") == [3, 2, 1]
