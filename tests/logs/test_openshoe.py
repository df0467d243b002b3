import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError
from ekf_companion.logs import csv, openshoe
from ekf_companion.nav.measurements import Kind
from ekf_companion.replay.read import read as read_any

HEAD = "\nInertial data.\n\nHeader:      a_x [g]:      a_y [g]:\n"
ROW = (
    "0xcb +0.1 -0.2 +0.98 +0.01 +0.02 -0.03 22658603 {sum} {number} "
    "{time} {time} {time} 250.0 0 0 0\n"
)
XIO = (
    "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),"
    "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n"
)


def rows(count, step=0.004, blank=()):
    return "".join(
        ROW.format(
            sum="" if index in blank else "0x1377",
            number=index + 1,
            time=f"{1274439406.0 + index * step:.6f}",
        )
        for index in range(count)
    )


@pytest.fixture
def read(tmp_path):
    def write_and_read(text):
        path = tmp_path / "walk.txt"
        path.write_bytes(text.replace("\n", "\r\n").encode())
        return openshoe.read(path)

    return write_and_read


def test_a_row_is_turned_into_forward_right_down(read):
    events = read(HEAD + rows(2)).events
    assert (events.kind == Kind.IMU).all()
    assert events.values[0, :3] == pytest.approx([0.01, -0.02, 0.03])
    assert events.values[0, 3:6] == pytest.approx(np.array([0.1, 0.2, -0.98]) * 9.80665)


def test_the_hosts_times_say_how_fast_the_sensor_was(read):
    events = read(HEAD + rows(500, step=0.005)).events
    assert np.diff(events.t_ns) == pytest.approx(5_000_000, abs=2)


@pytest.mark.parametrize(("count", "at"), [(2000, 700), (400, 200), (3000, 2950)])
def test_a_hole_in_the_hosts_times_is_a_gap_and_stretches_nothing(read, count, at):
    rng = np.random.default_rng(1)
    index = np.arange(count)
    times = 1274439406.0 + 0.004 * index + 6.0 * (index >= at)
    times += np.abs(rng.normal(0.0, 0.003, count))
    # The host was late once, for 0.3 s, and lost nothing
    times[at // 4 : at // 4 + 25] += np.linspace(0.3, 0.0, 25)
    text = HEAD + "".join(
        ROW.format(sum="0x1377", number=k + 1, time=f"{time:.6f}") for k, time in enumerate(times)
    )
    recording = read(text)
    steps = np.diff(recording.events.t_ns) * 1e-9
    assert steps[at - 1] == pytest.approx(6.004, abs=0.01)
    assert np.delete(steps, at - 1) == pytest.approx(0.004, rel=0.005)
    assert recording.notes == (
        "samples are missing at 1 places, by the sensor's counter or the host's time",
    )


@pytest.mark.parametrize(("apart", "missing"), [(400, 10), (100, 30)])
def test_short_holes_are_seen_by_the_counter_and_stretch_nothing(read, apart, missing):
    """The counter goes on by 78643 a sample, and begins anew each second."""
    rng = np.random.default_rng(2)
    index = np.arange(4000)
    kept = index[(index % apart >= missing) | (index < apart)]
    times = 1274439406.0 + 0.004 * kept + np.abs(rng.normal(0.0, 0.003, len(kept)))
    counter = 3_000_000 + kept * 78643 % 19_660_750
    text = HEAD + "".join(
        ROW.replace("22658603", str(c)).format(sum="0x1377", number=k + 1, time=f"{time:.6f}")
        for k, (c, time) in enumerate(zip(counter, times, strict=True))
    )
    events = read(text).events
    steps = np.diff(events.t_ns) * 1e-9
    assert steps == pytest.approx(0.004 * np.diff(kept), rel=0.005)


def test_a_blank_checksum_shifts_nothing_that_counts(read):
    shifted, whole = read(HEAD + rows(50, blank=range(0, 50, 3))), read(HEAD + rows(50))
    assert shifted.events.t_ns.tolist() == whole.events.t_ns.tolist()
    assert shifted.events.values.tolist() == whole.events.values.tolist()


def test_cut_rows_are_dropped_and_counted(read):
    recording = read(HEAD + rows(3) + "0xcb +0.1 -0.2 +0.98 +0.0\n0xcb a b c d e f 1 2\n")
    assert len(recording.events) == 3
    assert recording.notes == ("2 rows that were cut short or damaged were dropped",)


def test_without_times_the_rate_is_taken_and_said(read):
    recording = read("0xcb 0 0 1 0 0 0 17\n" * 3)
    assert np.diff(recording.events.t_ns).tolist() == [4_000_000, 4_000_000]
    assert recording.notes == ("no times of the host: samples taken to be 250 per second",)


def test_damaged_times_that_run_on_for_centuries_are_none(read):
    times = np.arange(1200) * 0.004 + np.repeat([1.3e9, 9.2e9, 1.3e9, 9.2e9], 300)
    lines = "".join(
        ROW.format(sum="0x1377", number=k + 1, time=f"{time:.6f}") for k, time in enumerate(times)
    )
    t_ns = read(HEAD + lines).events.t_ns
    assert t_ns.max() < 9e18
    assert (np.diff(t_ns) > 0).all()


@pytest.mark.parametrize("text", ["hello\n", "\x00\xff\x01", "1,2,3\n4,5,6\n"])
def test_other_text_is_refused(read, text):
    with pytest.raises(LogError, match=r"no line begins with 0xcb, so this is no OpenShoe"):
        read(text)


def test_rows_without_numbers_are_refused(read):
    with pytest.raises(LogError, match="none of 2 rows is whole"):
        read("0xcb\n0xcb 1 2\n")


def test_an_empty_or_missing_file_is_refused(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"")
    for name in ("a.txt", "b.txt"):
        with pytest.raises(LogError, match=f"{name}: "):
            openshoe.read(tmp_path / name)


def test_the_suffix_finds_the_reader(tmp_path):
    (tmp_path / "walk.txt").write_text(HEAD + rows(4))
    assert len(read_any(tmp_path / "walk.txt", Config()).events) == 4


def test_the_xio_header_needs_no_map(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(XIO + "0,180,0,90,0.1,0.2,0.9\n0.0025,0,0,0,0,0,1\n")
    recording = csv.read(path)
    assert recording.events.t_ns.tolist() == [0, 2_500_000]
    assert recording.events.values[0, :3] == pytest.approx([np.pi, 0.0, -np.pi / 2])
    assert recording.events.values[0, 3:6] == pytest.approx(np.array([0.1, -0.2, -0.9]) * 9.80665)
    assert "x-IO" in recording.notes[0]


def test_a_map_beside_a_known_header_wins(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text(XIO + "0,180,0,90,0.1,0.2,0.9\n")
    path.with_name("walk.csv.columns.yaml").write_text(
        "time: {column: Time (s), unit: s}\nbaro_alt: {column: Accelerometer X (g), unit: m}\n"
    )
    assert csv.read(path).events.kind.tolist() == [Kind.BARO]
