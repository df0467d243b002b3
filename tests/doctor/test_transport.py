"""The first stages, of links that do not open and of bytes that are no MAVLink."""

import errno
import random
from dataclasses import replace

import pytest
from fastcrc import crc16
from pymavlink.dialects.v10 import ardupilotmega as first

from ekf_companion.config.config import Config
from ekf_companion.config.service import HttpConfig
from ekf_companion.doctor.collector import EvidenceCollector
from ekf_companion.doctor.diagnosis import diagnose, first_failure
from ekf_companion.doctor.evidence import Holder, Means, Opening
from ekf_companion.doctor.report import lines
from ekf_companion.doctor.stage import Outcome, Stage
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.status.snapshot import LinkState
from tests.doctor.simulated import UDP, evidence_of, examine, stage, words

TTY = Opening(url="serial:/dev/ttyS7:57600", kind="serial", device="/dev/ttyS7", baud=57600)
OURS = Holder(pid=7, name="ekf-companion", unit="ekf-companion.service", is_daemon=True)
SECOND = 1_000_000_000


def collect(data, opening=TTY):
    """Return the evidence of bytes alone."""
    collector = EvidenceCollector(Config(), Means.LIVE)
    for start in range(0, len(data), 64):
        collector.receive(data[start : start + 64], start * 1_000_000)
    return collector.evidence(5 * SECOND, opening)


@pytest.mark.parametrize(
    ("opening", "number", "options", "said"),
    [
        (TTY, errno.ENOENT, {}, "no serial device at all"),
        (TTY, errno.ENOENT, {"present": ("/dev/ttyACM0",)}, "serial:/dev/ttyACM0:921600"),
        (TTY, errno.EACCES, {"group": "uucp"}, "sudo usermod -aG uucp $USER"),
        (TTY, errno.EACCES, {}, "sudo usermod -aG dialout $USER"),
        (UDP, errno.EACCES, {}, "port above 1023"),
        (TTY, errno.EBUSY, {}, "sudo fuser -v /dev/ttyS7"),
        (UDP, errno.EADDRINUSE, {}, "sudo ss -lptun"),
        (TTY, errno.EAGAIN, {"holder": OURS}, "systemctl stop ekf-companion.service"),
        (UDP, errno.EADDRINUSE, {"holder": OURS}, "`ekf-companion status`"),
        (UDP, errno.EADDRINUSE, {"holder": Holder(pid=9, name="mavproxy")}, "mavproxy (process 9)"),
        (UDP, errno.ECONNREFUSED, {}, "TCP 5760"),
        (UDP, errno.ETIMEDOUT, {}, "TCP 5760"),
        (UDP, errno.EADDRNOTAVAIL, {}, "no such address"),
        (TTY, None, {}, "cannot be set up as a serial port"),
        (UDP, None, {}, "name that nobody knows"),
    ],
)
def test_a_link_that_does_not_open_says_why_and_what_to_do(opening, number, options, said):
    opening = replace(opening, failure="it does not", number=number, **options)
    results = diagnose(evidence_of(opening=opening))
    assert first_failure(results).stage is Stage.LINK
    assert said in words(results[0])
    assert {result.outcome for result in results[1:]} == {Outcome.UNKNOWN}


@pytest.mark.parametrize("holder", [None, OURS])
@pytest.mark.parametrize(
    ("http", "said"),
    [
        ({"port": 9340}, "`ekf-companion status --url http://127.0.0.1:9340`"),
        ({"host": "0.0.0.0", "port": 9340}, "status --url http://127.0.0.1:9340`"),
        ({"host": "::"}, "status --url http://[::1]:9331`"),
        ({"host": "10.0.0.2"}, "status --url http://10.0.0.2:9331`"),
        ({"port": 0}, "`sudo systemctl stop ekf-companion"),
    ],
)
def test_a_daemon_that_has_the_link_is_asked_at_its_configured_address(http, said, holder):
    opening = replace(UDP, failure="it is taken", number=errno.EADDRINUSE, holder=holder)
    evidence = replace(evidence_of(opening=opening), config=Config(http=HttpConfig(**http)))
    found = words(diagnose(evidence)[0])
    assert said in found
    assert ("status" in found) == (http != {"port": 0})


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("serial", "Cross TX and RX"),
        ("udpin", "port 14540"),
        ("udpout", "Nobody answers there"),
        ("tcp", "The connection stands"),
    ],
)
@pytest.mark.parametrize("means", [Means.LIVE, Means.LISTENING])
def test_a_link_without_bytes_says_what_may_be_silent(kind, means, said):
    opening = Opening(url=f"{kind}:x:14540", kind=kind)
    found = first_failure(diagnose(evidence_of(means=means, opening=opening, seconds=15.0)))
    assert found.stage is Stage.BYTES
    assert said in words(found)
    assert ("--listen" in words(found)) == (means is Means.LISTENING)


def link_state(**options):
    zeros = dict.fromkeys(("bytes_in", "bytes_out", "dropped", "unsent"), 0)
    known = {**zeros, "url": "", "is_open": True, "opened": 1, "silent_s": 0.0, "refused": {}}
    return LinkState(**{**known, **options})


def test_refused_datagrams_are_not_silence():
    refused = evidence_of(opening=UDP, link=link_state(refused={"another peer": 12}))
    found = first_failure(diagnose(refused))
    assert found.stage is Stage.BYTES
    assert "link.peer" in words(found)


def test_a_link_that_comes_and_goes_and_a_full_wire_are_warnings():
    evidence = evidence_of(
        opening=TTY, link=link_state(opened=4, dropped=2), bytes_in=60_000, bytes_rate=5600.0
    )
    assert "opened again 3 times" in words(stage(evidence, "link"))
    found = stage(evidence, "bytes")
    assert found.outcome is Outcome.WARNING
    assert "The wire is full: 5.6 kB/s of 5.8" in words(found)
    assert "too slow to read" in words(found)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (random.Random(1).randbytes(4000), "most likely the baud rate is not 57600"),
        (b"nsh> ps\r\n  PID COMMAND\r\n    0 Idle Task\r\n" * 30, "a console's"),
        (b"$GNGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,,*47\r\n" * 30, "NMEA"),
        (b"\xb5\x62\x01\x07\x5c\x00" + bytes(300), "UBX"),
    ],
)
def test_bytes_that_are_no_mavlink_are_told_apart(data, said):
    found = first_failure(diagnose(collect(data)))
    assert found.stage is Stage.FRAMES
    assert said in words(found)


def test_a_message_of_another_definition_is_told_from_noise():
    """Rule 32."""

    def change(name, fields):
        frame = Sender(1, 1).message(name, **fields)
        if name != "HIGHRES_IMU":
            return frame
        # Summed with another seed, as another dialect would
        return frame[:-2] + crc16.mcrf4xx(frame[1:-2] + b"\x01").to_bytes(2, "little")

    found = stage(examine(change=change, seconds=2.0), "checksums")
    assert found.outcome is Outcome.WARNING
    assert "HIGHRES_IMU always has a wrong checksum" in words(found)


def test_noise_on_the_wire_is_counted():
    """Rule 32."""
    rng = random.Random(2)

    def change(name, fields):
        frame = bytearray(Sender(1, 1).message(name, **fields))
        if rng.random() < 0.05:
            frame[rng.randrange(3, len(frame))] ^= 0x10
        return bytes(frame)

    evidence = examine(change=change, seconds=3.0)
    found = stage(evidence, "checksums")
    assert found.outcome is Outcome.WARNING
    assert "damaged on their way" in words(found)
    worse = replace(evidence, frames=replace(evidence.frames, bad_crc=evidence.frames.frames))
    assert stage(worse, "checksums").outcome is Outcome.FAILED


def test_mavlink_1_alone_is_a_warning():
    """Rule 33."""
    mav = first.MAVLink(None, srcSystem=1, srcComponent=1)
    frames = [mav.heartbeat_encode(2, 3, 0, 0, 3).pack(mav) for _ in range(5)]
    evidence = collect(b"".join(frames))
    assert stage(evidence, "source").outcome is Outcome.OK
    found = stage(evidence, "frames")
    assert found.outcome is Outcome.WARNING
    assert "SERIALn_PROTOCOL = 2" in words(found)


def test_the_report_has_a_line_a_stage_that_was_reached_then_the_first_remedy():
    """Eleven lines of "not reached" stood above the one that matters."""
    opening = replace(TTY, failure="No such file or directory", number=errno.ENOENT)
    said = lines(diagnose(evidence_of(opening=opening)), 80)
    assert said[0][1].startswith("FAILED   link")
    assert said[1][1].startswith("-        not reached: bytes, frames, checksums, source")
    empty = next(place for place, (_, line) in enumerate(said) if not line)
    assert empty <= 4
    assert said[empty + 1][1].startswith("link: ")
    hidden = " ".join(line for _, line in said[1:empty])
    assert all(f" {stage.value}" in hidden for stage in list(Stage)[1:])
    assert max(len(line) for _, line in said) <= 80
    assert sum(line.startswith("  -> ") for _, line in said) == 1


def test_what_comes_is_split_into_frames_once(monkeypatch):
    fed, feed = [], Splitter.feed
    monkeypatch.setattr(
        Splitter, "feed", lambda self, data, *who: fed.append(len(data)) or feed(self, data, *who)
    )
    sender = Sender(1, 1)
    data = b"".join(sender.message("HEARTBEAT", type=2, autopilot=12) for _ in range(20))
    collector = EvidenceCollector(Config(), Means.LISTENING)
    collector.receive(data + b"\x55" * 30, SECOND)
    evidence = collector.evidence(SECOND, TTY)
    assert sum(fed) == evidence.bytes_in == len(data) + 30
    assert evidence.sources[0].frames == evidence.frames.frames == 20
    assert evidence.sample == b"\x55" * 30
