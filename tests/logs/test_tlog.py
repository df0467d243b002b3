import gzip
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v10 import ardupilotmega as first
from pymavlink.dialects.v20 import ardupilotmega as second

from ekf_companion.errors import LogError
from ekf_companion.logs import stored_rows, tlog
from ekf_companion.logs.estimate import read_truth
from ekf_companion.logs.tlog_senders import autopilot_of
from ekf_companion.replay import log_source

START_US = 1_700_000_000_000_000


def record(stamp_us, frame):
    return struct.pack(">Q", stamp_us) + frame


def small_log(version=second, n=40, boot_ms=1000):
    """Return records as bytes: a heartbeat, then attitude, position and raw samples in turn."""
    mav = version.MAVLink(None, srcSystem=1, srcComponent=1)
    gcs = version.MAVLink(None, srcSystem=255, srcComponent=190)
    records = []
    for index in range(n):
        ms = boot_ms + 20 * index
        for sender, message in (
            (gcs, gcs.heartbeat_encode(6, 8, 0, 0, 4)),
            (mav, mav.heartbeat_encode(2, 12, 0, 0, 4)),
            (mav, mav.attitude_encode(ms, 0.01 * index, -0.1, 1.0, 0, 0, 0)),
            (
                mav,
                mav.global_position_int_encode(
                    ms, 473977000 + index, 85455000, 489000, 0, 100, 0, -50, 0
                ),
            ),
            (mav, mav.raw_imu_encode(ms * 1000, 1, 2, -1000, 0, 0, 0, 0, 0, 0)),
        ):
            records.append(record(START_US + ms * 1000, message.pack(sender)))
            sender.seq = (sender.seq + 1) % 256
    return records


@pytest.fixture
def written(tmp_path):
    def write(data):
        path = tmp_path / "flight.tlog"
        path.write_bytes(data)
        return path

    return write


@pytest.mark.parametrize("version", [first, second])
def test_every_frame_comes_back_with_its_stamp(written, version):
    records = small_log(version)
    log = tlog.read(written(b"".join(records)))
    assert [record(*one) for one in log.frames()] == records
    assert log.damaged == 0


def test_the_autopilot_is_who_says_so(written):
    log = tlog.read(written(b"".join(small_log())))
    assert autopilot_of(log) == tlog.Autopilot(1, 1, "px4")


def test_a_frame_of_unknown_id_is_kept_where_a_record_follows(written):
    records = small_log()
    unknown = record(START_US, bytes([0xFD, 3, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0x7F]) + b"abc" + b"xx")
    log = tlog.read(written(b"".join([*records[:7], unknown, *records[7:]])))
    assert [record(*one) for one in log.frames()] == [*records[:7], unknown, *records[7:]]


def test_a_clock_that_is_set_while_recording_loses_nothing(written):
    before, after = small_log(n=5), small_log(n=5)
    before = [struct.pack(">Q", 1000 + index) + one[8:] for index, one in enumerate(before)]
    log = tlog.read(written(b"".join(before + after)))
    assert len(log) == len(before) + len(after)


def test_a_damaged_stamp_costs_its_record_alone(written):
    records = small_log()
    wild = [*records[:50], b"\x77" * 8 + records[50][8:], *records[51:]]
    log = tlog.read(written(b"".join(wild)))
    assert [record(*one) for one in log.frames()] == records[:50] + records[51:]


SMALL = small_log()
WHOLE = b"".join(SMALL)
EDGES = np.cumsum([0, *map(len, SMALL)])


@settings(max_examples=300, deadline=None)
@example(place=241, junk=b"\x8b", cut=3)  # an unknown message that would end where a record does
@given(
    place=st.integers(0, len(WHOLE) - 1),
    junk=st.binary(min_size=1, max_size=40),
    cut=st.integers(0, 40),
)
def test_damage_costs_only_the_records_that_it_touches(tmp_path_factory, place, junk, cut):
    path = tmp_path_factory.getbasetemp() / "damaged.tlog"
    path.write_bytes(WHOLE[:place] + junk + WHOLE[place + cut :])
    found = {record(*one) for one in tlog.read(path).frames()}
    whole = {
        one
        for one, low, high in zip(SMALL, EDGES[:-1], EDGES[1:], strict=True)
        if high <= place or low >= place + cut
    }
    assert len(whole - found) == 0


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused_by_a_sentence(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.tlog"
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"any\.tlog: "):
        tlog.read(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(LogError, match=r"none\.tlog: no such file; check the path"):
        tlog.read(tmp_path / "none.tlog")


def test_columns_agree_with_pymavlink(flight):
    path = flight("tlog-copter-canberra/flight.tlog")
    log = tlog.read(path)
    mav = first.MAVLink(None)
    mav.robust_parsing = True
    expected = {"ATTITUDE": [], "GPS_RAW_INT": [], "HEARTBEAT": []}
    for _, frame in log.frames():
        message = mav.decode(bytearray(frame))
        if message.get_type() in expected and message.get_srcSystem() == 1:
            expected[message.get_type()].append(message)
    tables = log.columns(list(expected), system_id=1)
    for name, messages in expected.items():
        assert len(messages) == len(tables[name]) > 0
        for field in messages[0].get_fieldnames():
            theirs = np.array([getattr(message, field) for message in messages])
            np.testing.assert_array_equal(
                tables[name][field], theirs.astype(tables[name][field].dtype)
            )


def test_messages_that_lie_far_apart_are_read_piece_by_piece(written, monkeypatch):
    """Else as much is in memory as lies between the first of them and the last."""
    log = tlog.read(written(b"".join(small_log())))
    whole = log.columns(["RAW_IMU"], 1)["RAW_IMU"]
    reads = []
    monkeypatch.setattr(tlog, "LONGEST", 1000)
    read = type(log.source).read
    monkeypatch.setattr(
        type(log.source), "read", lambda source, a, b: reads.append(b - a) or read(source, a, b)
    )
    np.testing.assert_array_equal(log.columns(["RAW_IMU"], 1)["RAW_IMU"], whole)
    assert len(whole) == 40
    assert len(reads) > 5
    assert max(reads) < 1100


def test_short_payloads_read_as_zeros(written):
    mav = second.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = mav.gps_raw_int_encode(5, 0, 0, 0, 0, 0, 0, 0, 0, 0).pack(mav)
    table = tlog.read(written(record(1, frame))).columns(["GPS_RAW_INT"], 1)["GPS_RAW_INT"]
    assert frame[1] < 30
    assert table["time_usec"].tolist() == [5]
    assert table["h_acc"].tolist() == [0]


def test_the_autopilots_estimate_is_in_radians_and_on_its_boot_clock(written):
    reference = log_source.reference(tlog.read(written(b"".join(small_log()))))
    assert reference.att_t_ns[:2].tolist() == [1_000_000_000, 1_040_000_000]
    assert reference.lat[0] == pytest.approx(np.deg2rad(47.3977), abs=1e-12)
    assert reference.alt[0] == 489.0
    np.testing.assert_allclose(reference.vel_n[0], [1.0, 0.0, -0.5])


def test_after_a_reboot_the_longest_boot_is_the_reference(written):
    data = b"".join(small_log(n=20, boot_ms=90_000) + small_log(n=40, boot_ms=1_000))
    reference = log_source.reference(tlog.read(written(data)))
    assert reference.att_t_ns[0] == 1_000_000_000
    assert len(reference.att_t_ns) == 20


def test_of_a_frequent_message_every_so_manieth_of_the_vehicles_own_is_enough(written, monkeypatch):
    """Two vehicles send in turn: by the count of records all of one could be left out."""
    monkeypatch.setattr(stored_rows, "AT_ONCE", 100)  # of which no stride is a part
    mine, other = (second.MAVLink(None, srcSystem=system, srcComponent=1) for system in (1, 2))
    heartbeat = mine.heartbeat_encode(2, 12, 0, 0, 4).pack(mine)
    records = [record(START_US, heartbeat)]
    for index in range(2000):
        mav = (mine, other)[index % 2]
        frame = mav.attitude_encode(2 * index, 0, 0, 0, 0, 0, 0).pack(mav)
        # A recorder that stamps by whole seconds
        records.append(record(START_US + index // 500 * 1_000_000, frame))
    log = tlog.read(written(b"".join(records)))
    found = log.columns(["ATTITUDE"], 1, rates={"ATTITUDE": 25.0})["ATTITUDE"]["time_boot_ms"]
    assert found[0] == 0
    assert set(np.diff(found).tolist()) == {4 * 27}


@pytest.mark.parametrize("first_ms", [100_000, 4_293_000, 4_400_000, 2**32 - 1000])
@pytest.mark.parametrize("has_samples", [True, False])
def test_counters_of_32_bits_that_go_round_are_of_one_boot(written, first_ms, has_samples):
    """Milliseconds, and beside them the microseconds of ArduPilot before 2021."""
    mav = second.MAVLink(None, srcSystem=1, srcComponent=1)
    records = small_log(n=1)[:2]
    for ms in range(first_ms, first_ms + 4000, 20):
        since_us = START_US + 1000 * (ms - first_ms)
        records.append(
            record(since_us, mav.attitude_encode(ms % 2**32, 0, 0, 0, 0, 0, 0).pack(mav))
        )
        if has_samples:
            raw = mav.raw_imu_encode(ms * 1000 % 2**32, 1, 2, -1000, 0, 0, 0, 0, 0, 0)
            records.append(record(since_us, raw.pack(mav)))
    log = tlog.read(written(b"".join(records)))
    t_ns = log_source.reference(log).att_t_ns
    assert len(t_ns) == 100  # of 200, at 25 Hz
    assert t_ns[0] == first_ms * 1_000_000
    assert np.all(np.diff(t_ns) == 40_000_000)


@pytest.mark.parametrize(
    ("name", "message"),
    [("sitl-arducopter-square", "SIM_STATE"), ("sitl-px4-square", "HIL_STATE_QUATERNION")],
)
def test_the_simulators_truth_gets_the_stamp_of_the_sample_before_it(flight, name, message):
    from ekf_companion.analysis import score

    log = tlog.read(flight(f"{name}/flight.tlog"))
    truth = log_source.truth(log)
    assert message in truth.name
    found = score.score(truth, read_truth(flight(f"{name}/truth.csv")))
    assert abs(found.lag) <= 0.004 + 1e-4  # good to one inertial period of PX4's
    assert found.horizontal.rms < 0.02
    assert found.tilt.rms < np.deg2rad(0.1)


def test_damaged_and_rebooted_telemetry_gives_what_it_has(flight):
    log = tlog.read(flight("tlog-copter-canberra/flight.tlog"))
    assert autopilot_of(log) == tlog.Autopilot(1, 1, "ardupilot")
    assert log.damaged > 1000
    reference = log_source.reference(log)
    assert np.all(np.diff(reference.att_t_ns) > 0)
    assert (reference.att_t_ns[-1] - reference.att_t_ns[0]) * 1e-9 > 700.0


def test_a_file_that_is_cut_while_it_is_read_says_so(written):
    path = written(b"".join(small_log()))
    log = tlog.read(path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(LogError, match="was cut short while it was read"):
        list(log.frames())


def test_a_packed_recording_has_the_same_frames(written, tmp_path):
    data = b"".join(small_log())
    packed = tmp_path / "flight.tlog.gz"
    packed.write_bytes(gzip.compress(data))
    assert list(tlog.read(packed).frames()) == list(tlog.read(written(data)).frames())
