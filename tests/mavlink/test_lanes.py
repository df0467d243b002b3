"""Several inertial units on a link: HIGHRES_IMU by id, RAW_IMU, SCALED_IMU2 and SCALED_IMU3."""

import numpy as np
import pytest

from ekf_companion.mavlink.decode import Family
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import ImuSample
from tests.mavlink.test_decode import Peer, only

BIAS = np.array([[0.0] * 6, [0.02, -0.01, 0.03, 0.1, -0.2, 0.15], [-0.01, 0.02, 0.0, 0.2, 0.1, 0]])
BEGIN = 9.0
"""When faults begin, s: a preferred message that is never sent is waited for 3 s."""
LATEST = 0.2
"""Within which a unit is left, s."""


class Vehicle:
    """Sends the samples of several units; the test says what becomes of them."""

    def __init__(self, family, messages, rates=(250, 250, 250)):
        self.peer = Peer(family)
        self.messages, self.rates = messages, rates
        self.fault = lambda number, t, values: values
        """What a unit reads; None: nothing is sent."""
        self._rng = np.random.default_rng(7)

    def fly(self, begin, end):
        """Return the samples that are used, with the time at which each came, s."""
        found = []
        for tick in range(round(begin * 500), round(end * 500)):
            t = tick / 500
            for number, (name, rate) in enumerate(zip(self.messages, self.rates, strict=False)):
                if (tick + number) % (500 // rate):
                    continue
                turn = 0.3 * np.sin([1.0 * t, 0.7 * t, 0.4 * t])
                values = np.concatenate([turn, 2.0 * turn + [0, 0, -9.81]]) + BIAS[number]
                values += self._rng.normal(0.0, 1.0, 6) * np.repeat([0.004, 0.05], 3)
                values = self.fault(number, t, values)
                if values is not None:
                    found += [(t, one) for one in self._say(name, number, t, values)]
        return found

    def _say(self, name, number, t, values):
        t_us = round(t * 1e6)
        if name == "HIGHRES_IMU":
            axes = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
            fields = dict(zip(axes, values.tolist(), strict=True))
            return only(ImuSample, self.peer.highres(t_us, id=number, **fields))
        scale = np.repeat([1e3, 1e3 / STANDARD_GRAVITY], 3)
        axes = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
        fields = dict(zip(axes, np.rint(values * scale).astype(int).tolist(), strict=True))
        stamp = {"time_usec": t_us} if name == "RAW_IMU" else {"time_boot_ms": t_us // 1000}
        return only(ImuSample, self.peer.say(name.lower(), **stamp, **fields))


LINKS = {
    "HIGHRES_IMU by id": (Family.PX4, ("HIGHRES_IMU",) * 3),
    "RAW_IMU, SCALED_IMU2, SCALED_IMU3": (
        Family.ARDUPILOT,
        ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3"),
    ),
    "HIGHRES_IMU, SCALED_IMU2": (Family.ARDUPILOT, ("HIGHRES_IMU", "SCALED_IMU2")),
}


@pytest.fixture(params=LINKS)
def vehicle(request):
    return Vehicle(*LINKS[request.param])


def freeze(number, t, values):
    if number == 0 and t >= BEGIN:
        return np.array([0.1, -0.2, 0.15, 0.3, 0.4, -9.7])
    return values


def step(number, t, values):
    return values + np.array([0, 0, 0, 1.0, 0, 0]) * (number == 0 and t >= BEGIN)


def silence(number, t, values):
    return None if number == 0 and t >= BEGIN else values


@pytest.mark.parametrize("fault", [freeze, step, silence])
def test_a_unit_that_fails_is_left_at_once_and_the_next_one_continues_it(vehicle, fault):
    before = vehicle.fly(2.0, BEGIN)
    vehicle.fault = fault
    after = vehicle.fly(BEGIN, BEGIN + 3.0)
    (at,) = [t for t, one in after if any(one[7:])]
    assert BEGIN <= at <= BEGIN + LATEST
    (note,) = [note for note in vehicle.peer.decoder.notes if "is used: 0 is" in note]
    assert note.startswith("Inertial sensor 1 is used")
    # The second's own bias is taken off
    t = np.array([one.t_ns for _, one in after if one.t_ns > (BEGIN + 0.3) * 1e9]) * 1e-9
    gyro_z = np.array([one.gyro_z for _, one in after if one.t_ns > (BEGIN + 0.3) * 1e9])
    assert abs(np.mean(gyro_z - 0.3 * np.sin(0.4 * t))) < 2e-3
    stamps = [one.t_ns for _, one in (*before[-9:], *after)]
    assert min(np.diff(stamps)) > 0
    assert max(np.diff(stamps)) < LATEST * 1e9


def test_the_first_unit_is_read_as_if_it_were_alone(vehicle):
    both = vehicle.fly(2.0, BEGIN)
    alone = Vehicle(vehicle.peer.decoder.family, vehicle.messages)
    alone.fault = lambda number, t, values: None if number else values
    settled = [one for t, one in both if t > 7.0]
    assert settled == [one for t, one in alone.fly(2.0, BEGIN) if t > 7.0]
    assert len(settled) > 400


def test_a_unit_that_stands_by_and_fails_is_named_once(vehicle):
    vehicle.fly(2.0, BEGIN)
    vehicle.fault = lambda number, t, values: freeze(number - 1, t, values)
    vehicle.fly(BEGIN, BEGIN + 2.0)
    found = [note for note in vehicle.peer.decoder.notes if "stands by" in note]
    assert found == ["Inertial sensor 1, which stands by, is stuck"]
    assert vehicle.peer.decoder.inertial.unit == 0


def test_a_unit_that_was_left_is_not_used_again_for_speaking_steadily(vehicle):
    vehicle.fly(2.0, BEGIN)
    vehicle.fault = lambda number, t, values: None if number == 0 and t < BEGIN + 2.0 else values
    vehicle.fly(BEGIN, BEGIN + 8.0)
    assert vehicle.peer.decoder.inertial.unit == 1


def test_a_unit_that_speaks_seldom_is_not_watched_for_long():
    vehicle = Vehicle(Family.ARDUPILOT, ("HIGHRES_IMU", "SCALED_IMU2"), rates=(250, 10))
    vehicle.fly(2.0, 8.0)
    assert not vehicle.peer.decoder.inertial.is_watching


def test_a_run_that_goes_on_from_another_uses_the_unit_that_was_in_use():
    vehicle = Vehicle(Family.PX4, ("HIGHRES_IMU",) * 2)
    vehicle.fly(2.0, BEGIN)
    vehicle.fault = freeze
    vehicle.fly(BEGIN, BEGIN + 2.0)
    inertial = vehicle.peer.decoder.inertial
    offset = inertial.lanes.offset
    following = Vehicle(Family.PX4, ("HIGHRES_IMU",) * 2)
    following.peer.decoder.inertial.resume(inertial.unit, offset)
    following.fault = freeze
    found = following.fly(BEGIN + 2.0, BEGIN + 6.0)
    assert following.peer.decoder.inertial.unit == 1
    t = np.array([one.t_ns for _, one in found]) * 1e-9
    gyro_z = np.array([one.gyro_z for _, one in found])
    assert abs(np.mean(gyro_z - 0.3 * np.sin(0.4 * t))) < 2e-3
    assert len(found) > 900


def test_a_slow_unit_stands_in_until_the_fast_one_measures_again():
    vehicle = Vehicle(Family.ARDUPILOT, ("HIGHRES_IMU", "SCALED_IMU2"), rates=(250, 10))
    vehicle.fly(2.0, BEGIN)
    vehicle.fault = lambda number, t, values: freeze(number, t, values) if t < 20.0 else values
    vehicle.fly(BEGIN, 20.0)
    assert vehicle.peer.decoder.inertial.unit == 1
    vehicle.fly(20.0, 33.0)
    assert vehicle.peer.decoder.inertial.unit == 0
