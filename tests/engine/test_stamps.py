"""Inertial stamps that leap, and clocks that are set: no wrong estimate behind a small sigma.

The same flights are run from a table, sample by sample, over the wire, and from a recording.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ekf_companion.engine.companion import Companion
from ekf_companion.engine.health import Arrival
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import COLUMNS, Status
from ekf_companion.replay.run import Run
from sim_autopilot.autopilot import Kind as Firmware
from tests.core.flights import flight
from tests.engine.conversation import STREAMING, as_messages, cycles, named
from tests.engine.estimation import KNOWN

SECONDS, WIRE, FROM = 40.0, 34.0, 25.0
"""Length of a flight, of one over the wire, and when its stamps go wrong."""
ONCE = np.array([30.0])
EVERY_SECOND = np.arange(FROM, SECONDS - 1.0)
MOST_VELOCITY = 0.5
"""m/s; the clean flight is within 0.15."""

# Samples and tables


@cache
def flown():
    return flight("figure-eight", duration=SECONDS)


def stamped(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Events:
    """Return the flight with other stamps: those that are changed, s, by time and kind."""
    events, _ = flown()
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    by_ns = np.rint((change(t, events.kind) - t) * 1e6).astype(np.int64) * 1000
    return Events(t_ns=events.t_ns + by_ns, kind=events.kind, values=events.values)


def strays(ahead: float, at: np.ndarray) -> Events:
    """Return the flight with inertial samples that are stamped ahead at some times."""

    def change(t, kind):
        near = np.abs(t[:, None] - at).min(axis=1) < 0.0049
        return t + ahead * (near & (kind == Kind.IMU))

    return stamped(change)


def set_back(by: float) -> Events:
    """Return the flight with a clock that goes back once."""
    return stamped(lambda t, _: t - by * (t > FROM))


class Found:
    """Estimates sample by sample, against the truth when the sample was taken."""

    def __init__(self, events: Events) -> None:
        original, truth = flown()
        # all of the flight with other stamps, or a part of it with its own
        true_ns = original.t_ns if len(events) == len(original) else events.t_ns
        self.pipeline = Pipeline(KNOWN)
        self.stamps, values, taken_ns = [], [], []
        rows = zip(events.t_ns.tolist(), events.kind.tolist(), events.values, strict=True)
        for n, (t_ns, kind, row) in enumerate(rows):
            estimate = self.pipeline.process_row((t_ns, kind, tuple(row.tolist())))
            if estimate is not None:
                self.stamps.append(t_ns)
                values.append(estimate.values)
                taken_ns.append(true_ns[n])
        self.values = np.array(values)
        t = (np.array(taken_ns) - original.t_ns[0]) * 1e-9
        self.late = t > FROM
        at = np.searchsorted(truth.pos_t_ns, taken_ns)
        self.vel = self.values[:, 6:9] - truth.vel_n[at]
        self.sd_vel = self.values[:, 24:27]
        self.is_ok = self.values[:, COLUMNS.index("status") - 1] == Status.OK

    def count(self, arrival: Arrival) -> int:
        return self.pipeline.health().arrivals[Kind.IMU][arrival]


def judge(events: Events, least: float = 0.95) -> Found:
    """Run events, and check that all that is called OK is right, and at least a share is OK."""
    found = Found(events)
    counted = found.late & found.is_ok
    assert np.count_nonzero(counted) > least * np.count_nonzero(found.late)
    assert np.abs(found.vel[counted]).max() < MOST_VELOCITY
    assert (np.abs(found.vel) / found.sd_vel)[counted].max() < 4.0
    table = Pipeline(KNOWN).run(events)
    assert table.values.tobytes() == found.values.tobytes()
    assert table.stamp_ns.tolist() == found.stamps
    return found


@pytest.mark.parametrize("ahead", [0.15, 0.25, 0.5, 0.9, 1.5])
@pytest.mark.parametrize("at", [ONCE, EVERY_SECOND], ids=["once", "every second"])
def test_samples_that_are_stamped_ahead_change_nothing(ahead, at):
    found = judge(strays(ahead, at))
    assert (np.diff(found.stamps) > 0).all()
    assert found.count(Arrival.STRAY) + found.count(Arrival.HELD) == len(at)
    assert found.pipeline.resets == 0


@pytest.mark.parametrize("by", [0.1, 0.3, 0.5, 0.9, 1.2, 1.5, 3.0])
def test_a_clock_that_is_set_back_is_followed_without_a_sample_lost(by):
    # A second of the fifteen is not called OK, until fixes have confirmed it
    found = judge(set_back(by), 0.9)
    (step,) = np.flatnonzero(np.diff(found.stamps) < 0)
    resets = found.values[:, COLUMNS.index("reset_count") - 1]
    assert np.diff(resets).nonzero()[0].tolist() == [step]
    assert found.pipeline.health().reset_reason == "clock"
    assert found.pipeline.health().arrivals[Kind.RESTART][Arrival.RESTARTED] == 1
    assert found.pipeline.health().samples == np.count_nonzero(flown()[0].kind == Kind.IMU)


@pytest.mark.parametrize("silence", [0.15, 0.3, 0.8])
def test_samples_that_were_lost_cost_the_next_one_no_more_than_its_own_estimate(silence):
    events, _ = flown()
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    kept = events.take(~((t > FROM) & (t < FROM + silence) & (events.kind == Kind.IMU)))
    # After 0.8 s the attitude is found again, in a second of the fifteen
    found = judge(kept, 0.95 if silence < 0.5 else 0.92)
    assert found.count(Arrival.TAKEN) == 1
    assert found.count(Arrival.STRAY) == found.count(Arrival.HELD) == 0
    assert found.pipeline.health().samples == np.count_nonzero(kept.kind == Kind.IMU)


# The wire

UNIX_US = 1_780_000_000_000_000
Fields = dict[str, float]
Change = Callable[[str, Fields, float], Fields]


def shifted(fields: Fields, by: float) -> Fields:
    scale = {"time_usec": 1e6, "time_boot_ms": 1e3}
    return {
        name: value + round(by * scale[name]) if name in scale and value else value
        for name, value in fields.items()
    }


def a_stray_every_second(ahead: float) -> Change:
    def change(name, fields, t):
        is_stray = name == "HIGHRES_IMU" and t > FROM and abs(t - round(t)) < 0.0019
        return shifted(fields, ahead) if is_stray else fields

    return change


def a_clock_set_back(by: float) -> Change:
    return lambda _, fields, t: shifted(fields, -by) if t > FROM else fields


@cache
def unchanged(firmware: Firmware) -> list[tuple[int, bytes, str, Fields]]:
    """Return stamp, bytes, name and fields of each frame of a flight."""
    splitter = Splitter()
    return [
        (t_ns, frame.raw, LAYOUTS[frame.message_id].name, unpack(frame)._asdict())
        for t_ns, data in cycles(WIRE, "figure-eight", kind=firmware)
        for frame in splitter.feed(data)
    ]


def frames(change: Change, firmware: Firmware = Firmware.PX4) -> list[tuple[int, bytes]]:
    """Return the stamp and bytes of each frame of a flight whose messages are changed."""
    sender, found = Sender(1, 1), []
    flight_frames = unchanged(firmware)
    first = flight_frames[0][0]
    for t_ns, raw, name, said in flight_frames:
        told = change(name, said, (t_ns - first) * 1e-9)
        found.append((t_ns, raw if told == said else sender.message(name, **told)))
    return found


def fly(flight_frames: list[tuple[int, bytes]]):
    """Return a companion after a flight, and the ODOMETRY that it sent."""
    companion, sent = Companion(STREAMING), []
    for t_ns, data in flight_frames:
        companion.receive(data, t_ns)
        companion.tick(t_ns)
        sent += named("ODOMETRY", as_messages(companion.data_to_send()))
    return companion, sent


WRONG = {
    "strays of 0.25 s": a_stray_every_second(0.25),
    "strays of 0.5 s": a_stray_every_second(0.5),
    "strays of 0.9 s": a_stray_every_second(0.9),
    "set back by 0.1 s": a_clock_set_back(0.1),
    "set back by 0.5 s": a_clock_set_back(0.5),
    "set back by 1.2 s": a_clock_set_back(1.2),
    "set back by 1.5 s": a_clock_set_back(1.5),
}


@cache
def clean() -> list:
    return fly(frames(lambda _, fields, __: fields))[1]


@pytest.mark.parametrize("case", WRONG)
def test_over_the_wire_odometry_goes_on_as_without_it_and_its_replay_is_the_same(case, tmp_path):
    """Stamps ascend, or the reset counter says that they have moved."""
    given = frames(WRONG[case])
    companion, sent = fly(given)
    stamps = np.array([one.time_usec for one in sent])
    resets = np.array([one.reset_counter for one in sent])
    assert ((np.diff(stamps) > 0) | (np.diff(resets) != 0)).all()
    # Once for the clock; the fixes after it then move a position that is no longer sure
    assert (resets[-1] != resets[0]) == case.startswith("set")

    # The same motion, whatever the stamps
    assert len(sent) == pytest.approx(len(clean()), abs=6)
    for a, b in zip(sent[-100:], clean()[-100:], strict=True):
        assert np.hypot(a.x - b.x, a.y - b.y) < 0.5
        assert abs(a.vx - b.vx) < 0.2

    path = Path(tmp_path) / "flight.tlog"
    path.write_bytes(b"".join((t // 1000).to_bytes(8, "big") + data for t, data in given))
    run = Run(path, STREAMING, Pipeline)
    for _ in run.blocks():
        pass
    replayed, live = run.pipelines[-1].state(), companion.pipeline.state()
    assert replayed.block.tobytes() == live.block.tobytes()
    assert (replayed.stamp_ns, replayed.epoch_ns) == (live.stamp_ns, live.epoch_ns)


def test_a_stray_of_ardupilot_loses_no_other_sample():
    """Its stamps are corrected, which knows no way back."""
    companion, _ = fly(frames(a_stray_every_second(0.5), Firmware.ARDUPILOT))
    health = companion.pipeline.health()
    assert health.arrivals[Kind.IMU][Arrival.STRAY] == len(EVERY_SECOND) - (SECONDS - WIRE)
    assert "IMU: out of order" not in companion.session.refused
    assert health.gaps == 0


@pytest.mark.parametrize("on_unix", ["HIGHRES_IMU", "GPS_RAW_INT"])
def test_fixes_on_another_clock_that_nothing_relates_count_as_of_now(on_unix):
    """The autopilot does not know unix time, and one message is stamped by it all the same."""

    def change(name, fields, _):
        if name == "SYSTEM_TIME":
            return fields | {"time_unix_usec": 0}
        is_moved = name == on_unix and fields["time_usec"] > 0
        return fields | {"time_usec": fields["time_usec"] + UNIX_US} if is_moved else fields

    companion, _ = fly(frames(change))
    health = companion.pipeline.health()
    assert health.status is Status.OK
    assert not health.is_position_autopilots
    counts = companion.session.refused
    assert counts["GPS_RAW_INT: stamp replaced by the time of arrival"] > 100
    assert counts["GPS_RAW_INT: time base unknown"] == 25  # five seconds


# A log

_COLUMNS = {
    Kind.GNSS: (
        "gps_lat_rad",
        "gps_lon_rad",
        "gps_alt_m",
        "gps_vn_mps",
        "gps_ve_mps",
        "gps_vd_mps",
    ),
    Kind.MAG: ("mag_x_gauss", "mag_y_gauss", "mag_z_gauss"),
    Kind.BARO: ("baro_alt_m",),
    Kind.IMU: (
        *(f"gyro_{axis}_rps" for axis in "xyz"),
        *(f"accel_{axis}_mps2" for axis in "xyz"),
    ),
}


@pytest.mark.parametrize("by", [0.5, 1.5])
def test_a_log_whose_clock_is_set_back_is_converted_to_its_end(by, tmp_path):
    """As a row per event, in the order in which they were written."""
    events = set_back(by)
    names = [name for columns in _COLUMNS.values() for name in columns]
    places = {kind: names.index(columns[0]) for kind, columns in _COLUMNS.items()}
    lines = [",".join(("time_us", *names))]
    for t_ns, number, values in zip(events.t_ns, events.kind, events.values, strict=True):
        cells, kind = [""] * len(names), Kind(number)
        count = len(_COLUMNS[kind])
        cells[places[kind] : places[kind] + count] = [repr(float(one)) for one in values[:count]]
        lines.append(",".join((str(t_ns // 1000), *cells)))
    path = Path(tmp_path) / "flight.csv"
    path.write_text("\n".join(lines))
    run = Run(path, STREAMING, Pipeline)
    tables = [block.table for block in run.blocks()]
    health = run.pipelines[-1].health()
    assert health.status is Status.OK
    assert health.samples == np.count_nonzero(events.kind == Kind.IMU)
    assert (health.resets, health.reset_reason) == (1, "clock")
    _, truth = flown()
    assert np.abs(tables[-1].values[-1, 6:9] - truth.vel_n[-1]).max() < MOST_VELOCITY
