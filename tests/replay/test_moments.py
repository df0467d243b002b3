"""Times with zones, masked arrays, and what is said of rows."""

from datetime import datetime, timedelta, timezone
from typing import get_args

import numpy as np
import pytest

from ekf_companion import Stream
from ekf_companion.errors import DataError
from ekf_companion.replay.filters_by_name import FILTERS, FilterName
from tests.arrays.test_run import Flown

BEGIN = datetime(2026, 5, 4, 10, 0, tzinfo=timezone.utc)
ZURICH, DENVER = (timezone(timedelta(hours=hours)) for hours in (2, -6))


@pytest.fixture(scope="module")
def flown():
    return Flown(duration=12.0)


def dates(seconds, zone):
    return [(BEGIN + timedelta(seconds=float(one))).astimezone(zone) for one in seconds]


def test_times_of_any_zone_are_those_of_utc(flown):
    usual = flown.estimate(baro=None)
    zoned = flown.estimate(
        time=dates(flown.time, ZURICH),
        gnss={**flown.gnss, "time": dates(flown.gnss["time"], DENVER)},
        mag={**flown.mag, "time": dates(flown.mag["time"], timezone.utc)},
        baro=None,
    )
    assert zoned.t_ns[0] == round((BEGIN.timestamp() + float(flown.time[0])) * 1e9)
    # Of rounded stamps: a date has whole microseconds
    np.testing.assert_allclose(zoned.pos_n, usual.pos_n, atol=1e-2)


def test_pandas_times_with_a_zone_are_taken(flown):
    pandas = pytest.importorskip("pandas")
    times = pandas.Timestamp(BEGIN) + pandas.to_timedelta(np.rint(flown.time * 1e9), unit="ns")
    as_dates = flown.estimate(
        time=times.tz_convert("Europe/Zurich"), gnss=None, mag=None, baro=None
    )
    assert len(as_dates) == len(flown.time)
    series = flown.estimate(time=pandas.Series(times), gnss=None, mag=None, baro=None)
    assert np.array_equal(series.t_ns, as_dates.t_ns)


def test_times_with_and_without_a_zone_are_not_mixed(flown):
    mixed = dates(flown.time, ZURICH)
    mixed[3] = mixed[3].replace(tzinfo=None)
    with pytest.raises(DataError, match="time: some times name a zone and others do not"):
        flown.estimate(time=mixed)


def test_a_stream_takes_dates(flown):
    by_date, by_seconds = Stream(check=False), Stream(check=False)
    for row in range(50):
        at = BEGIN + timedelta(seconds=row / 50)
        found = by_date.imu(at, flown.gyro[row], flown.accel[row])
        by_seconds.imu(row / 50, flown.gyro[row], flown.accel[row])
    assert found is not None
    assert found.t_ns == round((BEGIN.timestamp() + 49 / 50) * 1e9)


@pytest.mark.parametrize("name", ["gyro", "accel"])
def test_masked_rows_are_not_used(flown, name):
    given = np.ma.array(getattr(flown, name), copy=True)
    given[100:130] = 1e3
    given[100:130] = np.ma.masked
    found = flown.estimate(**{name: given})
    assert found.dropped[name] == 30
    hidden = np.array(getattr(flown, name))
    hidden[100:130] = np.nan
    assert np.array_equal(flown.estimate(**{name: hidden}).table.values, found.table.values, True)


def test_masked_columns_of_tables_are_not_used(flown):
    alt = np.ma.array(flown.gnss["alt"], copy=True)
    alt[5:9] = np.ma.masked
    found = flown.estimate(gnss={**flown.gnss, "alt": alt})
    assert any("gnss.alt: 4 of " in note for note in found.notes)


def test_masked_times_are_refused(flown):
    time = np.ma.array(flown.time, copy=True)
    time[5] = np.ma.masked
    with pytest.raises(DataError, match="time: holds masked rows; leave such rows out"):
        flown.estimate(time=time)


def test_values_that_a_data_frame_lacks_are_not_used(flown):
    pandas = pytest.importorskip("pandas")
    alt = pandas.Series(flown.gnss["alt"], dtype="Float64")
    alt[5:9] = pandas.NA
    found = flown.estimate(gnss={**flown.gnss, "alt": alt})
    assert any("gnss.alt: 4 of " in note for note in found.notes)


def test_what_is_no_number_is_named(flown):
    with pytest.raises(DataError, match=r"gnss\.alt: holds something else than numbers"):
        flown.estimate(gnss={**flown.gnss, "alt": ["high"] * len(flown.gnss["alt"])})


def test_a_trajectory_shorter_than_the_arrays_says_so(flown):
    gyro = flown.gyro.copy()
    gyro[100:130] = np.nan
    found = flown.estimate(gyro=gyro)
    assert len(found) <= len(flown.time) - 30
    (note,) = [one for one in found.notes if "rows for" in one]
    assert note.startswith(f"the trajectory has {len(found)} rows for {len(flown.time)} times")
    assert not any("rows for" in one for one in flown.estimate().notes)


def test_the_names_of_filters_that_editors_know_are_those_that_there_are():
    with_options = [f"{name}:{one}" for name, found in FILTERS.items() for one in found.options]
    assert sorted(get_args(FilterName)) == sorted([*FILTERS, *with_options])
