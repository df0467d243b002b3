"""Commands to a Livox Mid-360 and its answers: it sends to whom it is told to, once it samples.

Layout: "Livox LiDAR Communication Protocol, Mid-360", 1.4.11, control command: little-endian, a
CRC-16 (CCITT, from 0xFFFF) of the head and a CRC-32 of the data.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from ipaddress import IPv4Address
from zlib import crc32

COMMAND_PORT, HOST_PORT = 56100, 56101
"""Of the lidar; of the host, as is recommended."""
POINT_SOURCE, IMU_SOURCE = 56300, 56400
"""Ports of the lidar that points and inertial samples come from."""
CONFIGURE = 0x0100
DATA_KIND, POINT_HOST, IMU_HOST, WORK_MODE, IMU_ON = 0x0000, 0x0006, 0x0007, 0x001A, 0x001C
"""Parameters."""
CARTESIAN_MM, SAMPLING, ON = 1, 1, 1
_HEAD = struct.Struct("<BBHIHBB6x")
"""Begin, version, length, number, command, whether it is an answer, whether a lidar sends it."""
_SUMS = struct.Struct("<HI")
BEGIN = 0xAA
SIZE = _HEAD.size + _SUMS.size
RETURNED = {
    0x00: "done",
    0x01: "failed",
    0x02: "not possible in its present state",
    0x03: "a value out of range",
    0x20: "a parameter that it does not know",
    0x21: "done, from its next start on",
    0x22: "a parameter that cannot be set",
    0x23: "a wrong length",
    0x24: "a wrong list of parameters",
}
ACCEPTED = (0x00, 0x21)


def frame(number: int, command: int, data: bytes, *, is_answer: bool = False) -> bytes:
    """Return a command to a lidar, or its answer."""
    head = _HEAD.pack(BEGIN, 0, SIZE + len(data), number, command, is_answer, is_answer)
    return head + _SUMS.pack(crc_hqx(head, 0xFFFF), crc32(data) if data else 0) + data


def parse(datagram: bytes) -> tuple[int, int, bytes, bool] | None:
    """Return number, command and data of a frame, and whether it is an answer; None: damaged."""
    if len(datagram) < SIZE:
        return None
    begin, version, length, number, command, is_answer, _ = _HEAD.unpack_from(datagram)
    head_sum, data_sum = _SUMS.unpack_from(datagram, _HEAD.size)
    data = datagram[SIZE:]
    if begin != BEGIN or version != 0 or length != len(datagram):
        return None
    if head_sum != crc_hqx(datagram[: _HEAD.size], 0xFFFF) or data_sum != (
        crc32(data) if data else 0
    ):
        return None
    return number, command, data, bool(is_answer)


def configure(number: int, host: str, point_port: int, imu_port: int) -> bytes:
    """Return the command to sample, and to send points in mm and samples to a host.

    Raises:
        ValueError: The host is not a numeric IPv4 address.
    """
    address = IPv4Address(host).packed
    values = {
        POINT_HOST: address + struct.pack("<HH", point_port, POINT_SOURCE),
        IMU_HOST: address + struct.pack("<HH", imu_port, IMU_SOURCE),
        DATA_KIND: bytes([CARTESIAN_MM]),
        IMU_ON: bytes([ON]),
        WORK_MODE: bytes([SAMPLING]),
    }
    rows = b"".join(struct.pack("<HH", key, len(one)) + one for key, one in values.items())
    return frame(number, CONFIGURE, struct.pack("<HH", len(values), 0) + rows)


def read_answer(datagram: bytes, number: int) -> str | None:
    """Return what is wrong by the answer to a configuration; empty: it is done; None: no answer."""
    found = parse(datagram)
    if found is None or found[:2] != (number, CONFIGURE) or not found[3] or len(found[2]) < 3:
        return None
    code, key = struct.unpack_from("<BH", found[2])
    if code in ACCEPTED:
        return ""
    return f"{RETURNED.get(code, f'return code {code}')} (parameter 0x{key:04X})"
