"""A simulated motion whose fixes are gone for a while, and how far the estimate is off then."""

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.logs.recording import Recording
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Trajectory
from ekf_companion.replay.filters_by_name import run_filter

CUT = (70.0, 130.0)
"""Without fixes, s."""


class Cut:
    """A motion with a sensor that holds the velocity, and its truth."""

    sensor: Kind

    def __init__(self, events: Events, truth: Trajectory):
        self.events, self.truth = events, truth
        self.zero_ns = int(events.t_ns.min())

    def estimate(self, settings=None, change=None, cut=CUT):
        """Return the times, s, the table, and the horizontal error and its sigma, m."""
        events = self.events
        t = (events.t_ns - self.zero_ns) * 1e-9
        if change is not None:
            is_sensor, values = events.kind == self.sensor, events.values.copy()
            values[is_sensor, 0] = change(t[is_sensor], values[is_sensor, 0])
            events = Events(t_ns=events.t_ns, kind=events.kind, values=values)
        if cut is not None:
            events = events.take(~((events.kind == Kind.GNSS) & (t > cut[0]) & (t < cut[1])))
        recording = Recording(family="ardupilot", events=events)
        self.solution = run_filter(recording, "eskf", settings or FilterSettings())
        table = self.solution.table
        lat, lon = (
            np.interp(table.stamp_ns, self.truth.pos_t_ns, one)
            for one in (self.truth.lat, self.truth.lon)
        )
        off = np.hypot(
            np.radians(table.column("lat_deg")) - lat,
            (np.radians(table.column("lon_deg")) - lon) * np.cos(lat),
        )
        sigma = np.hypot(table.column("sd_pos_n"), table.column("sd_pos_e"))
        return (table.stamp_ns - self.zero_ns) * 1e-9, table, 6.37e6 * off, sigma
