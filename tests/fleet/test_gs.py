"""Logs of ``gs://``, by an emulator of its store; without gcsfs, the sentence that names it."""

import importlib.util
import socket
from contextlib import closing

import pytest

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError, MissingPackageError
from ekf_companion.fleet import campaign, remote
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.load import load
from tests.fleet.in_place import InPlace

HAS_GCSFS = importlib.util.find_spec("gcsfs") is not None


@pytest.fixture
def bucket(monkeypatch):
    """Return a file system with an empty bucket ``logs``; the environment leads to its server."""
    server = pytest.importorskip("gcp_storage_emulator.server")
    gcsfs = pytest.importorskip("gcsfs")
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    running = server.create_server("127.0.0.1", port, in_memory=True, default_bucket="logs")
    running.start()
    monkeypatch.setenv("STORAGE_EMULATOR_HOST", f"http://127.0.0.1:{port}")
    gcsfs.GCSFileSystem.clear_instance_cache()
    yield gcsfs.GCSFileSystem()
    running.stop()
    gcsfs.GCSFileSystem.clear_instance_cache()


def fill(*names):
    """Fill the data set of the bucket; return the account's lines."""
    return campaign.run(Listing(names), Config(), "gs://logs/results", InPlace()).lines()


def test_logs_of_a_bucket_become_a_data_set_in_a_bucket(bucket, flight):
    bucket.pipe("logs/day/a.tlog", flight)
    bucket.pipe("logs/day/b.tlog", flight[: len(flight) // 2])
    bucket.pipe("logs/day/readme.md", b"no log")
    assert fill("gs://logs/day") == ["2 logs: 2 estimated"]
    rows = load("gs://logs/results").to_pylist()
    assert [row["log"] for row in rows] == ["gs://logs/day/a.tlog", "gs://logs/day/b.tlog"]
    assert rows[0]["duration_s"] == pytest.approx(12.0, abs=0.2)
    assert fill("gs://logs/day/*.tlog") == ["2 logs: 2 done before"]
    bucket.pipe("logs/day/b.tlog", flight[: len(flight) // 3])
    assert fill("gs://logs/day") == ["2 logs: 1 estimated, 1 done before"]


def test_what_is_not_there_is_a_sentence(bucket):
    with pytest.raises(LogError, match=r"^gs://logs/none\.tlog: no such object"):
        list(remote.find("gs://logs/none.tlog"))
    bucket.pipe("logs/day/readme.md", b"no log")
    with pytest.raises(LogError, match=r"^gs://logs/day: no log there"):
        list(remote.find("gs://logs/day"))


@pytest.mark.skipif(HAS_GCSFS, reason="gcsfs is installed")
def test_without_its_package_the_package_is_named():
    with pytest.raises(
        MissingPackageError, match=r"^gs://logs: needs gcsfs, which is not installed"
    ):
        list(remote.find("gs://logs"))
