"""Rule 35: our own address changes while a link is open, as DHCP or another Wi-Fi makes it.

A network namespace of its own, where that may be had, stands for the network.
"""

import shutil
import subprocess
import sys

import pytest

from tests.daemon.waiting import LIMIT

ALONE = ["unshare", "--map-root-user", "--net"]

SCRIPT = """
import asyncio, subprocess, time
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link

def ip(words):
    subprocess.run(["ip", *words.split()], check=True)

async def until(condition):
    end = time.monotonic() + 300.0
    while not condition():
        assert time.monotonic() < end
        link.send(b"anybody?")
        await asyncio.sleep(0.02)

async def main():
    server = await asyncio.get_running_loop().create_datagram_endpoint(
        Echo, local_addr=("10.9.0.1", 14550))
    task = asyncio.create_task(link.run())
    await until(lambda: link.bytes_in)
    for old, new in (("10.9.0.2", "10.9.0.7"), ("10.9.0.7", "10.9.0.8")):
        ip(f"addr del {old}/32 dev lo")
        ip(f"addr add {new}/32 dev lo")
        ip(f"route replace local 10.9.0.1/32 dev lo table local src {new}")
        known, begin = link.bytes_in, time.monotonic()
        await until(lambda: link.bytes_in > known)
        print(f"{time.monotonic() - begin:.2f} s, opened {link.opened}")
    task.cancel()
    server[0].close()

class Echo(asyncio.DatagramProtocol):
    def connection_made(self, transport):
        self.transport = transport
    def datagram_received(self, data, sender):
        self.transport.sendto(b"here", sender)

ip("link set lo up")
for address in ("10.9.0.1", "10.9.0.2"):
    ip(f"addr add {address}/32 dev lo")
ip("route replace local 10.9.0.1/32 dev lo table local src 10.9.0.2")
link = Link(parse_url("udpout:10.9.0.1:14550"))
asyncio.run(main())
"""


def may_be_alone():
    if not (shutil.which("unshare") and shutil.which("ip")):
        return False
    try:
        answer = subprocess.run([*ALONE, "ip", "link", "set", "lo", "up"], capture_output=True)
    except OSError:
        return False
    return answer.returncode == 0


@pytest.mark.skipif(not may_be_alone(), reason="no network namespace may be made here")
def test_datagrams_go_on_from_our_new_address_rule_35():
    """Rule 35: each time, by one new socket, as soon as there has been no route for a second."""
    command = [*ALONE, sys.executable, "-W", "error", "-c", SCRIPT]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
    assert answer.returncode == 0, answer.stderr
    words = [line.split() for line in answer.stdout.splitlines()]
    assert [line[-1] for line in words] == ["2", "3"]  # opened so often
    assert all(float(line[0]) < 20.0 for line in words)
