import numpy as np

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav.measurements import Kind
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.events import events, truth
from sim_autopilot.flight import Flight

CONFIG = SimConfig()
FLIGHT = Flight.plan("figure-eight", CONFIG, duration=12.0)


def test_events_say_what_the_wire_says():
    table = events(FLIGHT)
    autopilot = Autopilot(CONFIG)
    for cycle in FLIGHT.cycles():
        autopilot.cycle(cycle)
    frames = Splitter().feed(b"".join(autopilot.data_to_send()))
    imu = [unpack(frame) for frame in frames if frame.message_id == IDS["HIGHRES_IMU"]]
    fixes = [unpack(frame) for frame in frames if frame.message_id == IDS["GPS_RAW_INT"]]

    ours = table.take(table.kind == Kind.IMU)
    assert ours.t_ns.tolist() == [message.time_usec * 1000 for message in imu]
    # float32 on the wire
    np.testing.assert_allclose(ours.values[:, 5], [m.zacc for m in imu], rtol=1e-6)
    ours = table.take(table.kind == Kind.GNSS)
    assert ours.t_ns.tolist() == [message.time_usec * 1000 for message in fixes]
    # 1e-7 degrees on the wire
    np.testing.assert_allclose(np.degrees(ours.values[:, 0]) * 1e7, [m.lat for m in fixes], atol=1)
    assert np.isnan(ours.values[:, 5]).all()
    assert np.isfinite(
        events(FLIGHT, has_vel_down=True).take(table.kind == Kind.GNSS).values[:, 5]
    ).all()
    assert (np.diff(table.t_ns) >= 0).all()


def test_the_truth_of_a_flight_is_its_motion():
    trajectory = truth(FLIGHT)
    motion = FLIGHT.truth_at(trajectory.pos_t_ns)
    np.testing.assert_allclose(trajectory.vel_n, motion.vel_n, atol=1e-9)  # rounding of the times
    assert len(trajectory.q_nb) == len(FLIGHT) == 3000
