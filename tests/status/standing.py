"""A vehicle that stands, with what is wrong with it, and the verdict on it before take-off."""

from dataclasses import replace

from ekf_companion.mavlink.messages import IDS
from ekf_companion.status.preflight import check
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import ImuConfig, SimConfig, StreamConfig
from sim_autopilot.faults.fault import parse
from sim_autopilot.faults.sensors import SensorFaults
from sim_autopilot.flight import Flight
from tests.status.test_observer import MS, Watched

OPEN = object()
IMU = ImuConfig(rate=100.0)
"""The verdict is the same at any rate that is enough."""
WHOLE = "duration=60"
NO_SATELLITES = f"gnss-outage:how=nofix,{WHOLE}"
NO_COMPASS_FIELD = f"mag-disturbance:{WHOLE},forward=0.5"


def stand(*faults, duration=12.5, config=None, scenario="static", silent=(), **options):
    """Return a companion beside an autopilot that stands, with what is wrong with it.

    ``silent`` are messages that the autopilot does not have.
    """
    watched = Watched(config=config)
    streams = StreamConfig(**dict.fromkeys(silent, 0.0))
    sim = SimConfig(imu=IMU, streams=streams, **options)
    flight = Flight.plan(scenario, sim, duration=duration)
    autopilot = Autopilot(sim)
    wrong = SensorFaults([parse(one) for one in faults], flight.first_ns - flight.period_ns)
    for cycle in map(wrong.apply, flight.cycles()):
        autopilot.cycle(cycle)
        frames = [one for one in autopilot.data_to_send() if not is_of(one, silent)]
        said = watched._turn(cycle.t_ns, b"".join(frames))
        autopilot.receive(b"".join(said), cycle.t_ns)
    watched.link._port = OPEN
    return watched


def is_of(frame, names):
    return int.from_bytes(frame[7:10], "little") in {IDS[name] for name in names}


def wait(watched, seconds):
    """Let time pass in which nothing comes."""
    for _ in range(round(10 * seconds)):
        watched.now_ns += 100 * MS
        watched.observer.tick(watched.now_ns)
    return watched


def verdict(watched):
    return watched.snapshot().preflight


def changed(snapshot, **vehicle):
    """Return the verdict on a snapshot with another estimate of the vehicle."""
    return check(replace(snapshot, vehicle=replace(snapshot.vehicle, **vehicle)))


def answered(snapshot, **autopilot):
    """Return the verdict on a snapshot in which the autopilot says something else."""
    return changed(snapshot, autopilot=replace(snapshot.vehicle.autopilot, **autopilot))
