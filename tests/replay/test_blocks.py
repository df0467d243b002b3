"""A recording read in blocks against the same frames, one by one, through the companion."""

from functools import cache

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.replay.run import Run
from ekf_companion.replay.worker import Mode
from sim_autopilot.autopilot import Kind as Firmware
from tests.engine.conversation import cycles

UNIX_US = 1_780_000_000_000_000
SECONDS = 20.0
FIELDS = {"xmag": 1e6, "ymag": 1e6, "zmag": 1e6}


@cache
def flown(firmware: Firmware):
    """Return time of arrival, us, and frame of a flight."""
    splitter = Splitter()
    return [
        (t_ns // 1000, frame)
        for t_ns, data in cycles(SECONDS, "figure-eight", kind=firmware)
        for frame in splitter.feed(data)
    ]


def numbers(**values):
    return lambda said, _: said | {k: v for k, v in values.items() if k in said}


def scaled(**factors):
    return lambda said, _: said | {k: said[k] * v for k, v in factors.items()}


def later(by):
    return lambda said, _: said | {"time_usec": said["time_usec"] + by}


def earlier(by_ms):
    return lambda said, _: said | {"time_boot_ms": max(said["time_boot_ms"] - by_ms, 1)}


NOW_AND_THEN = {
    "not a number": ("HIGHRES_IMU", numbers(xgyro=float("nan"))),
    "half a sample": ("HIGHRES_IMU", numbers(fields_updated=0x38)),
    "no field": ("HIGHRES_IMU", numbers(xmag=0.0, ymag=0.0, zmag=0.0)),
    "field as of old ArduPilot": ("HIGHRES_IMU", scaled(**FIELDS)),
    "a magnet": ("HIGHRES_IMU", scaled(xmag=9.0, ymag=9.0, zmag=9.0)),
    "no pressure": ("HIGHRES_IMU", numbers(abs_pressure=0.0)),
    "pressure in Pa": ("HIGHRES_IMU", scaled(abs_pressure=100.0)),
    "pressure of no air": ("HIGHRES_IMU", numbers(abs_pressure=3.0)),
    "another sensor": ("HIGHRES_IMU", numbers(id=1)),
    "no time": ("HIGHRES_IMU", numbers(time_usec=0)),
    "a stamp of no clock": ("HIGHRES_IMU", numbers(time_usec=2**63 + 5)),
    "ahead": ("HIGHRES_IMU", later(300_000)),
    "behind": ("HIGHRES_IMU", later(-9_000)),
    "long ago": ("HIGHRES_IMU", later(-20_000_000)),
    "heading of nothing": ("ATTITUDE", numbers(yaw=float("nan"))),
    "attitude of no time": ("ATTITUDE", numbers(time_boot_ms=0)),
    "attitude of unix time": ("ATTITUDE", numbers(time_boot_ms=4_000_000_000)),
    "position of nowhere": ("GLOBAL_POSITION_INT", numbers(lat=0, lon=0)),
    "position of no heading": ("GLOBAL_POSITION_INT", numbers(hdg=65_535)),
    "position of no time": ("GLOBAL_POSITION_INT", numbers(time_boot_ms=0)),
    "position of unix time": ("GLOBAL_POSITION_INT", numbers(time_boot_ms=4_000_000_000)),
    "position of before": ("GLOBAL_POSITION_INT", earlier(90)),
    "position of long ago": ("GLOBAL_POSITION_INT", earlier(5_000)),
    "no fix": ("GPS_RAW_INT", numbers(fix_type=1)),
    "fix of no time": ("GPS_RAW_INT", numbers(time_usec=0)),
    "fix with a heading": ("GPS_RAW_INT", numbers(yaw=9000)),
    "fix of no accuracy": ("GPS_RAW_INT", numbers(h_acc=0, v_acc=0, vel_acc=0)),
    "heights far apart": ("GPS_RAW_INT", numbers(alt_ellipsoid=-900_000)),
    "our answer": ("TIMESYNC", numbers(tc1=12345, target_system=1, target_component=194)),
    "an answer to another": ("TIMESYNC", numbers(tc1=12345, target_system=7)),
    "an answer to nobody": ("TIMESYNC", numbers(tc1=5, target_system=1, target_component=30)),
    "a request of another": ("TIMESYNC", numbers(tc1=0, target_system=1, target_component=30)),
}
"""What a few messages of a name say instead."""


def changed(firmware, name, change):
    """Yield arrival and bytes of a flight, a twentieth of the messages of a name changed."""
    rng, sender = np.random.default_rng(5), Sender(1, 1)
    for t_us, frame in flown(firmware):
        if LAYOUTS[frame.message_id].name == name and rng.random() < 0.05:
            said = change(unpack(frame)._asdict(), name)
            yield t_us, sender.message(name, **said)
        else:
            yield t_us, frame.raw


def mixed(firmware):
    """Yield a flight with others on the link, our own frames, repeated, swapped and lost ones."""
    rng = np.random.default_rng(6)
    ours, ground, other = Sender(1, 194), Sender(255, 190), Sender(1, 100)
    waiting = []
    for t_us, frame in flown(firmware):
        chance = rng.random()
        if chance < 0.01:
            waiting.append((t_us, frame.raw))
            continue
        yield t_us, frame.raw
        if chance < 0.02:
            yield t_us, frame.raw
        elif chance < 0.05:
            for sender in (ours, ground, other):
                name = ("ATTITUDE", "TIMESYNC", "HEARTBEAT", "ODOMETRY")[rng.integers(4)]
                yield t_us, sender.message(name)
        elif chance < 0.06:
            yield t_us, unknown(frame.sequence)
        while waiting and chance > 0.9:
            yield t_us, waiting.pop()[1]


def unknown(number):
    """Return a frame of a message that no definition knows."""
    raw = bytearray(Sender(1, 1).message("ATTITUDE", yaw=0.1))
    raw[4], raw[7:10] = number, (60_000).to_bytes(3, "little")
    return bytes(raw)


def rebooted(firmware):
    """Yield a flight in which the autopilot's clock begins anew."""
    sender = Sender(1, 1)
    first = next(t_us for t_us, _ in flown(firmware))
    for t_us, frame in flown(firmware):
        said = unpack(frame)._asdict()
        if t_us - first > SECONDS / 2 * 1e6:
            if "time_boot_ms" in said:
                said["time_boot_ms"] -= 15_000
            if said.get("time_usec"):
                said["time_usec"] -= 15_000_000
        yield t_us, sender.message(LAYOUTS[frame.message_id].name, **said)


def stuck(firmware):
    """Yield a flight in which the inertial sensor says the same from some time on."""
    sender, last = Sender(1, 1), None
    for n, (t_us, frame) in enumerate(flown(firmware)):
        if LAYOUTS[frame.message_id].name != "HIGHRES_IMU":
            yield t_us, frame.raw
            continue
        said = unpack(frame)._asdict()
        if n < 2500 or last is None:
            last = said
        kept = {k: last[k] for k in said if k[0] in "xyz"}
        yield t_us, sender.message("HIGHRES_IMU", **(said | kept))


def without_attitude(firmware):
    """Yield a flight in which the heading is from the position: the attitude falls silent."""
    for n, (t_us, frame) in enumerate(flown(firmware)):
        name = LAYOUTS[frame.message_id].name
        if n < 1000 or name != "ATTITUDE":
            yield t_us, frame.raw


def often(firmware):
    """Yield a flight in which attitude and position come with each sample, more often than used."""
    sender, last = Sender(1, 1), {}
    for t_us, frame in flown(firmware):
        yield t_us, frame.raw
        name, said = LAYOUTS[frame.message_id].name, unpack(frame)._asdict()
        if name in ("ATTITUDE", "GLOBAL_POSITION_INT"):
            last[name] = said
        for more in last if name == "HIGHRES_IMU" else ():
            stamp = {"time_boot_ms": said["time_usec"] // 1000}
            yield t_us, sender.message(more, **(last[more] | stamp))


def late_at_the_end(firmware):
    """Yield a flight whose last sample came late, with an attitude behind it that is not due."""
    sender = Sender(1, 1)
    for n, (t_us, frame) in enumerate(flown(firmware)):
        yield t_us, frame.raw
        if n > 5000 and frame.message_id == IDS["HIGHRES_IMU"]:
            break
    said = unpack(frame)._asdict()
    now_ms = said["time_usec"] // 1000
    yield t_us, sender.message("ATTITUDE", time_boot_ms=now_ms, yaw=0.1)
    yield t_us, sender.message("HIGHRES_IMU", **(said | {"time_usec": said["time_usec"] - 9_000}))
    yield t_us, sender.message("ATTITUDE", time_boot_ms=now_ms + 4, yaw=0.1)


class KeptRun(Run):
    """A run that shows the companion at its end."""

    def _open_companion(self):
        self.companion = super()._open_companion()
        return self.companion


def run(path, in_blocks):
    """Return all measurements of a recording, its report, their numbers, and the counts."""
    one = KeptRun(path, Config(), Pipeline, Mode.NEVER)
    blocks = []
    for _ in one._pieces(one.log) if in_blocks else one._frames(one.log):
        blocks += one._take_blocks(None)
    events = [block.events for block in blocks]
    session = one.companion.session
    counts = session.counters(), session.timesync.refused
    return events, one, [len(each) for each in events], counts


def check(frames, tmp_path) -> Events:
    path = tmp_path / "flight.tlog"
    stamp = UNIX_US & ~3
    path.write_bytes(b"".join((stamp + t).to_bytes(8, "big") + raw for t, raw in frames))
    whole, report, sizes, counts = run(path, True)
    single, expected, expected_sizes, expected_counts = run(path, False)
    assert sizes == expected_sizes
    assert counts == expected_counts
    for a, b in zip(whole, single, strict=True):
        assert a.t_ns.tobytes() == b.t_ns.tobytes()
        assert a.kind.tobytes() == b.kind.tobytes()
        assert a.values.tobytes() == b.values.tobytes()
    assert report.refused == expected.refused
    assert report.notes == expected.notes
    assert sum(np.count_nonzero(one.kind == Kind.IMU) for one in whole) > 1000
    return whole


@pytest.mark.parametrize("firmware", [Firmware.PX4, Firmware.ARDUPILOT])
@pytest.mark.parametrize(
    "flight", [mixed, rebooted, stuck, without_attitude, often, late_at_the_end]
)
def test_blocks_give_what_the_frames_give_one_by_one(flight, firmware, tmp_path):
    check(flight(firmware), tmp_path)


@pytest.mark.parametrize("case", NOW_AND_THEN)
@pytest.mark.parametrize("firmware", [Firmware.PX4, Firmware.ARDUPILOT])
def test_a_message_that_is_not_plain_is_read_as_the_session_reads_it(case, firmware, tmp_path):
    check(changed(firmware, *NOW_AND_THEN[case]), tmp_path)


def test_most_frames_need_no_session(tmp_path, monkeypatch):
    """Else a recording would be read at the speed of the daemon."""
    path, seen = tmp_path / "flight.tlog", []
    flight = [(UNIX_US + t & ~3, frame.raw) for t, frame in flown(Firmware.PX4)]
    path.write_bytes(b"".join(t.to_bytes(8, "big") + raw for t, raw in flight))
    one = Run(path, Config(), Pipeline, Mode.NEVER)
    receive = one._receive
    monkeypatch.setattr(one, "_receive", lambda *given: (seen.append(1), receive(*given)))
    for _ in one.blocks():
        pass
    assert len(seen) < 0.2 * len(flight)  # of 20 s, the first three
