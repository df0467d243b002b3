"""What systemd does to a process before it starts it, where none runs: a system-call filter."""

import ctypes
import errno
import platform
import re
import struct
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)
_NO_NEW_PRIVILEGES, _SECCOMP, _FILTER = 38, 22, 2
_WRITE_OR_EXECUTE, _REFUSE_GAIN = 65, 1
_LOAD, _JUMP_EQUAL, _RETURN = 0x20, 0x15, 0x06
_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000


def numbers():
    """Return the numbers of this processor's system calls by name; None: no table is installed."""
    for place in (
        Path(f"/usr/include/{platform.machine()}-linux-gnu/asm/unistd_64.h"),
        Path("/usr/include/asm/unistd_64.h"),
        Path("/usr/include/asm-generic/unistd.h"),
    ):
        if place.exists():
            found = re.findall(r"#define __NR(?:3264)?_(\w+)\s+(\d+)$", place.read_text(), re.M)
            return {name: int(number) for name, number in found}
    return None


def confine(allowed):
    """Let this process call only these; the rest is not permitted. To be called before exec.

    Memory that was writable never becomes executable either, where the kernel (6.3) can hold that.
    """
    lines = [struct.pack("HBBI", _LOAD, 0, 0, 0)]
    for number in allowed:
        lines.append(struct.pack("HBBI", _JUMP_EQUAL, 0, 1, number))
        lines.append(struct.pack("HBBI", _RETURN, 0, 0, _ALLOW))
    lines.append(struct.pack("HBBI", _RETURN, 0, 0, _ERRNO | errno.EPERM))
    code = ctypes.create_string_buffer(b"".join(lines))

    class Program(ctypes.Structure):
        _fields_ = [("size", ctypes.c_ushort), ("code", ctypes.c_void_p)]

    program = Program(len(lines), ctypes.addressof(code))
    _LIBC.prctl(_WRITE_OR_EXECUTE, _REFUSE_GAIN, 0, 0, 0)
    assert _LIBC.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0) == 0
    assert _LIBC.prctl(_SECCOMP, _FILTER, ctypes.byref(program), 0, 0) == 0
