import math

import numpy as np
import pytest

from ekf_companion.nav.state import COLUMNS, WIND, Table
from ekf_companion.nav.wind import MeanWind


def estimates(*winds):
    values = np.full((len(winds), len(COLUMNS) - 1), np.nan)
    for name, column in zip(WIND, np.transpose(winds), strict=True):
        values[:, COLUMNS.index(name) - 1] = column
    return Table(stamp_ns=np.arange(len(winds)), values=values)


@pytest.mark.parametrize(
    ("wind", "words"),
    [
        ((0.0, 5.0), "5.0 m/s from 270 deg"),
        ((-3.0, 0.0), "3.0 m/s from 0 deg"),
        ((1.71, 4.7), "5.0 m/s from 250 deg"),
    ],
)
def test_a_wind_is_named_by_where_it_comes_from(wind, words):
    found = MeanWind()
    found.add(estimates(wind, (math.nan, math.nan)))
    found.add(estimates(wind))
    assert found.words == words
    assert found.count == 2


def test_what_nobody_knows_has_no_words():
    found = MeanWind()
    found.add(estimates((math.nan, math.nan)))
    assert found.words == ""
    assert math.isnan(found.speed)
