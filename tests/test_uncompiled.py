"""A folder of sources that nobody has compiled says what to do."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ekf_companion

WITHOUT_CYTHON = "import sys; sys.modules['cython'] = None; "


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Return a folder with the package as it comes, without what was compiled of it."""
    folder = tmp_path_factory.mktemp("checkout")
    compiled = shutil.ignore_patterns("*.so", "*.c", "__pycache__")
    package = Path(ekf_companion.__file__).parent
    shutil.copytree(package, folder / "ekf_companion", ignore=compiled)
    (folder / "ekf_companion/core/order/dispatch.py").unlink()
    return folder


def run(folder, code, *options):
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, *options, "-c", code]
    return subprocess.run(
        command, check=False, cwd=folder, env=environment, capture_output=True, text=True
    )


@pytest.mark.parametrize(
    "code",
    [
        "from ekf_companion import estimate",
        "from ekf_companion import Stream",
        "import ekf_companion.core",
        "import ekf_companion.mavlink.session",
        "from ekf_companion.logs import tlog",
    ],
)
def test_sources_that_nothing_runs_say_make_setup(sources, code):
    done = run(sources, WITHOUT_CYTHON + code)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert f"ekf_companion in {sources} is not compiled for {sys.executable}" in last
    assert re.search(r"`make -C \S+ setup` compiles it", last)
    assert "NotCompiledError" in last


def test_a_command_says_it_in_one_sentence(sources):
    code = WITHOUT_CYTHON + "from ekf_companion.cli import app; app(['report', 'a.csv'])"
    done = run(sources, code)
    assert done.returncode == 1
    assert done.stderr.startswith(f"ekf-companion: ekf_companion in {sources} is not compiled")
    assert len(done.stderr.splitlines()) == 1


def test_sources_that_are_interpreted_warn_of_the_time_that_takes(sources):
    done = run(sources, "import ekf_companion.core", "-W", "default")
    assert done.returncode == 0, done.stderr
    assert re.search(r"`make -C \S+ setup`", done.stderr)
    assert "some hundred times slower" in done.stderr


def test_what_is_compiled_says_nothing():
    done = run(Path(ekf_companion.__file__).parents[1], "import ekf_companion.core", "-W", "error")
    assert (done.returncode, done.stderr) == (0, "")


def test_what_a_build_writes_is_made_in_memory_where_there_was_none(sources):
    code = "from ekf_companion.core.order import dispatch as d; print(d.aid_of(4), d.aid_of(1))"
    done = run(sources, "import ekf_companion.core; " + code, "-W", "ignore")
    assert done.stdout == "4 -1\n", done.stderr
