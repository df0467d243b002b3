import tempfile

import numpy as np
import pytest

from ekf_companion.errors import LogError
from ekf_companion.logs.spool import Spool


@pytest.mark.parametrize("in_memory", [1 << 20, 64])
def test_rows_come_back_to_the_bit_in_any_order(in_memory):
    rows = np.random.default_rng(1).normal(0.0, 1.0, (100, 7))
    rows[3, 2] = np.nan
    rows.view(np.int64)[5, 0] = 2**62 + 1
    with Spool(7, in_memory) as spool:
        for part in (rows[:10], rows[10:10], rows[10:70]):
            spool.append(part)
        assert spool.read(60, 10).tobytes() == rows[60:70].tobytes()
        spool.append(rows[70:])
        assert len(spool) == 100
        for first, count in ((95, 5), (0, 100), (3, 1), (50, 0)):
            assert spool.read(first, count).tobytes() == rows[first : first + count].tobytes()


def test_no_room_is_said_with_a_remedy(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    with Spool(3, in_memory=10) as spool, pytest.raises(LogError, match=r"nowhere.*TMPDIR"):
        spool.append(np.zeros((10, 3)))
