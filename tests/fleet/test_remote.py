"""Logs of stores: S3 by moto's server, a web server; what fails there; keys that nobody sees."""

import functools
import http.server
import json
import logging
import os
import subprocess
import sys
import threading
import urllib.request

import boto3
import pytest
from moto.server import ThreadedMotoServer

from ekf_companion.config.config import Config
from ekf_companion.errors import CompanionError, ConfigError, LogError
from ekf_companion.fleet import campaign, remote
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.load import load
from tests.daemon.waiting import LIMIT
from tests.fleet.in_place import InPlace
from tests.fleet.proxy import Proxy

KEY, SECRET = "AKIAOFATEST000000000", "sEcReT/0f+a/tEsT"


@pytest.fixture(scope="module")
def port():
    logging.getLogger("werkzeug").setLevel(logging.CRITICAL)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    yield server.get_host_and_port()[1]
    server.stop()


@pytest.fixture
def store(port, monkeypatch):
    """Return a client of an empty bucket ``logs``; the environment leads to its server."""
    point_to(port, monkeypatch)
    urllib.request.urlopen(f"http://127.0.0.1:{port}/moto-api/reset", b"").read()
    client = boto3.client("s3")
    client.create_bucket(Bucket="logs")
    return client


def point_to(port, monkeypatch, secret=SECRET):
    for name, value in (
        ("AWS_ACCESS_KEY_ID", KEY),
        ("AWS_SECRET_ACCESS_KEY", secret),
        ("AWS_DEFAULT_REGION", "us-east-1"),
        ("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}"),
    ):
        monkeypatch.setenv(name, value)
    from s3fs import S3FileSystem

    S3FileSystem.clear_instance_cache()


def batch(*words):
    """Run the command in a process of its own; return its exit code and all that it prints."""
    command = [sys.executable, "-m", "ekf_companion", "batch", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT)
    for hidden in (SECRET, KEY, "hunter2", "deadbeef"):
        assert hidden not in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.returncode, done.stderr + done.stdout


def fill(*names):
    """Fill the data set of the bucket, in this process; return the account's lines."""
    account = campaign.run(Listing(names), Config(), "s3://logs/results", InPlace())
    for hidden in (SECRET, KEY):
        assert hidden not in " ".join(account.lines())
    return account.lines()


@pytest.mark.campaign
def test_logs_of_a_bucket_become_a_data_set_in_a_bucket(store, flight):
    store.put_object(Bucket="logs", Key="day/a.tlog", Body=flight)
    store.put_object(Bucket="logs", Key="day/=b.tlog", Body=flight[: len(flight) // 2])
    store.put_object(Bucket="logs", Key="day/readme.md", Body=b"no log")
    code, text = batch("s3://logs/day", "-o", "s3://logs/results")
    assert (code, text.splitlines()[-1]) == (0, "2 logs: 2 estimated")
    rows = load("s3://logs/results").to_pylist()
    assert [row["log"] for row in rows] == ["s3://logs/day/=b.tlog", "s3://logs/day/a.tlog"]
    assert rows[1]["duration_s"] == pytest.approx(12.0, abs=0.2)
    names = [one["Key"] for one in store.list_objects_v2(Bucket="logs")["Contents"]]
    assert len([name for name in names if name.endswith(".parquet")]) == 3
    assert fill("s3://logs/day/*.tlog") == ["2 logs: 2 done before"]


@pytest.mark.campaign
def test_a_changed_object_is_read_again_and_the_old_row_stays(store, flight):
    store.put_object(Bucket="logs", Key="a.tlog", Body=flight)
    fill("s3://logs/a.tlog")
    store.put_object(Bucket="logs", Key="a.tlog", Body=flight[:-400])
    assert fill("s3://logs/a.tlog") == ["1 log: 1 estimated"]
    assert len(load("s3://logs/results")) == 2


def test_an_object_that_changes_while_it_is_read_is_read_again(store, port, flight, monkeypatch):
    large = flight + bytes(6 << 20)
    store.put_object(Bucket="logs", Key="a.tlog", Body=flight + bytes(6 << 20))
    changes = []

    def change_once(sent):
        if sent > 2 << 20 and not changes:
            changes.append(sent)
            store.put_object(Bucket="logs", Key="a.tlog", Body=large[: 5 << 20])
        return True

    with Proxy(port, change_once) as proxy:
        point_to(proxy.port, monkeypatch)
        with remote.fetched("s3://logs/a.tlog", "s3://logs/a.tlog") as path:
            assert path.read_bytes() == large[: 5 << 20]
    assert len(changes) == 1


@pytest.mark.campaign
def test_an_object_that_never_rests_is_left_for_the_next_run(store, port, flight, monkeypatch):
    store.put_object(Bucket="logs", Key="a.tlog", Body=flight + bytes(3 << 20))
    store.put_object(Bucket="logs", Key="b.tlog", Body=flight)
    before = [0]

    def change_often(sent):
        if sent - before[0] > 1 << 20:
            before[0] = sent
            store.put_object(
                Bucket="logs", Key="a.tlog", Body=flight + bytes((3 << 20) + sent % 99)
            )
        return True

    with Proxy(port, change_often) as proxy:
        point_to(proxy.port, monkeypatch)
        first, second = fill("s3://logs/*.tlog")
    assert first == "2 logs: 1 estimated, 1 unread"
    assert second.startswith("s3://logs/a.tlog: it changes while it is read")
    point_to(port, monkeypatch)
    assert fill("s3://logs/*.tlog") == ["2 logs: 1 estimated, 1 done before"]
    assert len(load("s3://logs/results")) == 2


def test_a_connection_that_is_cut_once_is_opened_again(store, port, flight, monkeypatch):
    store.put_object(Bucket="logs", Key="a.tlog", Body=flight + bytes(4 << 20))
    cuts = []

    def cut_once(sent):
        if sent > 1 << 20 and not cuts:
            cuts.append(sent)
            return False
        return True

    with Proxy(port, cut_once) as proxy:
        point_to(proxy.port, monkeypatch)
        with remote.fetched("s3://logs/a.tlog", "a.tlog") as path:
            assert path.stat().st_size == len(flight) + (4 << 20)
    assert len(cuts) == 1


def test_a_wrong_key_is_a_sentence_and_nothing_is_lost(store, port, flight):
    store.put_object(Bucket="logs", Key="a.tlog", Body=flight)
    ask_for_keys(port, "0")
    try:
        code, text = batch("s3://logs/a.tlog", "-o", "s3://logs/results")
    finally:
        ask_for_keys(port, "inf")
    assert code == 3
    assert "access is refused; check the key of whoever reads it" in text
    assert fill("s3://logs/a.tlog") == ["1 log: 1 estimated"]


def ask_for_keys(port, after):
    """Let the server refuse keys that it does not know, after so many requests."""
    url = f"http://127.0.0.1:{port}/moto-api/reset-auth"
    plain = urllib.request.Request(url, after.encode(), {"Content-Type": "text/plain"})
    urllib.request.urlopen(plain).read()


def test_what_is_not_there_is_a_sentence(store):
    for url in ("s3://logs/none.tlog", "s3://logs/none", "s3://nobody/x"):
        with pytest.raises(LogError, match="no such object"):
            list(Listing([url]))
    with pytest.raises(ConfigError, match="no store is known by this name"):
        list(Listing(["ftpx://host/a.tlog"]))


class Refusing(http.server.SimpleHTTPRequestHandler):
    """Serves files, some only to those who sign."""

    def log_message(self, *_):
        """Write no log."""

    def do_GET(self):
        self.answer(super().do_GET)

    def do_HEAD(self):
        self.answer(super().do_HEAD)

    def answer(self, serve):
        if "b.tlog" in self.path and "sig=deadbeef" not in self.path:
            self.send_error(403)
        else:
            serve()


@pytest.fixture
def web(tmp_path, flight):
    (tmp_path / "web").mkdir()
    for name in ("a.tlog", "b.tlog"):
        (tmp_path / "web" / name).write_bytes(flight)
    handler = functools.partial(Refusing, directory=str(tmp_path / "web"))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_address[1]
    server.shutdown()
    server.server_close()


def test_a_signed_address_is_read_and_shown_without_its_signature(web, tmp_path):
    url, table = f"http://127.0.0.1:{web}/b.tlog", tmp_path / "t.csv"
    names = [f"{url}?sig=deadbeef", f"http://user:hunter2@127.0.0.1:{web}/a.tlog"]
    code, text = batch(*names, "-o", str(table))
    assert code == 0
    assert f"{url}  12 s, " in text
    assert "deadbeef" not in table.read_text()
    assert "hunter2" not in table.read_text()
    with pytest.raises(CompanionError, match=r"b\.tlog: (access is refused|no such)") as caught:
        list(Listing([f"{url}?sig=hunter2"]))
    assert "hunter2" not in str(caught.value)


def test_a_list_of_flight_review_is_streamed_with_what_it_says_of_each(web, tmp_path, flight):
    entries = [
        {
            "log_id": "0f1e-22",
            "airframe_name": "X500",
            "sys_hw": "PX4_FMU_V6C",
            "ver_sw_release": "v1.16",
        },
        {
            "log_id": "0f1e-23",
            "url": f"http://127.0.0.1:{web}/b.tlog?sig=deadbeef",
            "vehicle_uuid": "=1+1",
        },
    ]
    path = tmp_path / "dbinfo.json"
    path.write_text(json.dumps(entries))
    first, second = Listing([f"@{path}"])
    assert (first.name, first.place) == (
        "0f1e-22.ulg",
        "https://review.px4.io/download?log=0f1e-22",
    )
    assert dict(first.about) == {"airframe": "X500", "hardware": "PX4_FMU_V6C", "firmware": "v1.16"}
    assert dict(second.about) == {"vehicle": "./=1+1"}
    assert "deadbeef" not in repr(second)
    path.write_text(json.dumps(entries)[:-30])
    with pytest.raises(ConfigError, match="is damaged, or cut short, after 1 entries"):
        list(Listing([f"@{path}"]))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1]", "entry 1 is no object"),
        ('[{"log_id": "../../etc/passwd"}]', "names no log_id of letters"),
        ('[{"log_id": 7}]', "names no log_id of letters"),
        ("[" * 100_000, "is damaged, or cut short"),
        ('[{"log_id": "' + "x" * (1 << 21), "is damaged, or cut short"),
        ("x" * (1 << 21), "it is no list"),
        ("none.tlog\n", "no such file or folder"),
        ("y" * 5000, r"y\.\.\.: no such file or folder"),
        ("a\0b.tlog", r"a\\x00b\.tlog: no such file or folder"),
        ("\x1b[2J.tlog", r"\\x1b\[2J\.tlog: no such file or folder"),
        ('[{"log_id": "../a", "url": "a\\u0000b"}]', "names no log_id of letters"),
        ("@" + "z" * 5000, "the list cannot be read: File name too long"),
        ("", "no log in there"),
        ("@LIST\n", "a list in a list"),
    ],
)
def test_a_hostile_list_is_a_sentence(tmp_path, text, words):
    path = tmp_path / "list"
    path.write_text(text.replace("LIST", str(path)))
    with pytest.raises(ConfigError, match=words):
        list(Listing([f"@{path}"]))


def test_a_list_of_names_has_each_once(tmp_path):
    for name in ("a.tlog", "b.tlog"):
        (tmp_path / name).write_bytes(b"x")
    path = tmp_path / "list.txt"
    path.write_text(f"# mine\n{tmp_path}/b.tlog\r\n\n{tmp_path}\n")
    listing = Listing([f"@{path}"])
    assert [os.path.basename(one.name) for one in listing] == ["b.tlog", "a.tlog"]
    assert listing.total() == (2, 4)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("s3://b/a#1.tlog", "s3://b/a#1.tlog"),
        ("s3://b/a?1.tlog", "s3://b/a?1.tlog"),
        ("s3://b/a%41.tlog", "s3://b/a%41.tlog"),
        ("s3://b/a\nb.tlog", r"s3://b/a\nb.tlog"),
        ("s3://b/mail@x.tlog", "s3://b/mail@x.tlog"),
        ("s3://b/a.tlog?X-Amz-Signature=deadbeef", "s3://b/a.tlog"),
        (f"s3://{KEY}:{SECRET}@b/a.tlog", "s3://b/a.tlog"),
        ("https://user:hunter2@h:80/a%23.tlog?sig=deadbeef", "https://h:80/a#.tlog"),
        ("https://user:hun?ter2@h/a.tlog", "https://h/a.tlog"),
        ("https://[::1]:80/a@b.tlog", "https://[::1]:80/a@b.tlog"),
        ("https://h/%1b%5b2J.tlog", r"https://h/\x1b[2J.tlog"),
        ("https:/user:hunter2@h/a", "https:/h/a"),
        ("simplecache::https://user:hunter2@h/a", "simplecache::https://h/a"),
        ("user:hunter2@h:8786", "h:8786"),
        ("local", "local"),
    ],
)
def test_an_address_is_shown_without_its_secrets_and_no_two_keys_alike(url, words):
    assert remote.shown(url) == words


@pytest.mark.parametrize("begin", ["simplecache::https://", " https://", "'https://", "https:/"])
@pytest.mark.parametrize("is_list", [False, True])
def test_what_is_nearly_a_url_shows_no_secret_either(begin, is_list):
    with pytest.raises(ConfigError) as caught:
        list(Listing([f"{'@' if is_list else ''}{begin}user:hunter2@127.0.0.1:1/a.tlog"]))
    assert "hunter2" not in str(caught.value)
    assert "no store is known by this name" in str(caught.value)


def test_a_data_set_that_is_not_there_is_shown_without_its_secrets(web):
    place = f"http://user:hunter2@127.0.0.1:{web}/none/"
    with pytest.raises(CompanionError) as caught:
        load(place)
    assert "hunter2" not in str(caught.value)


@pytest.mark.campaign
def test_keys_of_odd_letters_are_logs_of_their_own(store, flight):
    keys = ["a#1.tlog", "a#2.tlog", "a%41.tlog", "aA.tlog", "a[1].tlog", "a?1.tlog", "a b.tlog"]
    for key in keys:
        store.put_object(Bucket="logs", Key=key, Body=flight)
    found = list(Listing(["s3://logs/"]))
    assert {one.name for one in found} == {f"s3://logs/{key}" for key in keys}
    for key in keys:
        (alone,) = Listing([f"s3://logs/{key}"])
        assert alone.name == f"s3://logs/{key}"
        with alone.opened() as path:
            assert path.read_bytes() == flight


def test_a_full_disk_is_named_as_one():
    with (
        pytest.raises(CompanionError, match="no space for a copy of it is left in") as caught,
        remote.sentences("s3://a/b.tlog"),
        open("/dev/full", "wb", buffering=0) as full,
    ):
        full.write(b"x")
    assert "connection" not in str(caught.value)


def test_no_error_of_a_store_s_package_comes_through():
    class SignedError(Exception):
        """Whose text is a signed URL."""

    with pytest.raises(CompanionError) as caught, remote.sentences("s3://a/b"):
        raise SignedError(f"GET https://a/b?Signature={SECRET}")
    assert SECRET not in str(caught.value)
    assert caught.value.__suppress_context__
    assert caught.value.__cause__ is None
