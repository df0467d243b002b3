"""The seed article's flight."""

import numpy as np
import pytest

from benchmarks.accuracy import seed
from tests.paths import DATA

pytestmark = pytest.mark.skipif(
    not (DATA / seed.FOLDER).is_dir(), reason="the seed's flight is not here"
)


def test_it_is_within_its_limits():
    found = seed.ours(DATA)
    for (name, limit), error in zip(seed.LIMITS.items(), found, strict=True):
        assert error <= limit, name


def test_its_recipe_is_understood():
    motion, drawn = seed.truth(DATA), seed.draw_42(DATA)
    for samples, true, sigma in (
        (drawn.gyro_b, motion.rate_b, seed.GYRO_NOISE),
        (drawn.accel_b, motion.force_b, seed.ACCEL_NOISE),
    ):
        white = (samples - true).std(axis=0)
        np.testing.assert_allclose(white, sigma, rtol=0.05)  # 4001 samples: 4.5 sigma
    across = (drawn.mag_b - motion.field_b)[:, 2].std()
    assert across == pytest.approx(seed.MAG_STD, rel=0.05)
