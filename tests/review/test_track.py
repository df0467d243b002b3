"""What is kept of an estimate to judge it by: sigmas, positions, fixes, restarts of the clock."""

import numpy as np
import pytest

from ekf_companion.nav.measurements import WIDTH, Events, Kind
from ekf_companion.nav.state import COLUMNS, Status, Table
from ekf_companion.review.stretches import PAUSE_NS, Stretches, of_events
from ekf_companion.review.track import Track

SECOND_NS = 1_000_000_000


def table_of(t_s, sigma=1.0, status=Status.OK, lat_deg=47.0):
    t_ns = np.rint(np.asarray(t_s) * SECOND_NS).astype(np.int64)
    values = np.full((len(t_ns), len(COLUMNS) - 1), np.nan)
    for name, value in {
        "lat_deg": lat_deg,
        "lon_deg": 8.0,
        "alt_m": 500.0,
        "sd_pos_n": np.asarray(sigma),
        "sd_pos_e": 0.0,
        "status": float(status),
    }.items():
        values[:, COLUMNS.index(name) - 1] = value
    return Table(stamp_ns=t_ns, values=values)


def events_of(rows):
    """Return events of (s, kind, latitude in rad)."""
    rows = list(rows)
    padding = [0.0] * (WIDTH - 1)
    made = [(round(t_s * SECOND_NS), kind, (lat, *padding)) for t_s, kind, lat in rows]
    return Events.from_rows(made)


NONE = events_of([])


def test_sigma_counts_over_the_whole_time_and_its_worst_moment_is_named():
    t_s = np.arange(100.0, 200.0, 0.02)
    sigma = np.where((t_s >= 140.0) & (t_s < 160.0), 10.0, 1.0)
    sigma[np.searchsorted(t_s, 155.05)] = 54.0
    track = Track()
    for half in (slice(0, 2000), slice(2000, None)):
        track.add(NONE, table_of(t_s[half], sigma[half]))
    size = track.sigma()
    assert np.median(sigma) == 1.0
    assert size.rms == pytest.approx(np.sqrt(0.2 * 100.0 + 0.8 * 1.0), rel=0.1)
    assert size.worst == 54.0
    assert size.at_s == pytest.approx(55.05, abs=0.1)


def test_an_estimate_that_says_it_is_invalid_is_not_judged_by():
    track = Track()
    track.add(NONE, table_of([0.0, 0.1, 0.2], sigma=1.0))
    track.add(NONE, table_of([12.2, 12.3], sigma=170.0, status=Status.INVALID, lat_deg=47.1))
    track.add(NONE, table_of([12.4, 12.5], sigma=1.4))
    assert track.sigma().worst == 1.4
    assert len(track.positions().pos_t_ns) == 5


def test_the_longest_time_without_samples_is_kept_over_blocks_and_reboots():
    assert Track().gap() == (0.0, 0.0)
    track = Track()
    track.add(NONE, table_of(np.arange(100.0, 130.0, 0.02)))
    track.add(NONE, table_of(np.arange(133.0, 140.0, 0.02)))  # behind 3 s, in the next block
    assert track.gap() == pytest.approx((3.02, 29.98))
    track.add(NONE, table_of([*np.arange(5.0, 10.0, 0.02), *np.arange(22.0, 30.0, 0.02)]))
    assert track.gap() == pytest.approx((12.02, 39.98 + 10.0 + 4.98))


def test_before_there_is_a_position_nothing_is_known():
    track = Track()
    track.add(NONE, table_of([0.0, 0.1], status=Status.ATTITUDE))
    assert track.sigma() is None
    assert len(track.positions().pos_t_ns) == 0


def test_a_reboot_begins_a_stretch_that_is_drawn_behind_the_one_before():
    track = Track()
    first, second = np.arange(50.0, 60.0, 0.1), np.arange(2.0, 42.0, 0.1)
    track.add(NONE, table_of(first, 1.0))
    track.add(NONE, table_of(second, np.where(second > 41.85, 9.0, 1.0), lat_deg=48.0))
    shifts = track.stretches.shifts_ns()
    assert (len(shifts), track.stretches.longest, shifts[0]) == (2, 1, 0)
    begins_ns = 2 * SECOND_NS + shifts[1]
    assert begins_ns == round(59.9 * SECOND_NS) + PAUSE_NS
    assert np.rad2deg(track.positions().lat) == pytest.approx(48.0)
    # 9.9 s of the first, the pause, and 39.9 s of the second
    assert track.sigma().at_s == pytest.approx(9.9 + 10.0 + 39.9, abs=0.15)


def test_events_behind_the_restart_of_a_block_are_of_the_next_stretch():
    fixes = events_of([(50.0, Kind.GNSS, 0.1), (0.0, Kind.RESTART, 0.0), (3.0, Kind.GNSS, 0.2)])
    assert of_events(fixes, 0, 1).tolist() == [0, 1, 1]
    track = Track()
    track.add(fixes, table_of([49.0, *np.arange(2.0, 9.0, 0.1)]))
    assert track.fixes(0.2).lat.tolist() == [0.2]
    assert track.fixes(0.2).pos_t_ns.tolist() == [2_800_000_000]


def test_a_stamp_that_is_a_little_early_begins_no_stretch():
    stretches = Stretches()
    assert stretches.add(np.array([5, 4, 6]) * SECOND_NS).tolist() == [0, 0, 0]
    assert len(stretches.found) == 1
