"""Which process uses a device or a port, from /proc."""

from __future__ import annotations

import contextlib
import glob
import grp
import os
from dataclasses import dataclass
from pathlib import Path

from ekf_companion.link.address import Address, Kind

_PROC = Path("/proc")
_DEVICES = (
    "/dev/serial/by-id/*",
    "/dev/ttyACM*",
    "/dev/ttyUSB*",
    "/dev/ttyAMA*",
    "/dev/ttyTHS*",
    "/dev/serial[0-9]",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Holder:
    """A process that uses the device or the port."""

    pid: int
    name: str
    unit: str = ""
    """The service of systemd that it belongs to; empty if there is none."""
    is_users: bool = False
    """Whether that service belongs to a user's own systemd."""
    is_daemon: bool = False
    """Whether it is the daemon of this project."""

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid}{f', {self.unit}' if self.unit else ''})"

    @property
    def stop(self) -> str:
        """The command that ends it; systemd would start again what was only killed."""
        if not self.unit:
            return f"kill {self.pid}"
        if self.is_users:
            return f"systemctl --user stop {self.unit}"
        return f"sudo systemctl stop {self.unit}"


def holder_of(address: Address) -> Holder | None:
    """Return the process that has a device or a local port; None if there is none we may see."""
    targets: set[str] = set()
    if address.kind is Kind.SERIAL:
        targets = {os.path.realpath(address.device)}
    elif address.kind in (Kind.UDP_IN, Kind.TCP_IN):
        targets = sockets_at(address.kind.value[:3], address.port)
    for process in _PROC.glob("[0-9]*") if targets else ():
        if int(process.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            for descriptor in (process / "fd").iterdir():
                with contextlib.suppress(OSError):
                    if os.readlink(descriptor) in targets:
                        return _describe(process)
    return None


def sockets_at(protocol: str, port: int) -> set[str]:
    """Return this machine's sockets that are bound to a port, as /proc/pid/fd names them.

    The protocol is ``udp`` or ``tcp``; of the latter's only those count that listen.

    Source: proc(5), /proc/net/tcp.
    """
    sockets = set()
    for table in (protocol, f"{protocol}6"):
        with contextlib.suppress(OSError):
            for line in (_PROC / "net" / table).read_text().splitlines()[1:]:
                fields = line.split()
                is_listening = protocol == "udp" or fields[3] == "0A"
                if is_listening and int(fields[1].rsplit(":", 1)[1], 16) == port:
                    sockets.add(f"socket:[{fields[9]}]")
    return sockets


def present_devices() -> tuple[str, ...]:
    """Return the serial devices of this board, those with lasting names first."""
    return tuple(name for pattern in _DEVICES for name in sorted(glob.glob(pattern)))


def group_of(device: str) -> str:
    """Return the group that a device belongs to; empty if there is none."""
    with contextlib.suppress(OSError, KeyError):
        return grp.getgrgid(os.stat(device).st_gid).gr_name
    return ""


def service_of(cgroups: str) -> tuple[str, bool]:
    """Return the service of ``/proc/PID/cgroup``, and whether it is of a user's own systemd.

    A service may have groups of its own below it. What runs in a scope, such as a login, belongs to
    no service, whatever is above.
    """
    for line in cgroups.splitlines():
        path = line.rpartition(":")[2].split("/")
        units = [one for one in path if one.endswith((".service", ".scope"))]
        if units and units[-1].endswith(".service") and not units[-1].startswith("user@"):
            return units[-1], any(one.startswith("user@") for one in units)
    return "", False


def _describe(process: Path) -> Holder:
    command = (process / "cmdline").read_bytes().split(b"\0")
    unit, is_users = service_of((process / "cgroup").read_text())
    words = [os.path.basename(word.decode("utf-8", "replace")) for word in command if word]
    is_daemon = "run" in words and bool({"ekf_companion", "ekf-companion"} & set(words))
    return Holder(
        pid=int(process.name),
        name="ekf-companion" if is_daemon else (process / "comm").read_text().strip(),
        unit=unit,
        is_users=is_users,
        is_daemon=is_daemon,
    )
