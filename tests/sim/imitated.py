"""Flights with a personality's habits, and what it sends in them."""

import dataclasses
import functools

import numpy as np

from sim_autopilot.config import SimConfig
from sim_autopilot.faults.fault import parse as fault
from sim_autopilot.firmware import PERSONALITIES, parse
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench, StreamRequester
from tests.sim.wire import read

START = 15.0
"""Seconds into the scenario at which the flights of these tests begin: in motion."""


@functools.cache
def planned(name, duration=6.0, quiet=False, rate=None):
    """Plan a flight with a personality's rates and delays."""
    numbers = PERSONALITIES[name].suited(SimConfig())
    imu = {} if rate is None else {"rate": rate}
    if quiet:
        imu |= {"gyro_noise": 0.0, "gyro_bias_instability": 0.0, "gyro_bias_start": 0.0}
    numbers = dataclasses.replace(numbers, imu=dataclasses.replace(numbers.imu, **imu))
    return Flight.plan("figure-eight", numbers, duration=duration, skip=START)


@functools.cache
def cycles(name, duration=6.0):
    return list(planned(name, duration).cycles())


@functools.cache
def flown(text, rates=(), duration=6.0, faults=(), rate=None):
    """Return the messages of an autopilot that was asked for some, and the bench."""
    personality = parse(text)
    peer = StreamRequester(dict(rates)) if rates else None
    flight = planned(personality.name, duration, rate=rate)
    bench = Bench(flight, peer, personality=personality, faults=[fault(f) for f in faults])
    return read(frame for _, frame in bench.frames()), bench


def run(autopilot, cycles):
    """Return the messages of some cycles, and their bytes in all."""
    frames = []
    for cycle in cycles:
        autopilot.cycle(cycle)
        frames += autopilot.data_to_send()
    return read(frames), sum(map(len, frames))


def stamps(messages):
    return np.array([message.time_usec for message in messages])


FULL = (
    ("HIGHRES_IMU", 250.0),
    ("GPS_RAW_INT", 10.0),
    ("ATTITUDE", 10.0),
    ("GPS_GLOBAL_ORIGIN", 1.0),
)
