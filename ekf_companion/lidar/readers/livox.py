"""What a Livox has sent, as .pcap or .pcapng (tcpdump, Wireshark): the same scans as live.

Stamps, units and axes are its protocol's, so that nothing is to be decided.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ekf_companion.errors import LogError, part_of
from ekf_companion.lidar.collector import Collector, Packed
from ekf_companion.lidar.livox import MID_360, Inertial, Refusal, decode
from ekf_companion.lidar.recording import Mounting, Recording, Scan

LOOKED_AT = 500
"""Datagrams of a capture by which a Livox is known: a quarter of a second of its own."""


def is_livox(path: Path) -> bool:
    """Return whether a capture holds the datagrams of a Livox.

    Raises:
        MissingPackageError: The package that reads captures is not installed.
        LogError: It is no capture.
    """
    for _, (_, data) in zip(range(LOOKED_AT), datagrams(path), strict=False):
        if not isinstance(decode(data), Refusal):
            return True
    return False


def read_livox(path: Path, mounting: Mounting | None) -> Recording:
    """Return the longest run of the clock of the lidar that has sent most.

    Raises:
        LogError: It is no capture, or holds no scan with inertial samples.
    """
    senders = Counter(
        sender for sender, data in datagrams(path) if not isinstance(decode(data), Refusal)
    )
    sender, count = senders.most_common(1)[0]
    collector, runs = Collector(), {}
    scans = Counter[int]()
    for source, data in datagrams(path):
        if source != sender:
            continue
        found = collector.receive(data)
        if isinstance(found, Inertial):
            runs[collector.run] = collector.heard
        elif found is not None:
            scans[collector.run] += 1
    if not scans:
        raise LogError(
            f"{path}: {count} datagrams of a Livox at {sender}, but no scan beside inertial "
            "samples: capture the ports of both, 56301 and 56401"
        )
    run, number = scans.most_common(1)[0]
    said = [f"a Livox at {sender}: {number} scans of 0.1 s, {len(runs[run])} inertial samples"]
    if len(senders) > 1:
        said.append(f"{len(senders) - 1} other lidars in it: left out")
    if len(scans) > 1:
        said.append(
            f"its clock leapt, or was silent, {len(scans) - 1} times: only the longest run is read"
        )
    if collector.lost:
        said.append(f"{collector.lost} datagrams of points are missing")
    said += [f"{times} datagrams: {why}, left out" for why, times in collector.refused.items()]
    return Recording(
        name=path.name,
        scans=_Scans(path, sender, run),
        inertial=runs[run].samples(),
        mounting=mounting or MID_360,
        decisions=tuple(said),
    )


@dataclass(frozen=True, slots=True)
class _Scans:
    """The scans of a run, read anew in each pass."""

    path: Path
    sender: str
    run: int

    def __iter__(self) -> Iterator[Scan]:
        collector = Collector()
        for source, data in datagrams(self.path):
            if source != self.sender:
                continue
            found = collector.receive(data)
            if collector.run > self.run:
                return
            if isinstance(found, Packed) and collector.run == self.run:
                yield found.unpacked()


def datagrams(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield sender and content of the UDP datagrams of a capture; what was cut off ends it.

    Raises:
        MissingPackageError: The package that reads captures is not installed.
        LogError: It is no capture.
    """
    with part_of("lidar", f"reading {path.name}"):
        import dpkt
    # By the kind of the capture's link: `tcpdump -i eth0`, `-i any`, and without a link
    kinds = {
        1: dpkt.ethernet.Ethernet,
        113: dpkt.sll.SLL,
        276: dpkt.sll2.SLL2,
        101: dpkt.ip.IP,
    }
    try:
        with path.open("rb") as file:
            reader = dpkt.pcap.UniversalReader(file)
            kind = kinds.get(reader.datalink())
            if kind is None:
                raise LogError(
                    f"{path}: captured on a link of kind {reader.datalink()}, which is not known; "
                    "capture it with tcpdump -i any"
                )
            for _, frame in reader:
                try:
                    outer = kind(frame)
                except dpkt.dpkt.UnpackError:
                    continue
                ip = outer if kind is dpkt.ip.IP else outer.data
                if isinstance(ip, dpkt.ip.IP) and isinstance(ip.data, dpkt.udp.UDP):
                    yield ".".join(map(str, ip.src)), bytes(ip.data.data)
    except (dpkt.dpkt.NeedData, EOFError):
        return
    except (ValueError, OSError, dpkt.dpkt.Error) as error:
        raise LogError(f"{path}: no .pcap that can be read: {error}") from None
