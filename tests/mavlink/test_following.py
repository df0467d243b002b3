"""Whether the autopilot follows ODOMETRY: named within three seconds, and never without need."""

import math

import numpy as np
import pytest

from ekf_companion.mavlink.decision import Decision
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import FollowingChanged, PeerFound
from ekf_companion.mavlink.following import Following, Separation

SECOND_NS = 1_000_000_000
FUSED = Decision(is_streaming=True, reason="", is_fused=True, parameters={"VISO_TYPE": 1.0})
CHOICE = Decision(
    is_streaming=True, reason="", is_fused=True, is_alternative=True, parameters={"VISO_TYPE": 1.0}
)


class Watched:
    """A monitor, and what it has said and when (s)."""

    def __init__(self, family=Family.ARDUPILOT, decision=FUSED, withholds=False):
        self.said, self.t = [], 0.0
        self.decision, self.is_sent = decision, True
        self.following = Following(
            self.emit, lambda: self.decision, lambda: self.is_sent, withholds=withholds
        )
        self.following.begin(PeerFound(1, 1, family))

    def emit(self, event):
        assert type(event) is FollowingChanged
        self.said.append((round(self.t, 1), event.apart))

    def fly(self, seconds, at, is_running=True):
        """Compare five times a second; ``at`` gives a separation's fields at a time from here."""
        begin = self.t
        while self.t < begin + seconds:
            fields = at(self.t - begin)
            fields = {"pos_n": (0.0, 0.0, 0.0), "vel_n": (0.0, 0.0, 0.0), "yaw": 0.0, **fields}
            separation = Separation(t_ns=round(self.t * SECOND_NS), **fields)
            self.following.judge(separation, is_running=is_running)
            self.t += 0.2
        return self


def off(north=0.0, east=0.0, down=0.0, **fields):
    return lambda _: {"pos_n": (north, east, down), **fields}


NEAR = off(0.1, -0.1, 0.1)
FAULTS = {
    "it rejects ours and drifts at 1 m/s": lambda t: {"pos_n": (t, 0.0, 0.0)},
    "it lags a second behind at 5 m/s": off(-5.0, moving=(5.0, 0.0)),
    "another source pulls it 2.8 m away": off(2.0, 2.0),
    "it is 4.6 m too high": off(down=-4.6),
    "its velocity is wrong": off(vel_n=(1.5, 0.0, 0.0)),
    "its yaw is wrong": off(yaw=math.radians(-40.0)),
    "it is 925 m away": off(925.0, 0.0),
    "two sources are fused by turns": lambda t: {"pos_n": (2.8 * (round(5 * t) % 5 < 2), 0.0, 0.0)},
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("decision", [FUSED, CHOICE])
def test_a_fault_is_named_within_three_seconds(fault, decision):
    watched = Watched(decision=decision).fly(20.0, NEAR)
    assert watched.said == []
    watched.fly(4.0, FAULTS[fault])
    if decision is CHOICE and "too high" in fault:
        assert watched.said == []  # its own barometer's datum is taken up
        return
    (t, apart), *_ = watched.said
    assert t <= 23.0
    assert apart
    watched.fly(4.0, NEAR)
    assert watched.said[-1][1] == ""


def test_px4_keeps_an_offset_which_is_none_of_its_faults():
    watched = Watched(Family.PX4).fly(30.0, off(3.0, -4.0, 489.0))
    assert watched.said == []
    watched.fly(3.0, off(6.0, -4.0, 489.0))
    assert [apart for _, apart in watched.said] == ["3.0 m off"]


@pytest.mark.parametrize(
    "usual",
    [
        off(0.8, 0.6),
        off(-0.9, 0.0, moving=(30.0, 0.0)),  # 30 ms late at 30 m/s
        off(vel_n=(0.6, 0.0, 0.0), turning=8.0),
        off(yaw=math.radians(8.0)),
    ],
)
def test_what_is_usual_is_not_named_in_ten_minutes(usual):
    assert Watched().fly(600.0, usual).said == []


def test_noise_and_single_outliers_are_not_named():
    rng = np.random.default_rng(3)

    def at(t):
        away = 5.0 if rng.random() < 0.02 else 0.0
        return {"pos_n": (*rng.normal(0.0, 0.4, 2) + away, rng.normal(0.0, 0.3))}

    assert Watched().fly(600.0, at).said == []


@pytest.mark.parametrize(
    "decision", [Decision(is_streaming=True, reason="", parameters={"VISO_TYPE": 0.0}), CHOICE]
)
def test_who_is_on_its_own_receiver_is_not_watched(decision):
    assert Watched(decision=decision).fly(60.0, off(20.0)).said == []


def test_while_nothing_is_sent_and_just_after_nothing_is_named():
    watched = Watched()
    watched.is_sent = False
    watched.fly(20.0, off(20.0))
    watched.is_sent = True
    watched.fly(2.0, off(20.0)).fly(10.0, NEAR)
    watched.fly(10.0, off(30.0), is_running=False)
    assert watched.said == []
    watched.following.note_jump()
    watched.fly(2.0, off(20.0)).fly(10.0, NEAR)
    assert watched.said == []


def test_odometry_is_held_back_only_where_that_is_asked_for():
    for withholds in (False, True):
        watched = Watched(withholds=withholds).fly(20.0, NEAR).fly(4.0, off(9.0))
        assert (watched.following.hold is not None) is withholds
        watched.is_sent = not withholds  # the session withholds by that hold
        watched.fly(4.0, NEAR)
        assert watched.following.hold is None


def test_the_lag_is_measured_along_the_way():
    watched = Watched().fly(10.0, off(-0.75, 0.0, moving=(5.0, 0.0)))
    assert watched.following.state.lag == pytest.approx(0.15)
