"""An installation without extras: what works, and which sentence the rest ends in."""

import json
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from scipy.signal import welch
from typer.testing import CliRunner

from ekf_companion.analysis.flight_review import SEGMENT, _densities
from sim_autopilot.__main__ import app as simulator
from tests.daemon.test_daemon import free_port
from tests.daemon.waiting import LIMIT
from tests.paths import ROOT

pytestmark = pytest.mark.campaign

OF_EXTRAS = (
    *("bokeh", "matplotlib", "mcap", "pandas", "pyarrow", "pymavlink", "scipy", "vqf"),
    *("lxml", "zstandard", "tornado", "PIL"),
)
"""What `pip install ekf-companion` does not bring."""
BARE = (
    f"import sys\nfor name in {OF_EXTRAS!r}:\n    sys.modules[name] = None\n"
    "from {module} import app\nsys.argv[0] = '{module}'\napp()\n"
)


def bare(*arguments, module="ekf_companion.cli"):
    """Run a command where none of the extras is installed."""
    command = [sys.executable, "-c", BARE.format(module=module), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("bare") / "flight.tlog"
    made = CliRunner().invoke(simulator, ["generate", "--duration", "15", "-o", str(path)])
    assert made.exit_code == 0, made.output
    return path


def requirements(extra):
    """Return the names that the metadata lists for an extra."""
    text = (ROOT / "pyproject.toml").read_text()
    return re.findall(r'"([\w-]+)', re.search(rf"^{extra} = \[(.*?)\]", text, re.M | re.S)[1])


@pytest.mark.parametrize(
    ("arguments", "package", "extra"),
    [
        (["report", "LOG", "-o", "OUT.html"], "bokeh", "report"),
        (["convert", "LOG", "-o", "OUT.mcap"], "mcap", "formats"),
        (["convert", "LOG", "-o", "OUT.parquet"], "pyarrow", "formats"),
        (["convert", "LOG", "-o", "OUT.csv", "--filter", "euler"], "scipy", "filters"),
        (["convert", "LOG", "-o", "OUT.csv", "--filter", "iterated"], "scipy", "filters"),
        (["convert", "LOG", "-o", "OUT.csv", "--filter", "vqf"], "vqf", "filters"),
        (["compare", "LOG", "--skip", "5", "--plot", "OUT.png"], "matplotlib", "plot"),
        (["calibrate", "noise", "LOG"], "scipy", "calibrate"),
        (["calibrate", "delay", "LOG"], "scipy", "calibrate"),
        (["calibrate", "mag", "LOG"], "scipy", "calibrate"),
    ],
)
def test_a_command_without_its_extra_names_the_one_to_install(
    tmp_path, log, arguments, package, extra
):
    places = {"LOG": str(log), "OUT": str(tmp_path / "out")}
    done = bare(*(re.sub("LOG|OUT", lambda it: places[it[0]], one) for one in arguments))
    assert done.returncode == 1, done.stderr
    sentence = f"needs {package}, which is not installed: {sys.executable} -m pip install "
    assert f"{sentence}'ekf-companion[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr
    assert package in requirements(extra)
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".csv"]


def test_a_generated_flight_names_its_extra(tmp_path):
    done = bare("generate", "-o", tmp_path / "flight.tlog", module="sim_autopilot.__main__")
    assert done.returncode == 2
    assert "pip install 'ekf-companion[sim]'" in "".join(done.stderr.split("\n"))
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("name", ["eskf", "ukf", "ahrs", "mahony"])
def test_logs_are_converted_without_any_extra(tmp_path, log, name):
    done = bare("convert", log, "-o", tmp_path / "out.csv", "--filter", name)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.csv").stat().st_size > 100_000


def test_the_daemon_flies_without_any_extra(tmp_path):
    """Against the fake autopilot, over real UDP."""
    port, http = free_port(), free_port()
    config = tmp_path / "config.yaml"
    config.write_text(f"http: {{port: {http}}}\n")
    link = f"udpin:127.0.0.1:{port}"
    code = BARE.format(module="ekf_companion.cli")
    run = ["run", "--link", link, "--config", config, "--record", tmp_path / "flown.tlog"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *run], stderr=subprocess.PIPE, text=True
    ) as daemon:
        try:
            fly = [
                "-m",
                "sim_autopilot",
                "fly",
                "--scenario",
                "hover",
                "--duration",
                "8",
                "--wait",
                "60",
            ]
            score = tmp_path / "score.json"
            flown = subprocess.run(
                [sys.executable, *fly, "--link", f"udpout:127.0.0.1:{port}", "--score", score],
                capture_output=True,
                text=True,
                check=False,
                timeout=LIMIT,
            )
        finally:
            daemon.send_signal(signal.SIGTERM)
            said = daemon.communicate(timeout=LIMIT)[1]
    assert daemon.returncode == 0, said
    assert "Estimate is OK" in said
    assert json.loads(score.read_text())["odometry"]["received"] > 30, flown.stderr
    done = bare("convert", tmp_path / "flown.tlog", "-o", tmp_path / "flown.csv")
    assert done.returncode == 0, done.stderr


def test_the_spectrum_is_scipys():
    rng = np.random.default_rng(3)
    samples = np.cumsum(rng.standard_normal((5 * SEGMENT + 77, 3)), axis=0)
    theirs = welch(samples, fs=200.0, nperseg=SEGMENT, axis=0)[1]
    np.testing.assert_allclose(_densities(samples, 200.0), theirs, rtol=1e-9)
