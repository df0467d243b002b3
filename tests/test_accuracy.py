"""Small samples of the campaigns of docs/ACCURACY.md, and the instruments themselves.

Bands are chi-square bands of 99.9 % for so few flights, so that a filter that is right passes
whatever its seeds; the instants of one flight depend on each other and count as one.
"""

from functools import cache

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks import accuracy, arrival, compassless, consistency, lies, outages, seed, seed_flight
from benchmarks.campaign import DELAY_STD, SCENARIOS, band, errors, fly, nees, pieces
from benchmarks.matched import matched
from benchmarks.seed_reference import Reference
from ekf_companion.engine.health import Aid
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Kind
from tests.paths import DATA

needs_seed = pytest.mark.skipif(
    not (DATA / seed_flight.FOLDER).is_dir(), reason="the seed's flight is not here"
)

SURE = 0.999
SEEDS = 6
INSTANTS = (60.0, 80.0, 100.0, 119.0)


@cache
def accounts(kind: str, receiver: str) -> list[consistency.Account]:
    return [
        consistency.account(fly(name, 50 * i + luck, receiver, 120.0), kind, INSTANTS)
        for i, name in enumerate(SCENARIOS)
        for luck in range(SEEDS)
    ]


def mean_nees(kind: str, receiver: str, block: str) -> float:
    squares = np.array([one.nees[block] for one in accounts(kind, receiver)])
    return float(squares.mean() / consistency.BLOCKS[block])


@pytest.mark.parametrize("receiver", ["white", "slow"])
@pytest.mark.parametrize(
    "block", ["velocity", "attitude", "gyro bias", "accel bias", "GNSS delay", "heading offset"]
)
def test_a_filter_that_knows_its_sensors_is_as_wrong_as_it_says(block, receiver):
    low, high = band(SEEDS * len(SCENARIOS) * consistency.BLOCKS[block], SURE)
    assert low < mean_nees("matched", receiver, block) < high


@pytest.mark.parametrize("block", ["velocity", "attitude", "gyro bias", "accel bias"])
def test_with_default_settings_nothing_is_surer_than_it_may_be(block):
    _, high = band(SEEDS * len(SCENARIOS) * consistency.BLOCKS[block], SURE)
    assert mean_nees("default", "slow", block) < high


def test_good_measurements_are_not_refused():
    found = accounts("matched", "white")
    assert sum(one.resets for one in found) == 0
    for aid in set(found[0].verdicts) - {Aid.REST}:
        counts = [one.verdicts[aid] for one in found]
        assert sum(one["fused"] for one in counts) > 1000
        assert sum(one["gated"] for one in counts) == 0


def test_errors_are_of_the_time_of_the_block():
    flown = fly("square-spiral", 3, duration=61.0)
    settings = matched(flown.nominal, DELAY_STD)
    stop = flown.flight.first_ns + 60_000_000_000
    piece = next(pieces(settings, flown.events, [stop]))
    assert piece.snapshot.t_ns == stop == piece.table.stamp_ns[-1]
    assert piece.snapshot.x.t == stop  # the clock's first epoch begins at zero
    now = errors(piece.snapshot, flown, settings)
    # the estimate of the same stamp is as far from the truth, as the other way of telling it
    told = np.radians([piece.table.column("lat_deg")[-1], piece.table.column("lon_deg")[-1]])
    true = flown.flight.truth_at(np.array([stop]))
    frame = flown.flight.trajectory.frame
    other = true.pos_n[0] - frame.to_ned(*told, piece.table.column("alt_m")[-1])
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
    low, high = band(1200, SURE)
    assert low < np.mean(squares) / 3.0 < high


def test_any_order_of_arrival_gives_the_same_bits():
    found = dict(zip(arrival.CASES, arrival.outcomes(("figure-eight", 5)), strict=True))
    for title, one in found.items():
        assert one.refused == 0
        assert one.is_same == ("dropped" not in title), title
    # of the information 5 % is lost: sigma times the root of that, and 4.5 sigma of luck at most
    for title in ("5 % of the aids dropped", "5 % of all dropped"):
        assert 0.0 < np.abs(found[title].moved).max() < 4.5 * arrival.LOST**0.5 + 0.5


@cache
def drifts(kind: str, length: float) -> list[outages.Drift]:
    jobs = [(name, 20 * i + luck) for i, name in enumerate(SCENARIOS) for luck in range(4)]
    return [found[kind, length] for found in map(silenced, jobs)]


silenced = cache(outages.simulated)


@pytest.mark.parametrize("kind", consistency.KINDS)
@pytest.mark.parametrize("length", outages.LENGTHS)
def test_the_drift_of_an_outage_is_covered(kind, length):
    found = drifts(kind, length)
    least = binom.ppf(1.0 - SURE, len(found), outages.COVERED)
    assert sum(one[2] for one in found) >= least
    assert sum(one[3] for one in found) >= least


def test_an_outage_of_ten_seconds_costs_metres():
    assert max(one[0] for one in drifts("default", 10.0)) < 6.0
    assert max(one[1] for one in drifts("default", 60.0)) < 2.0


def test_an_outage_takes_the_fixes_and_nothing_else():
    flown = fly("hover", 1, duration=20.0)
    start_ns = flown.flight.first_ns + 5_000_000_000
    left = outages.cut(flown.events, start_ns, 10.0)
    assert len(flown.events) - len(left) == 50
    during = (left.t_ns >= start_ns) & (left.t_ns < start_ns + 10_000_000_000)
    assert Kind.GNSS not in left.kind[during]


@cache
def told_to(name: str) -> dict[str, lies.Outcome]:
    flown = fly(name, 7, duration=lies.DURATION)
    chosen = (lies.LIES[0], lies.LIES[2], lies.LIES[6], lies.LIES[8])
    return {lie.title: lies.outcome(flown, lie) for lie in chosen}


@pytest.mark.parametrize("name", ["hover", "loiter"])
def test_single_wild_fixes_move_nothing(name):
    wild = told_to(name)["one wild fix every 3 s, 60 s"]
    assert wild.largest < 3.0
    assert wild.resets == 0
    assert wild.refused <= 0.4


@pytest.mark.parametrize("name", ["hover", "loiter"])
def test_a_receiver_that_says_it_is_spoofed_is_not_followed(name):
    spoofed = told_to(name)["jump of 300 m, flagged as spoofed, 20 s"]
    assert spoofed.largest < 25.0
    assert spoofed.warned < 3.0
    assert spoofed.resets == 0
    assert spoofed.recovered < 5.0


@pytest.mark.parametrize("name", ["hover", "loiter"])
def test_a_jump_is_noticed_at_once_and_left_when_it_is_over(name):
    jump = told_to(name)["jump of 300 m, back after 20 s"]
    assert jump.refused <= 0.4
    assert jump.warned < 3.0
    assert jump.recovered < 10.0


def test_a_lie_changes_fixes_from_its_begin_to_its_end_only():
    flown = fly("hover", 2, duration=120.0)
    for lie in lies.LIES:
        if lie.length > 40.0 or "no velocity" in lie.title:
            continue
        told = lies.told(flown, lie)
        changed = (told.values != flown.events.values) & ~np.isnan(told.values)
        rows = np.flatnonzero(changed.any(axis=1))
        t = (told.t_ns[rows] - flown.flight.first_ns) * 1e-9 - lies.BEGIN
        assert (told.kind[rows] == Kind.GNSS).all(), lie.title
        assert 0.0 <= t.min() < 0.5, lie.title
        assert lie.length - 0.5 < t.max() < lie.length, lie.title


def test_when_all_is_good_again_is_told_to_the_sample():
    t = np.arange(-2.0, 5.0)
    assert lies.settled(t, t >= 0.0) == 0.0
    assert lies.settled(t, t != 1.0) == 2.0
    assert lies.settled(t, t < 4.0) == np.inf
    assert lies.settled(t - 10.0, t > 0.0) == np.inf
    assert lies.spread([1.0, 2.0, np.inf], 1) == "2.0 (never in 1 of 3)"
    assert lies.spread([np.inf, np.inf, 1.0], 1) == "never in 2 of 3"
    assert lies.spread([np.inf], 1) == "never"


def test_a_compass_that_falls_silent_leaves_the_yaw_to_the_fixes():
    flown = fly("figure-eight", 4)
    found = compassless.outcome(flown, compassless.silent_later(flown))
    assert found.fine < 5.0
    assert found.resets == 0


def test_a_compass_that_was_wrong_at_first_is_mended():
    flown = fly("figure-eight", 4)
    events = compassless.reversed_at_first(flown)
    is_mag = events.kind == Kind.MAG
    turned = (events.values != flown.events.values)[is_mag].any(axis=1)
    assert np.flatnonzero(turned).tolist() == list(range(1500))  # 30 s of 50 Hz
    found = compassless.outcome(flown, events)
    assert found.coarse < 20.0
    assert found.resets == 1


@needs_seed
def test_the_seeds_flight_is_within_its_limits():
    found = seed.ours(seed_flight.truth(DATA), seed_flight.draw_42(DATA))
    assert (found <= seed.LIMITS).all(), dict(zip(seed_flight.NAMES, found, strict=True))


@needs_seed
def test_the_seeds_recipe_is_understood():
    motion, drawn = seed_flight.truth(DATA), seed_flight.draw_42(DATA)
    for said, true, sigma in (
        (drawn.gyro_b, motion.rate_b, seed_flight.GYRO_NOISE),
        (drawn.accel_b, motion.force_b, seed_flight.ACCEL_NOISE),
    ):
        white = (said - true).std(axis=0)
        np.testing.assert_allclose(white, sigma, rtol=0.05)  # 4001 samples: 4.5 sigma
    assert drawn.mag_b is not None
    across = (drawn.mag_b - motion.field_b)[:, 2].std()
    assert across == pytest.approx(seed_flight.MAG_STD, rel=0.05)


@needs_seed
def test_the_reference_reaches_its_bound():
    motion = seed_flight.truth(DATA)
    bound = seed.bound(motion, "vector")
    found = [seed.reference(motion, seed_flight.draw(motion, i), "vector") for i in range(3)]
    # the RMSE of one flight varies by 15 % at the most; of three by 9 %
    ratio = np.sqrt(np.mean(np.square(found), axis=0)) / bound
    assert (ratio < 1.35).all()
    assert (ratio > 0.7).all()


@needs_seed
def test_the_bound_falls_with_what_is_measured():
    motion = seed_flight.truth(DATA)
    vector, azimuth = (Reference(motion, which).bound()[-1] for which in ("vector", "azimuth"))
    assert (vector < azimuth + 1e-12).all()
    assert vector[0] < 0.95 * azimuth[0]


def test_a_campaign_goes_between_its_marks(monkeypatch, tmp_path):
    document = tmp_path / "doc.md"
    document.write_text("a\n<!-- arrival -->\nold\n<!-- end -->\nb\n", encoding="utf-8")
    command = ["accuracy", "--data", str(tmp_path), "--only", "arrival", "--runs", "1"]
    monkeypatch.setattr("sys.argv", [*command, "--write", str(document)])
    accuracy.main()
    text = document.read_text(encoding="utf-8")
    assert "| a third duplicated | 4 of 4 |" in text
    assert "old" not in text
    assert text.startswith("a\n<!-- arrival -->\n| arrivals |")
    assert text.endswith("<!-- end -->\nb\n")


def test_an_unknown_part_is_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["accuracy", "--only", "arival"])
    with pytest.raises(SystemExit):
        accuracy.main()
    assert "arival" in capsys.readouterr().err
