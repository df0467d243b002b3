"""Simulated flights as recordings, for the calibrations' tests."""

from dataclasses import replace
from functools import cache

from ekf_companion.logs.recording import Recording
from ekf_companion.nav.measurements import Events, Kind
from sim_autopilot import events as wire
from sim_autopilot.config import CompassConfig, GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight


@cache
def fly(
    name: str,
    duration: float,
    imu: ImuConfig | None = None,
    gnss: GnssConfig | None = None,
    compass: CompassConfig | None = None,
    seed: int = 1,
) -> Recording:
    """Return a flight, its fixes with vertical velocity."""
    config = SimConfig(
        imu=imu or ImuConfig(rate=50.0),
        gnss=gnss or GnssConfig(),
        compass=compass or CompassConfig(),
    )
    flown = Flight.plan(name, config, seed=seed, duration=duration)
    return Recording(family="unknown", events=wire.events(flown, has_vel_down=True))


def without(recording: Recording, *kinds: Kind) -> Recording:
    """Leave out some kinds of events."""
    events = recording.events
    return replace(
        recording, events=events.take(~(events.kind[:, None] == list(kinds)).any(axis=1))
    )


def joined(recording: Recording, *others: Events) -> Recording:
    """Put other events at their places in time."""
    from ekf_companion.nav.measurements import merge

    return replace(recording, events=merge(recording.events, *others))
