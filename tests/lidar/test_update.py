from __future__ import annotations

import numpy as np
import pytest

from ekf_companion.lidar.rows import Match, Sums
from ekf_companion.lidar.state import CALIBRATION, EXCESS, POSE, N, State
from ekf_companion.lidar.update import SEEN_WITH_MOUNTING, Anchor, correct, first


@pytest.mark.parametrize("axes", [0, 1])
def test_a_mounting_that_is_held_is_considered_as_its_gain_of_zero_says(axes):
    rng = np.random.default_rng(7)
    anchor, size = Anchor(0, 0.0, np.zeros(3)), first(1)
    columns = len(SEEN_WITH_MOUNTING)
    B = 1e-2 * rng.standard_normal((size, size))
    B[EXCESS] = 0.0
    P = B @ B.T
    # Planes have a share of the anchor's error
    share, scan = rng.uniform(0.0, 1.0, (200, 1)), rng.standard_normal((200, POSE))
    H = np.hstack([rng.standard_normal((200, columns)), share * scan, scan])
    z, R = rng.standard_normal(200), 0.3
    open_w = np.eye(3)[:, :axes]
    match = Match(200, open_w, np.ones(3), np.eye(3), np.ones(3), 1.0)
    sums = Sums(
        columns,
        np.zeros(1, dtype=np.int64),
        (H.T @ H / R)[None],
        (H.T @ z / R)[None],
        np.full(6, 1e-18),
        match,
        {0: 1.0},
    )
    found = correct(State(), P, lambda *_: sums, [anchor], 1, is_mounting_held=True)

    # Rows in all error states; those of the anchor are minus their share of the scan's as a whole
    rows = np.zeros((200, size))
    rows[:, SEEN_WITH_MOUNTING] = H[:, :columns]
    rows[:, first(0) : first(1)] = -share * scan
    gain = P @ rows.T @ np.linalg.inv(rows @ P @ rows.T + R * np.eye(200))
    gain[CALIBRATION] = gain[N:] = 0.0
    closed = np.eye(3) - open_w @ open_w.T
    if axes:
        gain[3:6], gain[6:9] = closed @ gain[3:6], closed @ gain[6:9]
        gain[12:17] = 0.0
    left = np.eye(size) - gain @ rows
    expected = left @ P @ left.T + gain @ gain.T * R
    change = found.state.minus(State())
    # What is reset about the new state is another thing
    plain = np.r_[3:15, CALIBRATION, first(0) : size]
    change = found.state.minus(State())
    assert np.allclose(change[3:15], (gain @ z)[3:15], atol=1e-9)
    assert not change[CALIBRATION].any()
    at = np.ix_(plain, plain)
    assert np.allclose(found.P[at], expected[at], atol=1e-9)
    assert np.linalg.eigvalsh(found.P)[0] > -1e-12
