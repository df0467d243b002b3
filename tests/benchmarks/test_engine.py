"""The engines of campaigns."""

import subprocess
import sys

import pytest

from benchmarks.engine import in_order
from tests.paths import ROOT


def reciprocal(number):
    return 1.0 / number


@pytest.mark.parametrize("engine", ["", "processes", "dask"])
def test_results_come_in_the_order_of_the_jobs(monkeypatch, engine):
    monkeypatch.setenv("ENGINE", engine)
    assert list(in_order(reciprocal, [4, 2, 1, 8], 2)) == [0.25, 0.5, 1.0, 0.125]


@pytest.mark.parametrize("engine", ["processes", "dask"])
def test_a_job_that_fails_is_named(monkeypatch, engine):
    monkeypatch.setenv("ENGINE", engine)
    results = in_order(reciprocal, [1, 0], 2)
    with pytest.raises(RuntimeError, match="0: a bug: ZeroDivisionError"):
        list(results)


@pytest.mark.parametrize("engine", ["Dask", "thread", "processes "])
def test_an_engine_that_there_is_not_is_refused(monkeypatch, engine):
    monkeypatch.setenv("ENGINE", engine)
    with pytest.raises(SystemExit, match="none of processes, dask"):
        list(in_order(reciprocal, [1], 1))


@pytest.mark.campaign
def test_the_truth_is_the_same_by_dask(monkeypatch):
    command = [sys.executable, "-m", "benchmarks.truth", "--seeds", "2", "--only", "fig8", "hover"]
    found = {}
    for engine in ("processes", "dask"):
        monkeypatch.setenv("ENGINE", engine)
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        found[engine] = done.stdout
    assert found["dask"] == found["processes"]
    assert found["dask"].count("fig8") == found["dask"].count("hover") == 1
