"""What viewers of the page get, over real sockets, and what they cannot do to the daemon."""

import asyncio
import contextlib
import json
import logging
import socket
import threading
import time
import urllib.request

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from ekf_companion.config.service import HttpConfig
from ekf_companion.daemon import feed as feed_module
from ekf_companion.daemon import http, snapshots, websocket
from ekf_companion.daemon.clock import unix_clock
from ekf_companion.daemon.feed import VIEWERS, Feed
from ekf_companion.daemon.http import open_http_server
from ekf_companion.daemon.recent_events import RecentEvents
from tests.daemon.test_daemon import free_port
from tests.daemon.waiting import LIMIT, close, wait_until
from tests.engine.conversation import cycles
from tests.status.test_observer import Watched


@contextlib.contextmanager
def serving(monkeypatch, events=None, **options):
    """Serve a companion that was fed, from a loop on a thread; yield it and the port."""
    monkeypatch.setattr(http, "HEAD_START", 0.0)
    watched = Watched().feed(cycles(2.0))
    watched.observer._clock = unix_clock
    watched.observer._tick_ns = unix_clock()
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    port = free_port(socket.SOCK_STREAM)
    config = HttpConfig(port=port, **options)
    watched.server = open_http_server(config, watched.observer, loop, events)
    watched.loop = loop
    try:
        wait_until(lambda: is_open(port))
        yield watched, port
    finally:
        close(watched.server)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def is_open(port):
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), LIMIT):
        return True
    return False


def watch(port, **options):
    options.setdefault("open_timeout", LIMIT)
    return connect(f"ws://127.0.0.1:{port}/live", proxy=None, compression=None, **options)


def receive(viewer, kind):
    """Return the next message of a kind."""
    while True:
        message = json.loads(viewer.recv(timeout=LIMIT))
        if kind in message:
            return message[kind]


def test_a_viewer_gets_the_estimate_and_the_state(monkeypatch):
    with serving(monkeypatch) as (watched, port), watch(port) as viewer:
        first, second = receive(viewer, "live"), receive(viewer, "live")
        assert first["t_s"] == pytest.approx(watched.companion.pipeline.stamp_ns * 1e-9)
        assert set(first) == set(second)
        assert len(first["vel_ned_m_s"]) == 3
        status = receive(viewer, "status")
        assert status["estimator"]["samples"] > 0


def test_each_viewer_gets_the_last_lines_of_the_log_at_opening_and_then_what_is_new(monkeypatch):
    def log(text):
        events.emit(logging.LogRecord("one", logging.INFO, "", 0, text, None, None))

    events = RecentEvents()
    log("Estimate is OK")
    with serving(monkeypatch, events) as (watched, port):
        feed = watched.server._site.feed
        for _ in range(2):  # nothing is logged between the two
            with watch(port) as viewer, watch(port) as beside:
                for one in (viewer, beside):
                    assert [line["text"] for line in receive(one, "events")] == ["Estimate is OK"]
            wait_until(lambda: not feed.viewers and not feed._has_thread)
        with watch(port) as viewer:
            receive(viewer, "events")
            receive(viewer, "status")
            assert "events" not in json.loads(viewer.recv(timeout=LIMIT))
            log("GNSS lost")
            assert receive(viewer, "events")[-1]["text"] == "GNSS lost"


def test_while_nobody_watches_nothing_is_made(monkeypatch):
    with serving(monkeypatch) as (watched, port):
        made = []
        live = watched.observer.live
        watched.observer.live = lambda: made.append(1) or live()
        with watch(port) as viewer:
            receive(viewer, "live")
            assert made
        feed = watched.server._site.feed
        wait_until(lambda: not feed.viewers and not feed._has_thread)
        assert "feed" not in {thread.name for thread in threading.enumerate()}
        with watch(port) as viewer:
            assert receive(viewer, "live")["t_s"] > 0.0


def test_more_viewers_than_four_are_refused_until_one_leaves(monkeypatch):
    with serving(monkeypatch) as (watched, port), contextlib.ExitStack() as stack:
        viewers = [stack.enter_context(watch(port)) for _ in range(VIEWERS)]
        with pytest.raises(InvalidStatus) as caught, watch(port):
            pass
        assert caught.value.response.status_code == 503
        viewers[0].close()
        wait_until(lambda: watched.server._site.feed.viewers == VIEWERS - 1)
        with watch(port) as another:
            receive(another, "live")


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_page_of_another_origin_may_not_watch(monkeypatch, origin):
    with serving(monkeypatch) as (_, port):
        with pytest.raises(InvalidStatus) as caught, watch(port, origin=origin):
            pass
        assert caught.value.response.status_code == 403
        with watch(port, origin=f"http://127.0.0.1:{port}") as viewer:
            receive(viewer, "live")


def test_a_foreign_name_may_not_watch(monkeypatch):
    with serving(monkeypatch) as (_, port):
        headers = {"Host": f"evil.example:{port}"}
        request = urllib.request.Request(f"http://127.0.0.1:{port}/status", headers=headers)
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(request, timeout=LIMIT)
        with refused.value:
            assert refused.value.code == 421
        with socket.create_connection(("127.0.0.1", port), LIMIT) as raw:
            raw.sendall(
                b"GET /live HTTP/1.1\r\nHost: evil.example\r\nUpgrade: websocket\r\n"
                b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
            )
            assert b" 421 " in raw.recv(1000).splitlines()[0]


def test_a_viewer_that_takes_nothing_is_dropped_and_others_go_on(monkeypatch):
    monkeypatch.setattr(websocket, "SLOW", 0.3)
    monkeypatch.setattr(websocket, "BUFFER", 4096)
    monkeypatch.setattr(feed_module, "PERIOD", 0.005)
    with serving(monkeypatch) as (watched, port):
        feed = watched.server._site.feed
        slow = socket.socket()
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with slow, watch(port) as other:
            slow.connect(("127.0.0.1", port))
            slow.sendall(
                b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n"
                b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
            )
            wait_until(lambda: feed.viewers == 2)
            end = time.monotonic() + LIMIT
            while feed.viewers == 2:
                receive(other, "live")
                assert time.monotonic() < end
            receive(other, "live")


def test_what_a_viewer_says_is_no_command(monkeypatch):
    with serving(monkeypatch) as (_, port), watch(port) as viewer:
        viewer.send("reboot")
        receive(viewer, "live")
        viewer.send(b"x" * 100_000)
        with pytest.raises(ConnectionClosed):
            receive(viewer, "never")


def test_a_stalled_loop_is_told(monkeypatch):
    monkeypatch.setattr(snapshots, "PATIENCE", 0.2)
    with serving(monkeypatch) as (watched, port), watch(port) as viewer:
        receive(viewer, "live")
        free = threading.Event()
        watched.loop.call_soon_threadsafe(free.wait)
        assert receive(viewer, "stalled") > 0.0
        free.set()
        receive(viewer, "live")


def test_the_end_of_the_daemon_closes_the_connection(monkeypatch):
    with serving(monkeypatch) as (watched, port), watch(port) as viewer:
        receive(viewer, "live")
        watched.server.finish()
        with pytest.raises(ConnectionClosed):
            receive(viewer, "never")


def test_a_bug_is_logged_and_the_next_message_comes(caplog):
    answers = iter([lambda: 1 // 0, lambda: {"live": b"2"}])
    feed = Feed(lambda _: next(answers, lambda: {})())
    with feed.watch() as viewer:
        assert wait_until(lambda: viewer.take(0.1)) == [b'{"live":2}']
    assert "ZeroDivisionError" in caplog.text


def test_of_each_kind_a_late_viewer_gets_the_newest_alone():
    numbers = iter(range(1, 5))
    done = threading.Event()

    def make(_):
        if (number := next(numbers, None)) is None:
            done.set()
            return {}
        return {"live": b"%d" % number, "status": b"1" if number == 1 else None}

    feed = Feed(make)
    with feed.watch() as viewer:
        assert done.wait(LIMIT)
        assert sorted(viewer.take(LIMIT)) == [b'{"live":4}', b'{"status":1}']
        assert viewer.take(0.0) == []


def test_another_computer_is_told_the_address_with_a_token(monkeypatch, caplog):
    caplog.set_level("INFO")
    with serving(monkeypatch, host="0.0.0.0") as (watched, port):
        token = watched.server._access.token
        wait_until(
            lambda: f"From another computer: http://0.0.0.0:{port}/?token={token}" in caplog.text
        )
        headers = {"Accept": "text/html"}
        address = f"http://127.0.0.1:{port}/?token={token}"
        request = urllib.request.Request(address, headers=headers)
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        with opener.open(request, timeout=LIMIT) as answer:
            assert answer.url == f"http://127.0.0.1:{port}/"
            assert b"<!doctype html>" in answer.read()
    caplog.clear()
    with serving(monkeypatch, host="0.0.0.0", token="a-secret-of-ours"):
        wait_until(lambda: "the one of http.token" in caplog.text)
        assert "a-secret-of-ours" not in caplog.text
