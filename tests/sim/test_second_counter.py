"""A second source of poses beside ours: whose the autopilot takes, by the reset counter of each."""

import numpy as np
import pytest

from ekf_companion.mavlink.reset_counter import ResetCounter
from sim_autopilot.closed_loop import SETS
from sim_autopilot.ekf3 import Ekf3
from sim_autopilot.personality import Kind
from tests.sim.test_follower import message

DT = 0.0025
OURS = 30.0
"""Hz."""
EXTERNAL = {f"EK3_SRC1_{part}": 6.0 for part in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")}
THEIRS = (0.0, 2.8, 12.0)
"""What the other says while the vehicle is at home and ours says so, m."""
NS = 1_000_000_000


class Flight:
    """EKF3 that is fed by both, and the counter that ours bears."""

    def __init__(self, rate, phase, *, counter=0, place=THEIRS, is_shared=True, delay=0.003):
        self.own = Ekf3({**SETS[Kind.ARDUPILOT], **EXTERNAL})
        self.own.set_origin(0.8, 0.15, 488.0)
        self.rate, self.phase, self.counter, self.place = rate, phase, counter, np.array(place)
        self.shared = ResetCounter() if is_shared else None
        self.delay = delay
        """s, on the way to us."""
        self.usual = 1
        self.t, self.errors, self.times = 0.0, [], []
        self.heard = []
        self.apart = 0.0

    def run(self, seconds, other=True):
        own, begin = self.own, self.t
        while self.t < begin + seconds:
            before, self.t = self.t, self.t + DT
            own.sample(self.t, np.zeros(3), np.array([0.0, 0.0, -9.80665]))
            if round(self.t / DT) % 16 == 0:
                own.baro(self.t, 0.0)
            if other and self._is_due(before, self.rate, self.phase):
                count = self.counter() if callable(self.counter) else self.counter
                own.odometry(message(self.t, pos_n=self.place, counter=count), self.t)
                self.heard.append((self.t + self.delay, count))
            while self.heard and self.heard[0][0] <= self.t and self.shared is not None:
                heard, count = self.heard.pop(0)
                self.shared.on_other(count, round(heard * NS))
            if self._is_due(before, OURS, 0.0):
                count = self.usual
                if self.shared is not None:
                    # The autopilot's position is compared with ours; a second apart is told
                    is_followed = self.apart < 1.0
                    now_ns, way_ns = round(self.t * NS), round(self.delay * NS)
                    count = self.shared.choose(count, now_ns, way_ns, is_followed=is_followed)
                own.odometry(message(self.t, counter=count), self.t)
            error = abs(own.pos_n).max()
            self.apart = self.apart + DT if error > 1.4 else 0.0
            self.errors.append(error)
            self.times.append(self.t)
        return self

    def _is_due(self, before, rate, phase):
        return int(self.t * rate + phase) > int(before * rate + phase)

    def share_of_it(self, since):
        """Return for which share of the time it was further from ours than a metre."""
        errors, times = np.array(self.errors), np.array(self.times)
        return float((errors[times > since] > 1.0).mean())


PHASES = (0.0, 0.13, 0.29, 0.5, 0.71, 0.97)


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("rate", [5.0, 10.0, 14.7, 20.0, 23.3])
def test_a_slower_source_that_never_resets_is_refused_within_moments(rate, phase):
    flight = Flight(rate, phase).run(3.0, other=False).run(10.0)
    assert flight.share_of_it(5.0) < 0.25
    assert flight.share_of_it(9.0) == 0.0


def test_with_a_counter_of_its_own_ours_takes_turns_with_it():
    flight = Flight(20.0, 0.3, is_shared=False).run(3.0, other=False).run(10.0)
    assert flight.share_of_it(9.0) > 0.1


@pytest.mark.parametrize("phase", PHASES)
def test_a_jump_of_ours_meanwhile_is_told_and_does_not_bring_it_to_the_other(phase):
    flight = Flight(20.0, phase).run(3.0, other=False).run(6.0)
    flight.usual = 2
    flight.run(6.0)
    assert flight.share_of_it(12.0) == 0.0


@pytest.mark.parametrize("counter", [0, 1, 2, 7, 255])
def test_whatever_its_counter_is(counter):
    flight = Flight(20.0, 0.4, counter=counter).run(3.0, other=False).run(8.0)
    assert flight.share_of_it(8.0) == 0.0


def test_one_whose_counter_moves_is_followed_for_a_moment_each_time():
    counts = iter(range(1, 1000))
    held = {"n": 0, "at": 0}

    def counter():
        held["at"] += 1
        if held["at"] % 60 == 1:
            held["n"] = next(counts)
        return held["n"]

    flight = Flight(20.0, 0.4, counter=counter).run(3.0, other=False).run(12.0)
    assert flight.share_of_it(4.0) < 0.2


def test_when_the_other_has_gone_ours_goes_on_without_a_jump():
    counter = ResetCounter()
    said = [counter.choose(3, 0)]
    for k in (1, 6, 11):
        counter.on_other(0, NS * k // 100)
        said.append(counter.choose(3, NS * (k + 1) // 100))
    said += [counter.choose(3, NS * k // 100) for k in (15, 18)]
    counter.forget_other()
    said += [counter.choose(3, NS), counter.choose(4, 2 * NS)]
    assert said == [3, 3, 3, 3, 0, 0, 0, 4]


def test_without_another_it_is_what_it_always_was():
    counter = ResetCounter()
    usual = [1, 1, 2, 2, 5, 255, 1, 1]
    assert [counter.choose(one, 0, is_followed=False) for one in usual] == usual
