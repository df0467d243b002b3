"""The executor of a Dask cluster, with real workers, one of which is killed."""

import logging
import socket
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import islice
from pathlib import Path

import pytest
from distributed import Client, LocalCluster

from ekf_companion.errors import ConfigError, UnreachableError
from ekf_companion.fleet.dask_executor import Dask, local_cluster
from ekf_companion.fleet.executor import KILLED, Lost, Processes
from tests.fleet import batch_tasks

QUIET = {"dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL}


@pytest.fixture(scope="module")
def cluster():
    with local_cluster(2) as cluster:
        yield cluster


def test_every_item_has_its_result(cluster):
    found = dict(Dask(cluster.scheduler_address, 1).run(batch_tasks.double, range(100)))
    assert found == {number: 2 * number for number in range(100)}


def test_workers_keep_the_memory_that_the_next_log_takes(cluster):
    with Client(cluster) as client:
        (faults, pages), *_ = client.run(batch_tasks.faults_and_pages, 800_000).values()
    assert faults < 0.1 * pages


def test_a_worker_that_is_killed_costs_its_items_again(cluster, tmp_path):
    found = {}
    for number, result in Dask(cluster.scheduler_address, 1).run(
        partial(batch_tasks.die_once, folder=tmp_path), range(40)
    ):
        found[number] = result
    assert found == {number: 2 * number for number in range(40)}
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.campaign
def test_an_item_that_kills_each_worker_stops_no_other(cluster):
    names = map(Path, "abc")
    found = {
        one.name: result
        for one, result in Dask(cluster.scheduler_address, 1).run(batch_tasks.kill_at_b, names)
    }
    assert found["a"] == found["c"] == {"why": "examined"}
    assert found["b"] == Lost(KILLED)


def test_a_bug_is_named(cluster):
    names = map(Path, "abc")
    found = {
        one.name: result
        for one, result in Dask(cluster.scheduler_address, 1).run(batch_tasks.stumble_at_b, names)
    }
    assert found["b"].why == "a bug: ZeroDivisionError: by nothing"


def test_no_scheduler_and_no_worker_are_sentences(monkeypatch):
    monkeypatch.setattr("ekf_companion.fleet.dask_executor.PATIENCE_S", 0.5)
    with pytest.raises(ConfigError, match="no Dask scheduler answers there"):
        list(Dask("tcp://127.0.0.1:9", 1).run(batch_tasks.double, [1]))
    empty = LocalCluster(n_workers=0, **QUIET)
    with empty, pytest.raises(ConfigError, match="the scheduler has no worker"):
        list(Dask(empty.scheduler_address, 1).run(batch_tasks.double, [1]))


@contextmanager
def scheduler(port):
    """Run a scheduler at a port, in a process of its own."""
    words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    command = [sys.executable, "-m", "dask", *words]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.campaign
@pytest.mark.parametrize("begins_again", [False, True])
def test_a_scheduler_that_is_lost_is_a_sentence_and_no_log_s_failure(begins_again):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    command = [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--no-dashboard"]
    with ExitStack() as running:
        first = running.enter_context(scheduler(port))
        worker = running.enter_context(subprocess.Popen(command, stderr=subprocess.DEVNULL))
        running.callback(worker.kill)
        work = Dask(address, 1).run(batch_tasks.double, range(100_000))
        found = [result for _, result in islice(work, 100)]
        first.kill()
        first.wait()
        if begins_again:
            running.enter_context(scheduler(port))
        with pytest.raises(UnreachableError, match="the scheduler was lost"):
            found.extend(result for _, result in work)
        assert not any(isinstance(one, Lost) for one in found)


def test_workers_of_another_version_are_refused(cluster):
    with Client(cluster) as client:
        client.run(batch_tasks.pretend, "9.9-00000000")
        try:
            with pytest.raises(ConfigError, match=r"have 9\.9-0+, and this is .*same on all"):
                list(Dask(cluster.scheduler_address, 1).run(batch_tasks.double, [1]))
        finally:
            client.run(batch_tasks.pretend, None)


@pytest.mark.parametrize("jobs", [1, 2])
def test_processes_take_items_as_they_have_room(jobs):
    taken = []

    def items():
        for number in range(20):
            taken.append(number)
            yield number

    for done, _ in enumerate(Processes(jobs).run(batch_tasks.double, items()), 1):
        assert len(taken) <= done + jobs
    assert len(taken) == 20


def test_a_process_that_dies_costs_its_own_item_again(tmp_path):
    task = partial(batch_tasks.die_once, folder=tmp_path)
    assert dict(Processes(2).run(task, range(10))) == {n: 2 * n for n in range(10)}
    runs = [int(path.name.split("-")[0]) for path in tmp_path.iterdir()]
    assert len(runs) == 1
