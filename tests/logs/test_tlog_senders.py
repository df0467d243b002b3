"""Who is taken for the autopilot of a telemetry log."""

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.logs import tlog
from ekf_companion.logs.tlog_senders import autopilot_of, others, senders

START_US = 1_700_000_000_000_000


class Log:
    """Writes what senders say, one after the other."""

    def __init__(self):
        self.data, self.stamp_us = b"", START_US

    def say(self, system, component, name, *values, times=1):
        mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        for _ in range(times):
            frame = getattr(mav, f"{name}_encode")(*values).pack(mav)
            self.data += struct.pack(">Q", self.stamp_us) + frame
            self.stamp_us += 20_000
        return self

    def heartbeat(self, system, component, autopilot, kind=2, times=3):
        return self.say(system, component, "heartbeat", kind, autopilot, 0, 0, 4, times=times)

    def raw_imu(self, system, component=1, times=20):
        return self.say(system, component, "raw_imu", *range(1, 11), times=times)

    def highres_imu(self, system, component=1, times=20):
        return self.say(system, component, "highres_imu", *range(1, 16), times=times)


@pytest.fixture
def found(tmp_path):
    def read(log):
        path = tmp_path / "some.tlog"
        path.write_bytes(log.data)
        return tlog.read(path)

    return read


GENERIC, ARDUPILOT, PX4, NONE = 0, 3, 12, 8
GIMBAL, ANY, QUADROTOR, STATION = 26, 0, 2, 6


@pytest.mark.parametrize("kind", [GIMBAL, ANY])
def test_a_gimbal_that_calls_itself_an_autopilot_and_is_heard_first_is_none(found, kind):
    log = Log().heartbeat(1, 154, GENERIC, kind).heartbeat(1, 1, ARDUPILOT).raw_imu(1)
    assert autopilot_of(found(log)) == tlog.Autopilot(1, 1, "ardupilot")


def test_the_configured_system_is_the_one_compared(found):
    log = found(Log().heartbeat(2, 1, PX4).highres_imu(2).heartbeat(1, 1, ARDUPILOT).raw_imu(1))
    assert autopilot_of(log, wanted=1) == tlog.Autopilot(1, 1, "ardupilot")
    assert autopilot_of(log, wanted=2) == tlog.Autopilot(2, 1, "px4")
    assert autopilot_of(log, wanted=3) is None


def test_without_heartbeats_who_sends_samples_is_the_autopilot_and_its_messages_name_it(found):
    station = Log().heartbeat(255, 190, NONE, STATION)
    assert autopilot_of(found(station.raw_imu(7))) == tlog.Autopilot(7, 1, "ardupilot")
    px4 = Log().highres_imu(3).say(3, 1, "altitude", *range(7))
    assert autopilot_of(found(px4)) == tlog.Autopilot(3, 1, "px4")
    assert autopilot_of(found(Log().highres_imu(4))) == tlog.Autopilot(4, 1, "unknown")


def test_a_gimbal_with_inertial_samples_is_not_taken_for_a_vehicle_that_sends_none(found):
    log = Log().heartbeat(1, 1, PX4).raw_imu(1, component=154)
    assert autopilot_of(found(log)) == tlog.Autopilot(1, 1, "px4")


def test_each_other_vehicle_is_named_once_and_neither_gimbals_nor_stray_frames_are(found):
    log = Log().heartbeat(1, 1, ARDUPILOT).raw_imu(1).heartbeat(2, 1, PX4).highres_imu(2)
    log.heartbeat(3, 154, GENERIC, GIMBAL).heartbeat(4, 1, PX4, times=1).raw_imu(5, times=9)
    log.heartbeat(2, 2, GENERIC).heartbeat(255, 190, NONE, STATION)
    read = found(log)
    used = autopilot_of(read)
    assert used == tlog.Autopilot(1, 1, "ardupilot")
    named = [(one.system_id, one.family) for one in others(senders(read), used)]
    assert named == [(2, "px4"), (5, "ardupilot")]
