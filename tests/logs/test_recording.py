"""A recording as a user of Python meets it."""

import numpy as np
import pytest

from ekf_companion.logs.recording import UNDAMAGED, Damage, Recording, dropped, misfits
from ekf_companion.nav.measurements import WIDTH, Events, Kind
from ekf_companion.nav.state import Trajectory


def test_a_recording_is_shown_in_one_line():
    """It was two thousand lines of numbers."""
    t_ns = np.arange(900, dtype=np.int64) * 10_000_000
    kind = np.where(np.arange(900) % 3, Kind.IMU, Kind.MAG)
    log = Recording(
        family="px4",
        events=Events(t_ns=t_ns, kind=kind, values=np.zeros((900, WIDTH))),
        truth=Trajectory(name="mocap", att_t_ns=t_ns, q_nb=np.zeros((900, 4))),
        notes=("one",),
    )
    assert repr(log) == (
        "<Recording: px4; <Events: 900 in 9.0 s; mag 300, imu 600>; "
        "truth <Trajectory mocap: 0 positions, 0 velocities, 900 attitudes>; 1 note>"
    )


@pytest.mark.parametrize(
    ("lost", "words"),
    [(1, "1 row with a wrong time was dropped"), (2, "2 rows with a wrong time were dropped")],
)
def test_one_row_is_one_row(lost, words):
    assert misfits(lost, 100, "with a wrong time") == [words]
    assert dropped(lost, 100).words == words.partition(" with")[0] + " dropped"


def test_damage_beside_no_damage_is_that():
    cut = Damage("cut off", 0.1)
    assert cut.beside(UNDAMAGED) == cut == UNDAMAGED.beside(cut)
    assert cut.beside(dropped(3, 10)) == Damage("cut off, 3 rows dropped", 0.3)
