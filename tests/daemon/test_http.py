"""Our state over HTTP: the real daemon asked by real requests, and a loop that is held up."""

import asyncio
import contextlib
import json
import signal
import socket
import threading
import time
import urllib.error
import urllib.request
from http.client import HTTPException

import pytest
from prometheus_client.parser import text_string_to_metric_families as parse

from ekf_companion.config.service import HttpConfig
from ekf_companion.daemon import http, pages, places, snapshots
from ekf_companion.daemon.clock import unix_clock
from ekf_companion.daemon.http import open_http_server
from ekf_companion.daemon.places import PLACES
from ekf_companion.status.metrics import PREFIX
from sim_autopilot.autopilot import Kind
from tests.daemon.test_daemon import SYSTEM, Daemon, fly_over, free_port, plan
from tests.daemon.waiting import LIMIT, close, wait_until
from tests.engine.conversation import cycles
from tests.status.test_observer import Watched


def ask(url, path="/", method="GET"):
    """Return status, headers and body."""
    request = urllib.request.Request(url + path, method=method)
    try:
        with urllib.request.urlopen(request, timeout=LIMIT) as answer:
            return answer.status, answer.headers, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers, error.read().decode()


def scrape(url):
    """Return value by name, without the prefix, and labels."""
    _, _, text = ask(url, "/metrics")
    return {
        (sample.name.removeprefix(PREFIX), *sorted(sample.labels.items())): sample.value
        for family in parse(text)
        for sample in family.samples
    }


# The daemon


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Return a daemon that has flown and still runs, and its address."""
    folder = tmp_path_factory.mktemp("served")
    port, http_port = free_port(), free_port(socket.SOCK_STREAM)
    config = f"http: {{port: {http_port}}}\noutput: {{odometry: {{mode: always}}}}\n"
    config += "weigh_faults: 'off'\n"
    with Daemon(folder, "--link", f"udpin:127.0.0.1:{port}", config=config) as daemon:
        daemon.wait_for(f"Status on http://127.0.0.1:{http_port}/")
        fly_over(f"udpout:127.0.0.1:{port}", plan(7.5, boot=20.0), Kind.PX4)
        yield daemon, f"http://127.0.0.1:{http_port}"


def test_the_status_goes_from_bytes_to_what_is_sent(served):
    """Rule 40: the status is JSON, with the counters of every stage."""
    code, headers, text = ask(served[1], "/status")
    assert (code, headers["Content-Type"]) == (200, "application/json")
    data = json.loads(text)
    assert data["health"]["is_healthy"]
    assert data["link"]["bytes_in"] > 50_000
    assert data["link"]["bytes_out"] > 1_000
    assert data["frames"]["frames"] > 2_000
    assert data["peer"]["system_id"] == SYSTEM
    assert data["messages"]["HIGHRES_IMU"]["answer"] == "accepted"
    assert data["messages"]["HIGHRES_IMU"]["count"] > 1_500
    assert data["estimator"]["verdicts"]["position"]["fused"] > 0
    assert data["output"]["sent"]["ODOMETRY"] > 20
    process = data["process"]
    assert process["latency"]["100.0"] <= process["latency_count"]
    assert process["latency_count"] == data["output"]["sent"]["ODOMETRY"]
    assert 20.0 < process["rss_mb"] < 100.0


def test_a_page_that_opens_is_told_what_was_before(served):
    past = json.loads(ask(served[1], "/past")[2])
    ages = [age_s for age_s, _ in past]
    assert ages == sorted(ages, reverse=True)
    assert past[-1][1]["status"] == "ok"


def test_prometheus_reads_the_metrics(served):
    """Rule 40: /metrics."""
    code, headers, _ = ask(served[1], "/metrics")
    assert (code, headers["Content-Type"].split(";")[0]) == (200, "text/plain")
    samples = scrape(served[1])
    assert samples["link_received_bytes_total",] > 50_000
    assert samples["corrections_total", ("aid", "position"), ("verdict", "fused")] > 0
    bucket = samples["odometry_latency_seconds_bucket", ("le", "+Inf")]
    assert bucket == samples["odometry_latency_seconds_count",] > 20
    assert samples["resident_memory_bytes",] > 20e6


def test_it_is_healthy_while_the_filter_ticks_and_tells_of_the_silence(served):
    """Rule 40: /healthz; the flight is over, so the link is silent, which is no fault here."""
    code, _, text = wait_until(
        lambda: (found := ask(served[1], "/healthz"))[2].count("silent") and found
    )
    assert code == 200
    assert text.startswith("no estimate, the last was ")
    assert "the link has been silent for" in text


def test_a_loop_that_was_held_up_says_so_by_its_lag(served):
    """Rule 37: the loop's lag is exported."""
    daemon, url = served
    daemon._process.send_signal(signal.SIGSTOP)
    time.sleep(0.4)
    daemon._process.send_signal(signal.SIGCONT)
    wait_until(lambda: scrape(url)["loop_lag_seconds",] > 0.25)


def test_pages_are_listed_and_others_are_not_found(served):
    code, _, text = ask(served[1], "/")
    assert code == 200
    assert [line.split()[0] for line in text.splitlines()] == ["/healthz", "/status", "/metrics"]
    for path in ("/nowhere", "/status/", "/../etc/passwd", "/%00"):
        assert ask(served[1], path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "BREW"])
def test_nothing_can_be_done_but_to_look(served, method):
    code, headers, _ = ask(served[1], "/status", method)
    assert (code, headers["Allow"]) == (405, "GET, HEAD")


@pytest.mark.parametrize("path", ["/", "/healthz", "/status", "/metrics"])
def test_head_gives_the_length_alone(served, path):
    code, headers, text = ask(served[1], path, "HEAD")
    assert (code, text) == (200, "")
    assert int(headers["Content-Length"]) > 10


@pytest.mark.parametrize(
    "request_bytes",
    [b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n\r\n", b"\x16\x03\x01\x02\x00", b"\r\n" * 10],
)
def test_what_is_no_request_harms_nobody(served, request_bytes):
    port = int(served[1].rpartition(":")[2])
    with (
        socket.create_connection(("127.0.0.1", port), 10.0) as client,
        contextlib.suppress(OSError),  # it may have closed already
    ):
        client.sendall(request_bytes)
        client.shutdown(socket.SHUT_WR)
        while client.recv(10_000):
            pass
    assert ask(served[1], "/healthz")[0] == 200
    assert "Traceback" not in served[0].words.read_text()


def test_a_port_that_is_taken_is_told_with_the_remedy_and_ends_nothing(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        options = ("--link", f"udpin:127.0.0.1:{free_port()}")
        with Daemon(tmp_path, *options, config=f"http: {{port: {taken}}}\n") as daemon:
            daemon.wait_for(f"http: 127.0.0.1 port {taken}: Address already in use; flying without")
            assert daemon.stop() == 0
            words = daemon.words.read_text()
    assert "give http.port another number in the configuration" in words


# In this process


@contextlib.asynccontextmanager
async def serving(watched, host="127.0.0.1", port=None):
    """Serve what a companion that is fed here has to tell; give the address."""
    port = port or free_port(socket.SOCK_STREAM)
    loop = asyncio.get_running_loop()
    watched.server = open_http_server(HttpConfig(host=host, port=port), watched.observer, loop)
    url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    try:
        yield url
    finally:
        close(watched.server)


async def listening(url):
    """Wait until it answers."""

    def is_there():
        with contextlib.suppress(OSError):
            return ask(url)[0] == 200

    await asyncio.to_thread(wait_until, is_there)


@pytest.fixture
def watched(monkeypatch):
    monkeypatch.setattr(http, "HEAD_START", 0.0)
    watched = Watched().feed(cycles(0.2))
    watched.observer._clock = unix_clock
    watched.observer._tick_ns = unix_clock()
    return watched


def test_a_loop_that_is_stuck_is_unavailable(watched):
    async def body():
        async with serving(watched) as url:
            await listening(url)
            before = await asyncio.to_thread(ask, url, "/healthz")
            stuck = {}
            threads = [
                threading.Thread(target=lambda path=path: stuck.update({path: ask(url, path)}))
                for path in ("/healthz", "/status", "/metrics")
            ]
            await asyncio.sleep(snapshots.FRESH)
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()  # the loop is held up, which is what this is about
            await asyncio.sleep(snapshots.FRESH)
            watched.observer.tick(unix_clock())
            return before, stuck, await asyncio.to_thread(ask, url, "/healthz")

    before, stuck, after = asyncio.run(body())
    assert (before[0], after[0]) == (200, 200)
    for code, _, text in stuck.values():
        assert (code, text) == (503, "stalled: the loop has not answered for 1 s\n")


def test_a_filter_that_does_not_go_round_is_unavailable(watched):
    async def body():
        async with serving(watched) as url:
            await listening(url)
            watched.observer._tick_ns = unix_clock() - 5_000_000_000
            await asyncio.sleep(snapshots.FRESH)
            return await asyncio.to_thread(ask, url, "/healthz")

    code, _, text = asyncio.run(body())
    assert code == 503
    assert text.startswith("stalled: the filter's task has not run for 5.")


def test_a_bug_in_a_page_is_logged_and_ends_nothing(watched, caplog):
    snapshot, watched.observer.snapshot = watched.observer.snapshot, lambda board: 1 // 0

    async def body():
        async with serving(watched) as url:
            await listening(url)
            broken = await asyncio.to_thread(ask, url, "/status")
            watched.observer.snapshot = snapshot
            await asyncio.sleep(snapshots.FRESH)
            return broken, await asyncio.to_thread(ask, url, "/status")

    broken, well = asyncio.run(body())
    assert (broken[0], well[0]) == (500, 200)
    assert "ZeroDivisionError" in caplog.text


def test_many_who_ask_at_once_cost_the_loop_one_snapshot(watched):
    made = []
    snapshot = watched.observer.snapshot
    watched.observer.snapshot = lambda board: made.append(1) or snapshot(board)

    async def body():
        async with serving(watched) as url:
            await listening(url)
            begin = time.monotonic()
            for _ in range(5):
                answers = [asyncio.to_thread(ask, url, "/status") for _ in range(5)]
                assert {code for code, _, _ in await asyncio.gather(*answers)} == {200}
            return time.monotonic() - begin

    assert len(made) <= asyncio.run(body()) / snapshots.FRESH + 2


def test_clients_that_dawdle_are_cut_off_and_others_are_served(watched, monkeypatch):
    monkeypatch.setattr(places, "DEADLINE", 3.0)

    async def body():
        async with serving(watched) as url:
            await listening(url)
            port = int(url.rpartition(":")[2])
            await asyncio.to_thread(dawdle, port, url)

    def dawdle(port, url):
        with contextlib.ExitStack() as stack:
            slow = [
                stack.enter_context(socket.create_connection(("127.0.0.1", port), 10.0))
                for _ in range(PLACES)
            ]
            for client in slow:
                client.sendall(b"GET / HTTP/1.1\r\nX: ")
            wait_until(lambda: len(watched.server._places) == PLACES)
            with pytest.raises((OSError, HTTPException)):
                ask(url)
            wait_until(lambda: is_cut_off(slow[0]))
            wait_until(lambda: answers(url))

    def is_cut_off(client):
        time.sleep(0.05)
        try:
            client.sendall(b"x")  # a byte now and then is no life
        except ConnectionError:
            return True

    def answers(url):
        with contextlib.suppress(OSError, HTTPException):
            return ask(url)[0] == 200

    asyncio.run(body())


def test_a_client_that_sends_no_request_line_is_cut_off_long_before_the_deadline(
    watched, monkeypatch
):
    monkeypatch.setattr(places, "DEADLINE", 1e9)
    monkeypatch.setattr(http, "DEADLINE", 1e9)

    def dawdle(port):
        with socket.create_connection(("127.0.0.1", port), LIMIT) as client:
            client.sendall(b"G")
            return client.recv(1)

    async def body():
        async with serving(watched) as url:
            await listening(url)
            return await asyncio.to_thread(dawdle, int(url.rpartition(":")[2]))

    assert asyncio.run(body()) == b""


def test_strangers_who_dawdle_leave_the_board_its_own_places(watched, monkeypatch):
    # All clients of a test are of this computer: here its second address stands for a stranger's
    monkeypatch.setattr(places, "is_loopback", lambda address: address == "127.0.0.1")
    monkeypatch.setattr(places, "LINE_WAIT", 1e9)

    def ask_beside_strangers(port, url):
        with contextlib.ExitStack() as stack:
            for n in range(40):
                source = (f"127.0.1.{1 + n % 4}", 0)
                client = socket.create_connection(("127.0.0.1", port), LIMIT, source)
                stack.enter_context(client).sendall(b"G")
            wait_until(lambda: len(watched.server._places) == places.PLACES - places.KEPT)
            return ask(url, "/healthz")[0]

    async def body():
        async with serving(watched) as url:
            await listening(url)
            return await asyncio.to_thread(ask_beside_strangers, int(url.rpartition(":")[2]), url)

    assert asyncio.run(body()) == 200


def test_a_wrong_token_waits_for_its_answer(watched, monkeypatch):
    from ekf_companion.daemon import access

    waits = []
    monkeypatch.setattr(access, "is_loopback", lambda address: False)
    monkeypatch.setattr(pages.time, "sleep", waits.append)

    async def body():
        async with serving(watched) as url:
            await listening_refused(url)
            waits.clear()
            return await asyncio.to_thread(ask, url, "/status?token=tomato")

    async def listening_refused(url):
        await asyncio.to_thread(wait_until, lambda: refuses(url))

    def refuses(url):
        with contextlib.suppress(OSError):
            return ask(url)[0] == 401

    assert asyncio.run(body())[0] == 401
    assert access.WRONG_TOKEN_WAIT in waits


def test_a_port_that_comes_free_is_taken(watched, monkeypatch):
    monkeypatch.setattr(http, "RETRY", 0.05)

    async def body():
        with socket.create_server(("127.0.0.1", 0)) as other:
            port = other.getsockname()[1]
            async with serving(watched, port=port) as url:
                await asyncio.sleep(0.3)
                other.close()
                await listening(url)

    asyncio.run(body())


def test_it_listens_on_ipv6_too(watched):
    if not socket.has_ipv6:
        pytest.skip("this machine has no IPv6")
    with socket.socket(socket.AF_INET6) as probe:
        try:
            probe.bind(("::1", 0))
        except OSError:
            pytest.skip("this machine has no address of IPv6")

    async def body():
        async with serving(watched, host="::1") as url:
            await listening(url)

    asyncio.run(body())


def test_port_zero_is_nobody():
    async def body():
        loop = asyncio.get_running_loop()
        assert open_http_server(HttpConfig(port=0), Watched().observer, loop) is None

    asyncio.run(body())


def test_it_is_closed_at_once(watched, monkeypatch):
    """Closing does not wait for the next connection, nor until the next look for one."""
    monkeypatch.setattr(http, "_POLL", 10.0 * LIMIT)

    async def body():
        async with serving(watched) as url:
            await listening(url)
        with pytest.raises(urllib.error.URLError):
            ask(url)
        assert not watched.server._thread.is_alive()

    asyncio.run(body())
