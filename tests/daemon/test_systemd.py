"""What the service manager is told, through a real socket."""

import os
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from ekf_companion.daemon.systemd import Systemd
from ekf_companion.mavlink.codec import Sender
from tests.daemon.test_daemon import SYSTEM, Daemon, free_port, manager
from tests.daemon.waiting import wait_until

PERIOD = 1.0
"""Of the watchdog, s."""


def beats(told):
    return [when for when, words in list(told) if words == "WATCHDOG=1"]


def has_beaten(told, seconds):
    """Wait some seconds; return whether there was a beat in them."""
    before = len(beats(told))
    time.sleep(seconds)
    return len(beats(told)) > before


def environment(address):
    return {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": str(round(PERIOD * 1e6))}


def test_a_silent_link_is_no_reason_to_be_started_again(tmp_path):
    """Rule 2: beats go on without a byte from anybody, and with an autopilot gone."""
    options = ("--link", f"udpin:127.0.0.1:{free_port()}")
    with (
        manager(tmp_path) as (address, told),
        Daemon(tmp_path, *options, environment=environment(address)) as daemon,
    ):
        daemon.wait_for(": open")
        wait_until(lambda: len(beats(told)) >= 6)
        assert daemon.stop() == 0
        heard = beats(told)
    # Twice in a period; of a busy machine one may be late
    assert np.median(np.diff(heard)) == pytest.approx(PERIOD / 2, abs=0.2 * PERIOD)


def test_a_filter_that_hangs_beats_no_more(tmp_path):
    """Rule 2: the watchdog's time runs out, and systemd starts it again."""
    port = free_port()
    code = (
        "import time\n"
        "from ekf_companion.engine.companion import Companion\n"
        "Companion.receive = lambda *_: time.sleep(60)\n"
        "from ekf_companion.cli import app\n"
        f"app(['run', '--link', 'udpin:127.0.0.1:{port}'])\n"
    )
    with (
        manager(tmp_path) as (address, told),
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={**os.environ, **environment(address)},
            stderr=subprocess.DEVNULL,
        ) as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
    ):
        wait_until(lambda: len(beats(told)) >= 3)
        peer.sendto(Sender(SYSTEM, 1).message("HEARTBEAT", type=2), ("127.0.0.1", port))
        wait_until(lambda: not has_beaten(told, 2 * PERIOD))
        process.kill()
        process.wait()


@pytest.fixture
def listened(tmp_path, monkeypatch):
    with manager(tmp_path) as (address, told):
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        yield told


def said(told, count):
    wait_until(lambda: len(told) >= count)
    return [words for _, words in told]


def test_the_status_is_one_line_and_said_when_it_changes(listened):
    systemd = Systemd()
    for text in ("OK, 30 Hz", "OK, 30 Hz", "degraded:\nno fix"):
        systemd.status(text)
    systemd.notify("READY=1")
    assert said(listened, 3) == ["STATUS=OK, 30 Hz", "STATUS=degraded: no fix", "READY=1"]


def test_how_we_are_is_asked_for_once_a_second_and_only_where_it_is_told(listened, monkeypatch):
    asked = []
    words = lambda: asked.append(1) or f"OK, {len(asked)}"  # noqa: E731
    systemd = Systemd()
    for tick in range(25):
        systemd.report(tick * 100_000_000, words)
    assert said(listened, 3) == ["STATUS=OK, 1", "STATUS=OK, 2", "STATUS=OK, 3"]
    monkeypatch.delenv("NOTIFY_SOCKET")
    Systemd().report(10_000_000_000, words)
    assert len(asked) == 3


def test_a_reload_says_when_it_began(listened):
    before = time.monotonic_ns() // 1000
    Systemd().notify_reloading()
    (words,) = said(listened, 1)
    state, stamp = words.split("\nMONOTONIC_USEC=")
    assert state == "RELOADING=1"
    assert before <= int(stamp) <= time.monotonic_ns() // 1000


def test_without_a_service_manager_nobody_is_told(monkeypatch, caplog):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    Systemd().status("OK")
    assert not caplog.records


def test_one_that_does_not_listen_is_said_once(monkeypatch, caplog, tmp_path):
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    systemd = Systemd()
    systemd.notify("READY=1")
    systemd.status("OK")
    assert caplog.text.count("NOTIFY_SOCKET: No such file or directory") == 1
