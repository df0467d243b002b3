"""The simulated optical flow sensor: its convention, what it cannot see, its messages."""

import numpy as np
import pytest

from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Decoder, Family
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import FlowSample
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import FlowConfig, SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.personality import Kind

PERFECT = SimConfig(flow=FlowConfig(fitted=True, noise=0.0, scale=0.0))


def test_its_rates_less_the_turn_are_the_way_over_the_height():
    """The sum of (flow - gyro) height dt, turned by the yaw, is where it has flown to."""
    flight = Flight.plan("figure-eight", PERFECT, duration=30.0)
    data, dt = flight.flow, 1.0 / PERFECT.flow.rate
    seen = np.flatnonzero(data.quality > 0.0)
    middle = flight.trajectory.at(data.t - 0.5 * dt)
    up = so3.to_matrix(middle.q_nb)[:, 2, 2]
    height = (middle.alt - PERFECT.home.alt + PERFECT.range_finder.mounted) / up
    x, y = ((data.flow - data.gyro) * height[:, None]).T
    vel_b = so3.rotate(so3.conjugate(middle.q_nb), middle.vel_n)
    vel_n = so3.rotate(middle.q_nb, np.stack([y, -x, vel_b[:, 2]], axis=1))
    way = (vel_n[seen] * dt).sum(axis=0)
    ends = flight.trajectory.at(np.array([data.t[seen[0]] - dt, data.t[seen[-1]]])).pos_n
    assert np.ptp(middle.pos_n[:, 0]) > 10.0
    assert way[:2] == pytest.approx((ends[1] - ends[0])[:2], abs=0.15)


def test_on_the_ground_it_sees_nothing():
    data = Flight.plan("figure-eight", PERFECT, duration=30.0).flow
    assert not data.quality[:20].any()
    assert data.quality[-50:].all()


@pytest.mark.parametrize(
    ("kind", "family", "message"),
    [
        (Kind.PX4, Family.PX4, "OPTICAL_FLOW_RAD"),
        (Kind.ARDUPILOT, Family.ARDUPILOT, "OPTICAL_FLOW"),
    ],
)
def test_each_autopilot_sends_it_in_its_own_way(kind, family, message):
    config = SimConfig(flow=FlowConfig(fitted=True))
    flight = Flight.plan("hover", config, duration=10.0, skip=20.0)
    autopilot, decoder, found = Autopilot(config, kind), Decoder(family), []
    request = {"param1": float(IDS[message]), "param2": 50_000.0}
    asked = Sender(255, 190).message(
        "COMMAND_LONG", command=511, target_system=1, target_component=1, **request
    )
    autopilot.receive(asked, 0)
    for cycle in flight.cycles():
        autopilot.cycle(cycle)
    for frame in Splitter().feed(b"".join(autopilot.data_to_send())):
        found += [one for one in decoder.decode(frame) if isinstance(one, FlowSample)]
    rates = {(round(one.flow_x, 5), round(one.flow_y, 5)) for one in found}
    true = {(round(x, 5), round(y, 5)) for x, y in flight.flow.flow.tolist()}
    assert len(rates) > 80
    assert len(rates & true) > 0.95 * len(rates)
