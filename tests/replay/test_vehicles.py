"""Which vehicle of a telemetry log is estimated and compared, and what is noted of the others."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError
from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import Sender, pack, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status
from ekf_companion.replay.read import read
from ekf_companion.review.convert import estimate

FLIGHT = "sitl-arducopter-square/flight.tlog"
SECONDS = 30


class Flight:
    """Writes the beginning of a recorded flight, changed."""

    def __init__(self, source, path):
        self._log, self._path, self._begun_us = tlog.read(source), path, None
        self.senders = {}

    def frames(self):
        splitter = Splitter()
        for stamp_us, raw in self._log.frames():
            self._begun_us = self._begun_us or stamp_us
            if stamp_us - self._begun_us > SECONDS * 1_000_000:
                return
            for frame in splitter.feed(raw):
                if frame.message_id in LAYOUTS:
                    yield stamp_us, LAYOUTS[frame.message_id].name, frame

    def frame(self, ids, name, **fields):
        return self.senders.setdefault(ids, Sender(*ids)).frame(name, pack(name, **fields))

    def write(self, change):
        """Write what ``change(name, frame)`` makes of each frame: a list of frames."""
        with self._path.open("wb") as file:
            for stamp_us, name, frame in self.frames():
                for data in change(name, frame):
                    file.write(struct.pack(">Q", stamp_us) + data)
        return self._path


@pytest.fixture
def changed(flight, tmp_path):
    return Flight(flight(FLIGHT), tmp_path / "changed.tlog")


def asked_for(system_id):
    config = Config()
    return replace(config, link=replace(config.link, autopilot=system_id))


def two_vehicles(changed, *, has_heartbeats=True):
    """Write the flight with the same vehicle as system 2, half a degree further north."""

    def change(name, frame):
        if name == "HEARTBEAT" and not has_heartbeats:
            return []
        fields = unpack(frame)._asdict()
        if name in ("GPS_RAW_INT", "GLOBAL_POSITION_INT"):
            fields["lat"] += 5_000_000
        if name in ("SIM_STATE", "STATUSTEXT") or frame.system_id != 1:
            return [frame.raw] if name != "SIM_STATE" else []
        # The other one is heard first
        return [changed.frame((2, 1), name, **fields), frame.raw]

    return changed.write(change)


@pytest.mark.parametrize("has_heartbeats", [True, False])
@pytest.mark.parametrize(("wanted", "other"), [(1, 2), (2, 1)])
def test_the_comparison_is_with_the_vehicle_that_is_asked_for(
    changed, wanted, other, has_heartbeats
):
    path = two_vehicles(changed, has_heartbeats=has_heartbeats)
    table, report = estimate(path, asked_for(wanted))
    north = np.deg2rad(np.nanmedian(table.column("lat_deg"))) - np.median(report.own.lat)
    assert abs(north) * 6.4e6 < 20.0
    (note,) = [note for note in report.notes if "also holds the vehicle" in note]
    assert f"system {other} (an ArduPilot): that of system {wanted} is used" in note
    assert f"set link.autopilot = {other}" in note


def test_a_system_that_is_not_in_the_log_is_named_with_those_that_are(changed):
    path = two_vehicles(changed)
    with pytest.raises(LogError, match=r"system 1 .*, system 2 .*link.autopilot is 5"):
        estimate(path, asked_for(5))


@pytest.mark.parametrize("kind", [26, 0])
def test_a_gimbal_heard_first_leaves_the_comparison_and_no_note_of_another_autopilot(changed, kind):
    first = [changed.frame((1, 154), "HEARTBEAT", type=kind, autopilot=0, mavlink_version=3)]

    def change(name, frame):
        before, first[:] = list(first), []
        return [*before, frame.raw]

    _, report = estimate(changed.write(change), Config())
    assert report.own is not None
    assert report.truth is not None
    assert not [note for note in report.notes if "another" in note]


@pytest.mark.parametrize("source", ["HIGHRES_IMU", "RAW_IMU"])
def test_a_log_without_heartbeats_is_estimated_and_says_so(changed, source):
    left_out = {"HEARTBEAT", *({"HIGHRES_IMU", "RAW_IMU"} - {source})}
    path = changed.write(lambda name, frame: [] if name in left_out else [frame.raw])
    table, report = estimate(path, Config())
    assert report.family == "ardupilot"
    assert report.own is not None
    assert np.isfinite(table.column("lat_deg")).any()
    (note,) = [note for note in report.notes if "heartbeats" in note]
    assert "system 1, component 1 are taken, by its messages an ArduPilot" in note


@pytest.mark.parametrize("bits", [0, 0x200, 0x1C0])
def test_samples_that_no_bit_marks_as_new_are_taken_where_they_change(changed, bits):
    def change(name, frame):
        if name == "HIGHRES_IMU":
            fields = {**unpack(frame)._asdict(), "fields_updated": bits}
            return [changed.frame((1, 1), name, **fields)]
        return [] if name in ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3") else [frame.raw]

    whole = read(changed.write(lambda name, frame: [frame.raw]))
    marked = read(changed.write(change))
    assert np.count_nonzero(marked.events.kind == Kind.IMU) == np.count_nonzero(
        whole.events.kind == Kind.IMU
    )
    assert any("marks no sample as new" in note for note in marked.notes)


def second_receiver(changed, *, from_s, has_first):
    """Write the flight with all fixes by GPS2_RAW, and the first receiver without from a time."""
    begun_us = []

    def change(name, frame):
        if name == "GLOBAL_POSITION_INT":
            return []
        if name != "GPS_RAW_INT":
            return [frame.raw]
        fields = unpack(frame)._asdict()
        begun_us.append(fields["time_usec"])
        second = {key: fields[key] for key in ("time_usec", "lat", "lon", "alt", "eph", "epv")}
        second |= {key: fields[key] for key in ("vel", "cog", "fix_type", "satellites_visible")}
        frames = [changed.frame((1, 1), "GPS2_RAW", **second)]
        if fields["time_usec"] - begun_us[0] < from_s * 1_000_000:
            return [frame.raw, *frames]
        dead = [changed.frame((1, 1), "GPS_RAW_INT", **{**fields, "fix_type": 1})]
        return [*(dead if has_first else []), *frames]

    return changed.write(change)


@pytest.mark.parametrize("has_first", [True, False])
@pytest.mark.parametrize("from_s", [0.0, 15.0])
def test_a_second_receiver_takes_the_place_of_one_without_a_fix_by_name(changed, from_s, has_first):
    path = second_receiver(changed, from_s=from_s, has_first=has_first)
    table, report = estimate(path, Config())
    assert not [note for note in report.notes if "no GNSS fix" in note]
    (note,) = [note for note in report.notes if "receiver" in note]
    why = "has no more" if from_s else "has none"
    assert note.endswith(f"s on the second receiver's fixes are used: the first {why}")
    assert report.counts[Kind.GNSS] > 0.8 * 5 * (SECONDS - 3)
    assert table.column("status")[-1] == Status.OK


@pytest.mark.parametrize(("silent", "words"), [(3, ""), (3000, " and 2992 more")])
def test_thousands_of_senders_are_counted_and_eight_are_named(tmp_path, silent, words):
    path = tmp_path / "strangers.tlog"
    sample = bytes(next(one for one in LAYOUTS.values() if one.name == "HIGHRES_IMU").struct.size)
    senders = [Sender(number >> 8, number & 255) for number in range(256, 256 + silent)]
    path.write_bytes(
        b"".join(
            struct.pack(">Q", 1_700_000_000_000_000 + 1000 * number)
            + one.frame("HIGHRES_IMU", sample)
            for number, one in enumerate(senders)
        )
    )
    with pytest.raises(LogError, match="holds no inertial samples") as refused:
        estimate(path, Config(link=replace(Config().link, autopilot=200)))
    assert words in str(refused.value)
    assert len(str(refused.value)) < 700
