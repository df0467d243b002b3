"""Bands of the status, which add up to the time that was estimated."""

import numpy as np
import pytest

from ekf_companion.analysis.status_bands import NO_SAMPLES, bands, joined
from ekf_companion.nav.state import COLUMNS, Status, Table


def table(t_s, status, columns=COLUMNS):
    values = np.zeros((len(t_s), len(columns) - 1))
    found = Table(stamp_ns=np.rint(np.asarray(t_s) * 1e9).astype(np.int64), values=values)
    found.column("status")[:] = status
    return found


def by_name(found):
    return {one.name: one for one in found}


def test_bands_begin_and_end_where_the_status_changes_and_add_up():
    t_s = np.arange(0.0, 30.0, 0.1)
    status = np.where(
        t_s < 9.95, Status.ATTITUDE, np.where(t_s < 24.95, Status.OK, Status.DEGRADED)
    )
    found = by_name(bands(table(t_s, status)))
    assert [*found] == ["attitude", "ok", "degraded"]
    assert found["ok"].spans_ns == ((10_000_000_000, 25_000_000_000),)
    assert sum(one.seconds for one in found.values()) == pytest.approx(29.9)


def test_a_time_without_samples_is_a_band_and_of_no_status():
    t_s = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(25.0, 30.0, 0.1)])
    found = by_name(bands(table(t_s, Status.OK)))
    assert len(found["ok"].spans_ns) == 2
    assert found["ok"].seconds == pytest.approx(9.9 + 4.9)
    assert found[NO_SAMPLES].spans_ns == ((9_900_000_000, 25_000_000_000),)
    assert found[NO_SAMPLES].status is None


@pytest.mark.parametrize("count", [0, 1, 2])
def test_hardly_a_row_makes_hardly_a_band(count):
    found = bands(table(np.arange(count) * 0.1, Status.OK))
    assert len(found) == min(count, 1)


def test_status_that_flickers_is_drawn_as_few_bands():
    t_s = np.arange(0.0, 1000.0, 0.01)
    flicker = np.where(np.arange(len(t_s)) % 2, Status.OK, Status.DEGRADED)
    one = by_name(bands(table(t_s, flicker)))["ok"]
    assert len(one.spans_ns) == len(t_s) // 2
    assert one.seconds == pytest.approx(500.0, abs=1.0)
    assert len(joined(one.spans_ns, 1_000_000_000)) == 1
