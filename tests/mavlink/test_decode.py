"""Each trap of the two autopilots' messages, one by one; the frames are packed by pymavlink."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.mavlink.decode import Decoder, Family, Pace, Preference
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.nav.measurements import (
    BaroSample,
    FlowSample,
    GnssFix,
    GnssFlag,
    HeadingSample,
    HeadingSource,
    ImuSample,
    MagSample,
    RangeSample,
    Restart,
    VehicleState,
    VehicleType,
)

ACCEL_GYRO, MAG, BARO = 0x3F, 0x1C0, 0x1A00
FIELD = (0.21, 0.03, 0.42)


def frame(message):
    (one,) = Splitter().feed(bytes(message.pack(dialect.MAVLink(None, 1, 1))))
    return one


class Peer:
    """A decoder, and the messages of an autopilot by name and field."""

    def __init__(self, family=Family.PX4):
        self.decoder = Decoder(family)

    def say(self, name, **fields):
        definition = getattr(dialect, f"MAVLink_{name}_message")
        values = dict.fromkeys(definition.fieldnames, 0) | fields
        return self.decoder.decode(frame(definition(**values)))

    def highres(self, t_us, **fields):
        values = {"zacc": -9.81, "fields_updated": ACCEL_GYRO, "time_usec": t_us} | fields
        return self.say("highres_imu", **values)

    def gps(self, t_us, **fields):
        fix = {"fix_type": 3, "lat": 473977635, "lon": 85455780, "alt": 489307}
        unknown = {"eph": 65535, "epv": 65535, "vel": 65535, "cog": 65535}
        return self.say("gps_raw_int", **({"time_usec": t_us} | fix | unknown | fields))

    @property
    def refused(self):
        return dict(self.decoder.refused)


def only(kind, measurements):
    return [measurement for measurement in measurements if type(measurement) is kind]


def with_fix(family=Family.PX4, **fields):
    """Return a peer whose next fix passes: it has had one before."""
    peer = Peer(family)
    peer.highres(1_000_000)
    assert peer.gps(900_000) == []
    return peer


# Inertial


def test_highres_imu_is_taken_as_it_is():
    (sample,) = Peer().highres(5_000_000, xacc=1.0, yacc=2.0, xgyro=0.5, ygyro=-0.25, zgyro=4.0)
    assert sample == ImuSample(
        t_ns=5_000_000_000,
        gyro_x=0.5,
        gyro_y=-0.25,
        gyro_z=4.0,
        accel_x=1.0,
        accel_y=2.0,
        accel_z=pytest.approx(-9.81, abs=1e-6),  # float32
    )


@pytest.mark.parametrize("missing", [1, 2, 4, 8, 16, 32])
def test_an_inertial_group_that_is_not_whole_is_refused(missing):
    """Rule 8."""
    peer = Peer()
    assert peer.highres(1_000, fields_updated=ACCEL_GYRO & ~missing) == []
    assert peer.refused == {"HIGHRES_IMU: accel or gyro not updated": 1}


def test_a_sender_that_marks_no_field_as_new_is_taken_at_its_values():
    """Rule 8: what never is marked cannot be told by its mark."""
    peer = Peer()
    assert only(ImuSample, peer.highres(1_000, fields_updated=0, xgyro=0.1))
    assert peer.highres(2_000, fields_updated=0, xgyro=0.1) == []  # the same again
    assert only(ImuSample, peer.highres(3_000, fields_updated=0, xgyro=0.2))
    assert only(ImuSample, peer.highres(4_000, xgyro=0.3))
    assert peer.highres(5_000, fields_updated=0, xgyro=0.4) == []  # it marks them after all
    assert len(peer.decoder.notes) == 1


def test_another_instance_is_left():
    peer = Peer()
    assert peer.highres(1_000, id=1) == []
    assert peer.refused == {"HIGHRES_IMU: another instance": 1}


def imu_times(peer, instance, times_ms):
    """Return when samples of an instance are taken, ms."""
    return [t_ms for t_ms in times_ms if only(ImuSample, peer.highres(t_ms * 1000, id=instance))]


def test_an_autopilot_that_goes_over_to_another_instance_is_followed():
    """Rule 7: ArduPilot's HIGHRES_IMU is of the first sensor that works, and that may change."""
    peer = Peer(Family.ARDUPILOT)
    assert imu_times(peer, 0, range(1000, 2000, 4))[0] == 1000
    assert imu_times(peer, 1, range(2000, 8000, 4))[0] == 5004  # after more than 3 s
    assert peer.decoder.inertial.instance == 1
    assert list(peer.decoder.notes) == [
        "Inertial sensor 1 is used: 0 has been silent, or much slower, for 3 s; its biases are "
        "other ones"
    ]
    peer.decoder.notes.clear()
    assert imu_times(peer, 0, range(8000, 9100, 4)) == list(range(9000, 9100, 4))
    assert peer.decoder.inertial.instance == 0
    assert imu_times(peer, 1, range(9100, 9900, 4)) == []
    assert list(peer.decoder.notes) == [
        "Inertial sensor 0 speaks steadily; its biases are other ones"
    ]
    assert peer.refused["HIGHRES_IMU: instance changed"] == 2


@pytest.mark.parametrize("period_ms", [400, 1000, 2000])
@pytest.mark.parametrize("begin_ms", [0, 10_000])
def test_a_configured_instance_that_hardly_speaks_does_not_starve_the_other(period_ms, begin_ms):
    """Rule 7: it is neither waited for again and again, nor taken for its single samples."""
    peer = Peer(Family.ARDUPILOT)
    imu_times(peer, 0, range(1000, 1000 + begin_ms, 4))
    times = range(1000 + begin_ms, 31_000 + begin_ms, 4)
    taken = [t for t in times if imu_times(peer, 0 if t % period_ms == 0 else 1, [t])]
    assert len(taken) > 0.89 * len(times)  # of 30 s, 3 s of waiting for the configured one
    assert peer.decoder.inertial.instance == 1
    assert len(peer.decoder.notes) == 1


def test_of_two_instances_that_both_stream_the_configured_one_is_used():
    """Rule 7."""
    peer = Peer(Family.ARDUPILOT)
    for t_ms in range(1000, 9000, 10):
        assert imu_times(peer, 1, [t_ms]) == []
        assert imu_times(peer, 0, [t_ms]) == [t_ms]
    assert not peer.decoder.notes


def test_an_instance_that_is_never_sent_is_waited_for_three_seconds():
    """Rule 7."""
    peer = Peer(Family.ARDUPILOT)
    assert imu_times(peer, 2, range(1000, 8000, 10))[0] == 4010


def test_a_source_that_is_changed_is_told():
    """Rule 7."""
    peer = Peer(Family.ARDUPILOT)
    for t_ms in range(1000, 6000, 20):
        peer.say("raw_imu", time_usec=t_ms * 1000, **RAW)
    assert list(peer.decoder.notes) == [
        "RAW_IMU is used: HIGHRES_IMU has been silent, or much slower, for 3 s"
    ]
    for t_us in range(6_000_000, 7_020_000, 20_000):
        peer.highres(t_us)
    assert peer.decoder.notes[-1] == "HIGHRES_IMU speaks steadily"


def test_notes_that_nobody_reads_are_bounded():
    peer = Peer(Family.ARDUPILOT)
    for number in range(100):
        for t_ms in range(4000 * number + 1000, 4000 * number + 5000, 500):
            peer.highres(t_ms * 1000, id=1 + number % 7)
    assert len(peer.decoder.notes) == 32


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused(value):
    peer = Peer()
    assert peer.highres(1_000, ygyro=value) == []
    assert peer.refused == {"IMU: not a number": 1}


def test_a_repeated_stamp_is_refused():
    """Rule 10."""
    peer = Peer()
    assert len(peer.highres(4_000)) == 1
    assert peer.highres(4_000) == []
    assert peer.refused == {"IMU: stamp repeated": 1}


def test_a_stamp_that_is_no_time_is_refused():
    peer = Peer()
    assert peer.highres(2**63) == []
    assert peer.refused == {"HIGHRES_IMU: no time": 1}


def test_a_stamp_of_zero_is_no_reboot():
    """Rule 12."""
    peer = Peer()
    assert only(HeadingSample, peer.say("attitude", time_boot_ms=100_000))
    for later_ms in range(100_100, 105_000, 100):
        assert peer.highres(0) == []
        assert not only(Restart, peer.say("attitude", time_boot_ms=later_ms))
    assert peer.refused == {"HIGHRES_IMU: no time": 49}


def test_a_system_time_that_is_no_time_moves_no_stamp():
    peer = Peer()
    peer.highres(1_700_000_000_000_000)
    peer.say("system_time", time_unix_usec=2**64 - 1, time_boot_ms=1_000)
    assert peer.say("attitude", time_boot_ms=1_000) == []
    assert peer.refused == {"ATTITUDE: time base unknown": 1}


RAW = {"zacc": -1001, "xgyro": 2, "ygyro": -3, "zgyro": 4, "xmag": 182, "ymag": -152, "zmag": -528}


def test_ardupilots_raw_imu_is_in_milli_units():
    peer = Peer(Family.ARDUPILOT)
    for t_us in range(1_000_000, 5_000_000, 500_000):
        measured = peer.say("raw_imu", time_usec=t_us, **RAW)
    (imu,) = only(ImuSample, measured)
    assert imu.accel_z == pytest.approx(-1.001 * 9.80665)
    assert (imu.gyro_x, imu.gyro_y, imu.gyro_z) == pytest.approx((0.002, -0.003, 0.004))


@pytest.mark.parametrize("family", [Family.PX4, Family.UNKNOWN])
def test_raw_imu_has_no_unit_but_on_ardupilot(family):
    peer = Peer(family)
    assert peer.say("raw_imu", time_usec=1_000_000, **RAW) == []
    assert peer.say("raw_imu", time_usec=9_000_000, **RAW) == []
    assert peer.refused == {"RAW_IMU: not ArduPilot": 2}


def test_the_better_source_is_kept_while_both_stream():
    """Rule 7."""
    # ArduPilot sends RAW_IMU at 200 Hz beside HIGHRES_IMU at 100 Hz
    peer = Peer(Family.ARDUPILOT)
    for step in range(2000):
        t_us = 5_000_000 + 5000 * step
        assert only(ImuSample, peer.say("raw_imu", time_usec=t_us, **RAW)) == []
        if step % 2 == 0:
            (imu,) = only(ImuSample, peer.highres(t_us))
            assert imu.accel_z == pytest.approx(-9.81, abs=1e-6)
    assert peer.decoder.imu_source == "HIGHRES_IMU"


def test_the_next_source_comes_in_after_three_seconds_and_goes_when_the_better_returns():
    """Rule 7."""
    peer = Peer(Family.ARDUPILOT)
    peer.highres(10_000_000)
    taken = [
        t_ms
        for t_ms in range(10_020, 20_000, 20)
        if only(ImuSample, peer.say("raw_imu", time_usec=t_ms * 1000, **RAW))
    ]
    assert taken == list(range(13_040, 20_000, 20))  # 3 s after the first of the worse
    better, worse = [], []
    for t_ms in range(20_000, 22_000, 20):
        if only(ImuSample, peer.highres(t_ms * 1000)):
            better.append(t_ms)
        if only(ImuSample, peer.say("raw_imu", time_usec=t_ms * 1000 + 5_000, **RAW)):
            worse.append(t_ms)
    # It must have spoken for a second; until then the worse goes on
    assert worse == list(range(20_000, 21_000, 20))
    assert better == list(range(21_000, 22_000, 20))


@pytest.mark.parametrize("period_ms", [0, 1000, 200, 30])
def test_a_better_source_that_hardly_speaks_does_not_starve_the_one_in_use(period_ms):
    """Rule 7: one HIGHRES_IMU that somebody asked for, or a few, beside RAW_IMU at 100 Hz."""
    peer = Peer(Family.ARDUPILOT)
    taken = 0
    for t_ms in range(10_000, 40_000, 10):
        taken += len(only(ImuSample, peer.say("raw_imu", time_usec=t_ms * 1000, **RAW)))
        if t_ms == 20_000 or (period_ms and t_ms > 20_000 and t_ms % period_ms == 0):
            assert not only(ImuSample, peer.highres(t_ms * 1000 + 3_000))
    assert taken == 2700 - 1  # all but for the first three seconds
    assert peer.decoder.imu_source == "RAW_IMU"


def test_a_better_source_that_hardly_speaks_from_the_start_is_not_waited_for_for_ever():
    """Rule 7."""
    peer = Peer(Family.ARDUPILOT)
    first = None
    for t_ms in range(10_000, 20_000, 10):
        if t_ms % 1000 == 0:
            peer.highres(t_ms * 1000 + 3_000)
        if only(ImuSample, peer.say("raw_imu", time_usec=t_ms * 1000, **RAW)):
            first = first or t_ms
    assert first == 13_010
    assert peer.decoder.imu_source == "RAW_IMU"


@pytest.mark.parametrize("rate", [40, 100])
def test_a_finer_source_is_not_given_up_for_being_somewhat_slower(rate):
    """Rule 7."""
    choice = Preference(0.25)
    second = 1_000_000_000
    stamps = [(k * second // rate, 0) for k in range(20 * rate)]
    stamps += [(k * second // 100 + 7, 1) for k in range(2000)]
    assert {rank for t_ns, rank in sorted(stamps) if choice.admit(rank, t_ns)} == {0}


def test_a_burst_of_a_better_source_is_not_steady():
    choice = Preference()
    choice.rank = 1
    millisecond = 1_000_000
    stamps = [(k * 10 * millisecond, 1) for k in range(1000)]
    stamps += [(5_000 * millisecond + k, 0) for k in range(1, 500)]
    stamps += [(k * millisecond + 1, 0) for k in (6_200, 7_400)]
    assert {rank for t_ns, rank in sorted(stamps) if choice.admit(rank, t_ns)} == {1}
    assert choice.rank == 1


def test_after_a_silence_of_the_link_the_worse_source_that_speaks_first_is_not_taken():
    choice = Preference()
    second = 1_000_000_000
    assert choice.admit(0, second)
    assert not choice.admit(1, 9 * second)
    assert choice.admit(0, 9 * second + 1)


@pytest.mark.parametrize("name", ["scaled_imu", "scaled_imu2", "scaled_imu3"])
def test_scaled_imu_alone_is_used_after_three_seconds(name):
    """Rule 7."""
    peer = Peer()
    for t_ms in range(1000, 9000, 20):
        imu = only(ImuSample, peer.say(name, time_boot_ms=t_ms, **RAW))
        assert bool(imu) == (t_ms > 4000)
    assert imu[0].t_ns == t_ms * 1_000_000


def test_an_instance_without_a_sensor_is_refused():
    peer = Peer(Family.ARDUPILOT)
    assert peer.say("scaled_imu3", time_boot_ms=1000, xmag=182, ymag=-152, zmag=-528) == []
    assert peer.refused == {"SCALED_IMU: no sensor behind it": 1}


# Magnetometer and pressure


def mag(peer, t_us, field, bits=ACCEL_GYRO | MAG):
    x, y, z = field
    return only(MagSample, peer.highres(t_us, xmag=x, ymag=y, zmag=z, fields_updated=bits))


def test_a_magnetometer_counts_when_its_bits_are_set_and_it_changed():
    """Rule 8."""
    peer = Peer()
    assert mag(peer, 4_000, FIELD, bits=ACCEL_GYRO) == []
    assert mag(peer, 8_000, FIELD, bits=ACCEL_GYRO | 0x40) == []
    assert len(mag(peer, 12_000, FIELD)) == 1
    assert mag(peer, 16_000, FIELD) == []
    assert len(mag(peer, 20_000, (0.22, 0.03, 0.42))) == 1


def test_a_field_a_million_times_too_large_is_corrected_and_counted():
    """Rule 9."""
    peer = Peer(Family.ARDUPILOT)
    (sample,) = mag(peer, 4_000, (182826.6, -152511.0, -528000.0))
    assert (sample.mag_x, sample.mag_y, sample.mag_z) == pytest.approx(
        (0.1828266, -0.152511, -0.528)
    )
    assert peer.refused == {"mag: unit corrected by 1e6": 1}


@pytest.mark.parametrize("size", [0.05, 0.9, 500.0, 1e5, 9e5, math.nan, math.inf])
def test_what_is_no_field_of_the_earth_is_refused(size):
    """Rule 9."""
    peer = Peer()
    assert mag(peer, 4_000, (size, 0.0, 0.0)) == []
    assert peer.refused == {"mag: no field of the Earth": 1}


def test_raw_imu_brings_the_magnetometer_where_highres_has_none():
    peer = Peer(Family.ARDUPILOT)
    found = []
    for t_ms in range(1000, 6000, 100):
        peer.highres(t_ms * 1000)
        found += only(
            MagSample, peer.say("raw_imu", time_usec=t_ms * 1000, **RAW | {"xmag": t_ms % 99})
        )
    assert found[0].t_ns > 4_000_000_000
    assert found[0].mag_z == pytest.approx(-0.528)


@pytest.mark.parametrize("pressure", [898.746, 89874.6])
def test_pressure_is_hectopascal_or_pascal_by_what_air_can_have(pressure):
    measured = Peer().highres(4_000, abs_pressure=pressure, fields_updated=ACCEL_GYRO | BARO)
    (baro,) = only(BaroSample, measured)
    assert baro.alt == pytest.approx(1000.0, abs=0.05)  # the standard's table, to 0.1 Pa


def test_pressure_in_pascal_is_said_once():
    peer = Peer()
    for number in range(3):
        t_us = 4_000 * (number + 1)
        peer.highres(t_us, abs_pressure=101_325.0 + number, fields_updated=ACCEL_GYRO | BARO)
    (note,) = peer.decoder.notes
    assert note.startswith("The pressure in HIGHRES_IMU comes in Pa, where MAVLink means hPa")
    assert note.endswith("nothing is to be done")
    other = Peer()
    other.highres(4_000, abs_pressure=1013.25, fields_updated=ACCEL_GYRO | BARO)
    assert not other.decoder.notes


@pytest.mark.parametrize("pressure", [1.0, 5000.0, 2e5, -900.0, math.nan, math.inf])
def test_a_pressure_that_air_cannot_have_is_refused(pressure):
    peer = Peer()
    measured = peer.highres(4_000, abs_pressure=pressure, fields_updated=ACCEL_GYRO | BARO)
    assert only(BaroSample, measured) == []
    assert peer.refused == {"baro: no pressure of the air": 1}


def test_a_repeated_pressure_counts_once():
    """Rule 8."""
    peer = Peer()
    bits = ACCEL_GYRO | BARO
    counts = [
        len(only(BaroSample, peer.highres(t_us, abs_pressure=950.0, fields_updated=bits)))
        for t_us in (4_000, 8_000)
    ]
    assert counts == [1, 0]


def test_scaled_pressure_steps_in_where_highres_has_none():
    peer = Peer()
    found = []
    for t_ms in range(1000, 6000, 100):
        peer.highres(t_ms * 1000)
        found += only(
            BaroSample,
            peer.say("scaled_pressure", time_boot_ms=t_ms, press_abs=950.0 + t_ms * 1e-4),
        )
    assert [baro.t_ns // 1_000_000 for baro in found] == list(range(4100, 6000, 100))


# GNSS


def test_a_fix_in_si():
    """Rule 14."""
    peer = with_fix()
    (fix,) = peer.gps(
        1_000_000, fix_type=6, vel=500, cog=9000, h_acc=300, v_acc=450, vel_acc=120, yaw=0
    )
    assert fix.t_ns == 1_000_000_000
    assert math.degrees(fix.lat) == pytest.approx(47.3977635, abs=1e-12)
    assert math.degrees(fix.lon) == pytest.approx(8.5455780, abs=1e-12)
    assert fix.alt == 489.307
    assert (fix.vel_north, fix.vel_east) == pytest.approx((0.0, 5.0))
    assert fix.vel_down is None
    assert (fix.std_h, fix.std_v, fix.std_vel) == pytest.approx((0.3, 0.45, 0.12))
    assert fix.flags == GnssFlag.NONE


@pytest.mark.parametrize("fix_type", [0, 1, 2])
def test_less_than_a_3d_fix_is_refused_even_with_true_coordinates(fix_type):
    """Rule 13."""
    peer = with_fix()
    assert peer.gps(1_000_000, fix_type=fix_type) == []
    assert peer.refused["GPS_RAW_INT: no 3-D fix"] == 1


@pytest.mark.parametrize(
    ("lat", "lon"), [(0, 0), (900_000_001, 5), (-900_000_001, 5), (5, 1_800_000_001)]
)
def test_what_is_no_place_is_refused(lat, lon):
    """Rule 13."""
    peer = with_fix()
    assert peer.gps(1_000_000, lat=lat, lon=lon) == []
    assert peer.refused["GPS_RAW_INT: no position"] == 1


def test_a_fix_that_is_sent_again_counts_once():
    """Rule 13."""
    peer = with_fix()
    assert len(peer.gps(1_000_000)) == 1
    for _ in range(3):
        assert peer.gps(1_000_000, vel=3) == []
    assert peer.refused["GPS_RAW_INT: repeated"] == 3


def test_a_fix_without_time_is_placed_at_the_newest_inertial_sample():
    """Rule 13."""
    peer = with_fix()
    peer.highres(1_050_000)
    (fix,) = peer.gps(0)
    assert fix.t_ns == 1_050_000_000
    assert peer.gps(0) == []
    assert len(peer.gps(0, lat=473977636)) == 1


def test_the_first_fix_after_none_is_not_believed():
    peer = Peer()
    peer.highres(1_000_000)
    for t_us, fix_type, expected in [
        (1_000_000, 1, 0),
        (1_200_000, 3, 0),
        (1_400_000, 3, 1),
        (1_600_000, 1, 0),
        (1_800_000, 3, 0),
        (2_000_000, 3, 1),
    ]:
        assert len(peer.gps(t_us, fix_type=fix_type)) == expected


@pytest.mark.parametrize(
    ("eph", "std_h"), [(121, 1.815), (20, 0.5), (65535, 5.0), (9999, 5.0), (0, 5.0)]
)
def test_without_an_accuracy_the_dilution_says_it(eph, std_h):
    """Rule 13."""
    (fix,) = with_fix().gps(1_000_000, eph=eph)
    assert fix.std_h == pytest.approx(std_h)
    assert fix.std_v == pytest.approx(1.5 * std_h)


@pytest.mark.parametrize("unknown", [{"vel": 65535, "cog": 100}, {"vel": 100, "cog": 65535}])
def test_speed_without_course_is_no_velocity(unknown):
    """Rule 14."""
    (fix,) = with_fix().gps(1_000_000, **unknown)
    assert fix.vel_north is fix.vel_east is fix.std_vel is None


def test_a_velocity_without_accuracy_gets_a_receivers_usual_one():
    (fix,) = with_fix().gps(1_000_000, vel=100, cog=0)
    assert fix.std_vel == 0.3


@pytest.mark.parametrize(("yaw", "degrees"), [(36000, 0.0), (9000, 90.0), (27000, -90.0)])
def test_a_dual_antenna_gives_heading_and_north_is_36000(yaw, degrees):
    """Rule 15."""
    _, heading = with_fix().gps(1_000_000, yaw=yaw, hdg_acc=50_000)
    assert heading.source is HeadingSource.GNSS
    assert math.degrees(heading.heading) == pytest.approx(degrees, abs=1e-9)
    assert math.degrees(heading.std) == pytest.approx(0.5)


@pytest.mark.parametrize("yaw", [0, 65535])
def test_no_yaw_and_yaw_that_is_not_available_are_no_heading(yaw):
    """Rule 15."""
    assert only(HeadingSample, with_fix().gps(1_000_000, yaw=yaw)) == []


def test_a_fix_in_unix_time_moves_to_the_inertial_clock():
    unix_us = 1_700_000_000_000_000
    peer = Peer()
    peer.highres(60_000_000)
    assert peer.gps(unix_us) == []
    assert peer.refused["GPS_RAW_INT: time base unknown"] == 1
    peer.say("system_time", time_unix_usec=unix_us, time_boot_ms=60_000)
    peer.gps(unix_us + 100_000)
    (fix,) = peer.gps(unix_us + 200_000)
    assert fix.t_ns == 60_200_000_000


@pytest.mark.parametrize(
    ("alt", "ellipsoid", "is_told"),
    [
        (489.307, 0.0, False),  # not given
        (489.307, 489.307, False),  # a simulator without a geoid
        (489.307, 536.6, False),  # Zurich
        (-30.0, -135.0, False),  # south of India, where the two are furthest apart
        (489.307, 1489.0, True),
        (489.307, -4.0, True),
    ],
)
def test_heights_above_sea_and_ellipsoid_are_never_mixed(alt, ellipsoid, is_told):
    """Rule 17: the one above the sea is used, whatever the other says; what cannot be is told."""
    peer = with_fix()
    for t_us in (1_000_000, 1_100_000):
        (fix,) = peer.gps(t_us, alt=round(alt * 1e3), alt_ellipsoid=round(ellipsoid * 1e3))
        assert fix.alt == pytest.approx(alt)
    counted = peer.refused.get("GPS_RAW_INT: height above the sea in doubt", 0)
    assert counted == (2 if is_told else 0)
    assert len(peer.decoder.notes) == is_told  # once


def test_the_fixes_of_a_second_receiver_are_told_from_the_firsts():
    """Rule 13: it has another antenna."""
    peer = with_fix()
    second = {"fix_type": 6, "lat": 473977640, "lon": 85455780, "vel": 65535, "cog": 65535}
    assert peer.say("gps2_raw", time_usec=1_000_000, **second) == []  # as of the first
    (fix,) = peer.say("gps2_raw", time_usec=1_200_000, **second)
    assert fix.flags == GnssFlag.SECOND
    (fix,) = peer.gps(1_200_000)
    assert fix.flags == GnssFlag.NONE
    assert peer.say("gps2_raw", time_usec=1_400_000, fix_type=1) == []
    assert peer.refused["GPS2_RAW: no 3-D fix"] == 1


def test_the_heading_of_a_second_receiver_counts_while_the_first_has_no_fix():
    peer = with_fix()
    second = {"fix_type": 6, "lat": 473977640, "lon": 85455780, "yaw": 9000, "hdg_acc": 100_000}
    peer.gps(1_000_000)
    peer.say("gps2_raw", time_usec=1_000_000, **second)
    assert only(HeadingSample, peer.say("gps2_raw", time_usec=1_200_000, **second)) == []
    peer.gps(1_200_000, fix_type=1)
    (heading,) = only(HeadingSample, peer.say("gps2_raw", time_usec=1_400_000, **second))
    assert heading.heading == pytest.approx(math.pi / 2)
    assert heading.std == pytest.approx(math.radians(1.0))


@pytest.mark.parametrize("how", ["silent", "frozen"])
def test_the_heading_of_a_second_receiver_counts_while_the_first_says_nothing_new(how):
    peer = with_fix()
    second = {"fix_type": 6, "lat": 473977640, "lon": 85455780, "yaw": 9000, "hdg_acc": 100_000}
    peer.gps(1_000_000)
    found = []
    for t_us in range(1_000_000, 6_000_000, 200_000):
        if how == "frozen":
            peer.gps(1_000_000)
        second["yaw"] = 9000 + t_us // 200_000
        out = only(HeadingSample, peer.say("gps2_raw", time_usec=t_us, **second))
        found += [one.t_ns // 1_000_000 for one in out]
    assert (found[0], found[-1]) == (3_200, 5_800)
    peer.gps(6_000_000)
    second["yaw"] += 1
    assert not only(HeadingSample, peer.say("gps2_raw", time_usec=6_000_000, **second))


PLACE = {"lat": 473977635, "lon": 85455780, "alt": 489307, "hdg": 65535}


def derived(peer, first_ms, last_ms):
    """Send positions of the autopilot's own; return the stamps (ms) of those that are used."""
    found = []
    for ms in range(first_ms, last_ms, 200):
        peer.highres(ms * 1000)
        out = only(GnssFix, peer.say("global_position_int", time_boot_ms=ms, **PLACE))
        found += [one.t_ns // 1_000_000 for one in out]
    return found


@pytest.mark.parametrize("fix_type", [0, 1, 2])
def test_while_the_receiver_has_no_fix_yet_the_autopilots_position_is_none(fix_type):
    peer = Peer(Family.ARDUPILOT)
    peer.highres(1_000_000)
    assert peer.gps(1_000_000, fix_type=fix_type) == []
    assert derived(peer, 1000, 20_000) == []
    assert peer.refused["GLOBAL_POSITION_INT: the receiver has no fix yet"] > 50
    for t_us in (20_000_000, 20_200_000):
        peer.gps(t_us)
    assert derived(peer, 20_400, 21_000)  # the filter knows that there was a fix


def test_where_no_receiver_speaks_its_position_is_used_after_three_seconds():
    found = derived(Peer(Family.ARDUPILOT), 1000, 8000)
    assert found[0] == 4000
    assert len(found) > 15


def test_px4_without_a_receiver_has_a_position_that_is_one():
    peer = Peer(Family.PX4)
    peer.highres(1_000_000)
    peer.gps(0, fix_type=0, lat=0, lon=0)
    assert derived(peer, 1000, 8000)[0] == 4000


def test_what_px4_sends_while_it_has_no_receiver_is_no_fix():
    """Rule 13: a synthetic message, time 0 and all fields unknown."""
    peer = with_fix()
    nothing = {"fix_type": 0, "lat": 0, "lon": 0, "alt": 0, "satellites_visible": 255}
    for _ in range(3):
        assert peer.gps(0, **nothing) == []
    assert peer.refused["GPS_RAW_INT: no 3-D fix"] == 3
    assert peer.gps(2_000_000) == []  # nor is the first one after it


def test_where_the_autopilot_begins_to_count_moves_nothing():
    """Rule 18: our origin is the first fix, and stays; the autopilot's may move."""
    peer = with_fix()
    assert peer.say("gps_global_origin", latitude=1, longitude=2, altitude=3) == []


def test_a_fix_stamped_on_no_clock_of_the_vehicle_is_refused():
    peer = with_fix()
    assert peer.gps(500_000_000) == []
    assert peer.refused["GPS_RAW_INT: stamp far from the inertial samples"] == 1


def test_the_autopilots_own_position_is_marked_thinned_and_weighed_down():
    """Rule 16."""
    peer = with_fix()
    peer.gps(1_000_000, h_acc=2000, v_acc=1000, vel=0, cog=0, vel_acc=500)
    fixes = []
    for t_ms in range(1000, 3000, 20):
        fixes += only(
            GnssFix,
            peer.say(
                "global_position_int",
                time_boot_ms=t_ms,
                lat=473977638,
                lon=85455799,
                alt=489416,
                vx=-150,
                vy=20,
                vz=-7,
                hdg=65535,
            ),
        )
    assert len(fixes) == 10
    fix = fixes[0]
    assert fix.flags == GnssFlag.DERIVED
    assert (fix.vel_north, fix.vel_east, fix.vel_down) == pytest.approx((-1.5, 0.2, -0.07))
    assert (fix.std_h, fix.std_v, fix.std_vel) == pytest.approx((6.0, 4.5, 1.5))


def test_a_position_of_zero_is_none():
    """Rule 16."""
    peer = with_fix()
    assert peer.say("global_position_int", time_boot_ms=1000, alt=990, hdg=65535) == []
    assert peer.refused["GLOBAL_POSITION_INT: no position"] == 1


# Heading


def test_attitude_is_the_best_heading_of_the_autopilot_at_ten_a_second():
    peer = Peer()
    headings = []
    for t_ms in range(1000, 3000, 20):
        headings += peer.say("attitude", time_boot_ms=t_ms, yaw=-0.5)
        headings += peer.say("global_position_int", time_boot_ms=t_ms, hdg=9000)
        headings += peer.say("vfr_hud", heading=90)
    assert len(headings) == 20
    assert {round(one.heading, 6) for one in headings} == {-0.5}
    assert headings[0].source is HeadingSource.AUTOPILOT
    assert math.degrees(headings[0].std) == pytest.approx(5.0)


def test_the_heading_of_the_position_then_of_the_display_step_in():
    peer = Peer()
    for t_ms in range(1000, 5000, 100):
        by_position = peer.say("global_position_int", time_boot_ms=t_ms, hdg=9000)
    assert [math.degrees(one.heading) for one in by_position] == pytest.approx([90.0])

    peer = Peer()
    for t_ms in range(1000, 5000, 100):
        peer.highres(t_ms * 1000)
        by_display = peer.say("vfr_hud", heading=270)
    assert [math.degrees(one.heading) for one in by_display] == pytest.approx([-90.0])
    assert by_display[0].t_ns == 4_900_000_000


def test_an_unknown_heading_is_none():
    """Rule 16."""
    peer = Peer()
    for t_ms in range(1000, 6000, 100):
        assert peer.say("global_position_int", time_boot_ms=t_ms, hdg=65535) == []
        assert peer.say("attitude", time_boot_ms=t_ms, yaw=math.nan) == []
        assert peer.say("vfr_hud", heading=-1) == []


# The vehicle and its clock


def test_armed_and_landed_are_told():
    peer = Peer()
    heartbeat = {"type": 2, "autopilot": 12}
    assert peer.say("heartbeat", **heartbeat) == []
    peer.highres(4_000)
    assert peer.say("heartbeat", base_mode=128, **heartbeat) == [
        VehicleState(t_ns=4_000_000, is_armed=True, type=VehicleType.ROTARY)
    ]
    for landed_state, is_landed in [(1, True), (2, False), (3, None), (0, None), (4, False)]:
        states = peer.say("extended_sys_state", landed_state=landed_state)
        if landed_state == 3:
            assert states == []  # still in the air
        else:
            known = {"t_ns": 4_000_000, "is_armed": True, "type": VehicleType.ROTARY}
            assert states == [VehicleState(**known, is_landed=is_landed)]


@pytest.mark.parametrize("first", ["highres", "attitude", "system_time", "scaled_pressure"])
def test_a_reboot_is_told_once_by_whichever_message_comes_first(first):
    """Rule 12."""
    peer = with_fix()
    peer.highres(9_000_000)
    for t_ms in range(18_000, 279_000, 9000):
        peer.highres(t_ms * 1000)
    tell = {
        "highres": lambda t_ms: peer.highres(t_ms * 1000),
        "attitude": lambda t_ms: peer.say("attitude", time_boot_ms=t_ms),
        "system_time": lambda t_ms: peer.say("system_time", time_boot_ms=t_ms),
        "scaled_pressure": lambda t_ms: peer.say("scaled_pressure", time_boot_ms=t_ms),
    }[first]
    assert tell(18_700) == []  # one stamp may be wild
    assert tell(18_950)[0] == Restart()
    after = peer.highres(18_960_000) + peer.say("attitude", time_boot_ms=18_970)
    after += peer.say("system_time", time_boot_ms=18_980)
    assert only(Restart, after) == []
    assert peer.gps(18_900_000) == []  # the first fix after it is not believed again


def test_a_wrap_of_the_milliseconds_is_no_reboot():
    """Rule 11."""
    peer = Peer()
    wrap = 1 << 32
    measured = peer.say("attitude", time_boot_ms=wrap - 500)
    measured += peer.say("attitude", time_boot_ms=500)
    assert [type(one) for one in measured] == [HeadingSample, HeadingSample]
    assert measured[1].t_ns - measured[0].t_ns == 1_000_000_000


def test_messages_that_say_nothing_of_motion_give_nothing():
    assert Peer().say("param_value", param_id=b"X") == []


# Choosing and thinning


def test_the_best_source_is_waited_for_and_the_choice_is_by_rank():
    choice = Preference()
    second = 1_000_000_000
    assert not choice.admit(2, 0)
    assert not choice.admit(1, 3 * second)
    assert choice.admit(2, 3 * second + 1)
    assert not choice.admit(1, 3 * second + 2)
    assert choice.admit(1, 4 * second + 2)
    assert not choice.admit(2, 4 * second + 3)
    assert not choice.admit(0, 5 * second)
    assert choice.admit(0, 6 * second)


def test_a_pace_starts_anew_when_stamps_go_back():
    pace = Pace(10.0)
    assert [pace.admit(t_ms * 1_000_000) for t_ms in (0, 50, 99, 100, 199, 20, 60)] == [
        True,
        False,
        True,
        False,
        True,
        True,
        False,
    ]


def test_after_a_restart_the_source_that_was_in_use_is_not_waited_for():
    def raw(peer, t_us):
        return peer.say("raw_imu", time_usec=t_us, zacc=-1000, xmag=210, ymag=30, zmag=420)

    cold, warm = Peer(Family.ARDUPILOT), Peer(Family.ARDUPILOT)
    warm.decoder.prefer(1, 1, 0, 0)
    assert raw(cold, 5_000_000) == []
    assert [type(m) for m in raw(warm, 5_000_000)] == [ImuSample, MagSample]
    for t_us in range(5_020_000, 9_000_000, 20_000):
        raw(cold, t_us)
    assert cold.decoder.ranks == (1, 1, 0, 0)
    # The best is taken as soon as it speaks steadily
    for t_us in range(5_010_000, 6_020_000, 10_000):
        warm.highres(t_us)
    assert warm.decoder.ranks == (0, 1, 0, 0)


def test_after_the_clock_was_set_back_no_better_source_is_waited_for():
    peer = Peer(Family.ARDUPILOT)
    peer.decoder.prefer(1, 1, 1, 0)
    before = range(5_000_000, 8_000_000, 20_000)
    count = 0
    for t_us in (*before, *range(7_000_000, 9_000_000, 20_000)):
        found = peer.say("raw_imu", time_usec=t_us, zacc=-1000)
        count += sum(type(one) is ImuSample for one in found)
    assert peer.decoder.refused["clock set back"] == 1
    assert peer.decoder.ranks == (1, 1, 1, 0)
    assert count == len(before) + 100


def test_the_hull_pressure_of_a_submarine_is_no_height():
    for kind, heights in ((2, 2), (12, 0)):
        peer = Peer(Family.ARDUPILOT)
        peer.say("heartbeat", type=kind, autopilot=3)
        found = peer.highres(1_000_000, fields_updated=0x1FFF, abs_pressure=1013.0)
        found += peer.say("scaled_pressure", time_boot_ms=5_000, press_abs=1014.0)
        found += peer.highres(5_010_000, fields_updated=0x1FFF, abs_pressure=1015.0)
        assert len(only(BaroSample, found)) == heights
        assert bool(peer.refused.get("baro: pressure within the hull")) == (heights == 0)
        assert any("within the hull" in note for note in peer.decoder.notes) == (heights == 0)


def test_a_field_that_is_never_the_earths_is_told_to_a_human():
    peer = Peer()
    for k in range(120):
        field = {"xmag": 21.0 + 0.01 * k, "ymag": 3.0, "zmag": 42.0}  # microtesla
        peer.highres(1_000_000 + 4_000 * k, fields_updated=ACCEL_GYRO | MAG, **field)
    (note,) = [note for note in peer.decoder.notes if "magnetometer" in note]
    assert note.startswith("The magnetometer measures 47.5 gauss, and the Earth's field has 0.22")


def range_of(peer, t_ms, **fields):
    """Return the ranges of a DISTANCE_SENSOR that looks down."""
    known = {"orientation": 25, "min_distance": 20, "max_distance": 4000, "current_distance": 250}
    said = peer.say(
        "distance_sensor", time_boot_ms=t_ms, quaternion=[0.0] * 4, **{**known, **fields}
    )
    return [(one.t_ns, one.range, one.std) for one in only(RangeSample, said)]


@pytest.mark.parametrize(
    ("fields", "found"),
    [
        ({}, (2.5, None)),
        ({"covariance": 255}, (2.5, None)),
        ({"covariance": 16}, (2.5, 0.04)),
        ({"signal_quality": 60}, (2.5, None)),
        ({"signal_quality": 1}, None),
        ({"current_distance": 20}, None),
        ({"current_distance": 4000}, None),
        ({"current_distance": 65535}, None),
        ({"orientation": 0}, None),
        ({"orientation": 24}, None),
    ],
)
def test_a_range_is_one_within_the_sensor_s_own_that_looks_down(fields, found):
    peer = Peer(Family.ARDUPILOT)
    peer.highres(1_000_000)
    expected = [] if found is None else [(1_000_000_000, *found)]
    assert range_of(peer, 1000, **fields) == expected


def test_of_several_range_finders_the_first_counts_until_it_is_silent():
    peer = Peer(Family.ARDUPILOT)
    peer.highres(1_000_000)
    used = []
    for t_ms in range(1000, 12_000, 100):
        for sensor in (1, 0):
            if sensor == 1 and t_ms >= 5000:
                continue
            used += [sensor] * len(range_of(peer, t_ms, id=sensor, current_distance=100 + sensor))
    assert used[:40] == [1] * 40
    assert set(used[40:]) == {0}
    assert len(used) == 40 + (12_000 - 8100) // 100 + 1


def flow_of(peer, **fields):
    """Return the flow of a message of a sensor that sees the ground."""
    if peer.decoder.context.family is Family.ARDUPILOT:
        known = {"time_usec": 1000, "flow_rate_x": 0.3, "flow_rate_y": -0.2}
        known |= {"flow_comp_m_x": 0.25, "flow_comp_m_y": -0.3, "quality": 51}
        said = peer.say("optical_flow", **{**known, **fields})
    else:
        known = {"time_usec": 1_000_000, "integration_time_us": 50_000, "quality": 204}
        known |= {"integrated_x": 0.015, "integrated_y": -0.01}
        known |= {"integrated_xgyro": 0.0025, "integrated_ygyro": 0.005}
        said = peer.say("optical_flow_rad", **{**known, **fields})
    return [one.row() for one in only(FlowSample, said)]


def flying(family):
    peer = Peer(family)
    peer.highres(1_000_000)
    return peer


def test_a_flow_is_a_rate_at_the_middle_of_its_interval():
    (t_ns, _, values), *_ = flow_of(flying(Family.PX4))
    assert t_ns == 975_000_000
    assert values[:5] == pytest.approx((0.3, -0.2, 0.05, 0.1, 0.8))
    assert math.isnan(values[5])


def test_ardupilot_s_flow_is_in_other_fields_and_its_time_in_milliseconds():
    (t_ns, _, values), *_ = flow_of(flying(Family.ARDUPILOT))
    assert t_ns == 1_000_000_000
    assert values[:5] == pytest.approx((0.3, -0.2, 0.05, 0.1, 0.2))


def test_of_a_sensor_without_a_gyro_the_flow_counts_without():
    nothing = dict.fromkeys(("integrated_xgyro", "integrated_ygyro"), math.nan)
    ((_, _, values),) = flow_of(flying(Family.PX4), **nothing)
    assert values[0] == pytest.approx(0.3)
    assert math.isnan(values[2])
    assert math.isnan(values[3])


@pytest.mark.parametrize(
    ("family", "fields", "why"),
    [
        (Family.PX4, {"quality": 0}, "nothing seen"),
        (Family.ARDUPILOT, {"quality": 0}, "nothing seen"),
        (Family.PX4, {"integrated_x": math.nan}, "nothing seen"),
        (Family.PX4, {"integration_time_us": 0}, "no interval"),
    ],
)
def test_a_flow_that_has_seen_nothing_is_none(family, fields, why):
    peer = flying(family)
    assert flow_of(peer, **fields) == []
    assert peer.refused[f"optical flow: {why}"] == 1


def test_optical_flow_in_pixels_is_no_rate():
    peer = flying(Family.PX4)
    assert only(FlowSample, peer.say("optical_flow", time_usec=1_000_000, flow_x=12)) == []
    assert peer.refused["optical flow: OPTICAL_FLOW in pixels"] == 1


@pytest.mark.parametrize("family", [Family.PX4, Family.ARDUPILOT])
def test_a_flow_that_stays_the_same_for_a_second_is_frozen(family):
    peer, used = flying(family), []
    unit = 1 if family is Family.ARDUPILOT else 1000
    for t_ms in range(1000, 4000, 100):
        peer.highres(1000 * t_ms)
        changed = {} if t_ms < 3000 else {"integrated_x": 0.02, "flow_rate_x": 0.4}
        known = changed.keys() & ({"flow_rate_x"} if unit == 1 else {"integrated_x"})
        moved = {name: changed[name] for name in known}
        used += [t_ms] * len(flow_of(peer, time_usec=unit * t_ms, **moved))
    assert used == [*range(1000, 2000, 100), *range(3000, 4000, 100)]
    assert peer.refused["optical flow: frozen"] == 10
