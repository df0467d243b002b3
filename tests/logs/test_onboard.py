"""What an autopilot writes of itself into a log: firmware, parameters, messages."""

import struct

import numpy as np
import pytest

from ekf_companion.logs import dataflash, tlog, tlog_text, ulog_messages
from ekf_companion.logs.onboard import LONGEST, MOST, clean
from ekf_companion.logs.tlog_senders import autopilot_of
from ekf_companion.mavlink.codec import Sender, pack
from tests.logs.test_dataflash import Writer


def message(kind, content):
    return struct.pack("<HB", len(content), ord(kind)) + content


def information(kind, name, value):
    key = f"{kind} {name}".encode()
    return message("I", bytes([len(key)]) + key + value)


def text(level, t_us, words):
    return message("L", level.encode() + struct.pack("<Q", t_us) + words)


def ulog(tmp_path, *parts):
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog_messages.MAGIC + b"\x01" + struct.pack("<Q", 0) + b"".join(parts))
    return ulog_messages.read(path, ()).onboard()


def test_a_ulog_says_firmware_parameters_and_messages_with_times_and_levels(tmp_path):
    key = b"int32_t EKF2_EN"
    found = ulog(
        tmp_path,
        information("char[3]", "sys_name", b"PX4"),
        information("uint32_t", "ver_sw_release", struct.pack("<I", 0x010E03FF)),
        information("char[6]", "ver_hw", b"FMU_V6"),
        message("P", bytes([len(key)]) + key + struct.pack("<i", 1)),
        text("4", 1_500_000, b"Low battery\n"),
        text("6", 2_000_000, b"Landed"),
    )
    assert found.firmware == "PX4 1.14.3 FMU_V6"
    assert found.parameters == {"EKF2_EN": 1}
    assert found.messages == (
        (1_500_000_000, "warning", "Low battery"),
        (2_000_000_000, "info", "Landed"),
    )


def test_of_a_ulog_with_a_flood_of_messages_the_first_are_kept_and_the_others_counted(tmp_path):
    flood = [text("6", i, f"line {i}".encode()) for i in range(70_000)]
    found = ulog(tmp_path, *flood)
    assert [one.text for one in found.messages[::999]] == ["line 0", "line 999"]
    assert (len(found.messages), found.left_out) == (MOST, 69_000)


@pytest.mark.parametrize(
    "part",
    [
        information("char[0]", "sys_name", b""),
        message("I", b""),
        message("I", b"\xff"),
        text("\x07", (1 << 64) - 1, b"\xff\xfe\x00<b>"),
        message("L", b"6short"),
    ],
)
def test_odd_informations_and_messages_neither_damage_a_ulog_nor_are_refused(tmp_path, part):
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog_messages.MAGIC + b"\x01" + bytes(8) + part + text("6", 5, b"after"))
    log = ulog_messages.read(path, ())
    assert not log.is_damaged
    assert log.onboard().messages[-1].text == "after"


def test_a_dataflash_log_says_them_too_and_old_rows_take_the_samples_time(tmp_path):
    log = Writer()
    log.define(1, "IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "MSG", "Z", "Message")
    log.define(3, "PARM", "Nf", "Name,Value")
    for i in range(5):
        log.row("IMU", 1_000_000 + i, *(0.0,) * 5, -9.8)
    log.row("MSG", b"ArduCopter V4.5.1 (9ea3ccfe)")
    log.row("PARM", b"EK3_ENABLE", 1.0)
    log.row("PARM", b"EK3_ENABLE", 0.0)
    path = tmp_path / "log.bin"
    path.write_bytes(log.data)
    found = dataflash.read(path).onboard
    assert found.firmware == "ArduCopter V4.5.1 (9ea3ccfe)"
    assert found.parameters == {"EK3_ENABLE": 1.0}
    assert found.messages == ((1_000_004_000, "", "ArduCopter V4.5.1 (9ea3ccfe)"),)


def telemetry(tmp_path, *messages):
    sender = Sender(1, 1)
    frames = [sender.frame("HEARTBEAT", pack("HEARTBEAT", type=2, autopilot=12))]
    frames += [sender.frame(name, pack(name, **fields)) for name, fields in messages]
    path = tmp_path / "log.tlog"
    stamps = (struct.pack(">Q", 1_700_000_000_000_000 + 1_000_000 * i) for i in range(len(frames)))
    path.write_bytes(b"".join(a + b for a, b in zip(stamps, frames, strict=True)))
    log = tlog.read(path)
    return tlog_text.read(log, autopilot_of(log))


def test_a_telemetry_log_says_them_too_with_long_texts_put_together(tmp_path):
    whole = np.frombuffer(np.int32(3).tobytes(), np.float32)[0]
    found = telemetry(
        tmp_path,
        ("AUTOPILOT_VERSION", {"flight_sw_version": 0x010F00FF}),
        ("PARAM_VALUE", {"param_id": b"EKF2_MODE", "param_value": whole, "param_type": 6}),
        ("ATTITUDE", {"time_boot_ms": 5000}),
        ("STATUSTEXT", {"severity": 4, "text": b"a" * 49 + b" ", "id": 7, "chunk_seq": 0}),
        ("STATUSTEXT", {"severity": 4, "text": b"b", "id": 7, "chunk_seq": 1}),
        ("ATTITUDE", {"time_boot_ms": 6000}),
        ("STATUSTEXT", {"severity": 99, "text": b"late"}),
    )
    assert found.firmware == "PX4 1.15.0"
    assert found.parameters == {"EKF2_MODE": 3.0}
    first, last = found.messages
    assert first == (5_333_333_333, "warning", "a" * 49 + " b")
    assert last == (None, "", "late")


@pytest.mark.parametrize("raw", [b"\0", b"\xff\xff", "a\u202eb\n\x1b[31m".encode(), b"x" * 10_000])
def test_text_is_one_short_line_without_what_no_reader_sees(raw):
    found = clean(raw)
    assert len(found) <= LONGEST
    assert found.isprintable()
