"""That a checkout compiles each module once, and then what was changed."""

import re
import shutil
import subprocess
import sys
import zipfile

import pytest

from ekf_companion.core.memory.signatures import compiled_modules
from tests.daemon.waiting import LIMIT
from tests.paths import ROOT

pytestmark = pytest.mark.campaign

COMPILED = ("logs/csv_lines", "nav/repetition")
"""Short modules; neither needs another."""


@pytest.fixture
def checkout(tmp_path):
    """Return a checkout that compiles two short modules and none of the kernel."""
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    for folder in ("ekf_companion", "sim_autopilot", "systemd"):
        others = shutil.ignore_patterns("*.so", "*.c", "*.pxd", "__pycache__")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=others)
    for name in {one.replace(".", "/") for one in compiled_modules()} - {*COMPILED}:
        (tmp_path / f"ekf_companion/{name}.py").unlink()
    for name in ("uPlot.js", "uPlot.css", "uPlot.LICENSE.txt"):
        (tmp_path / "ekf_companion/status/page" / name).touch()
    return tmp_path


def compiled(folder, *command):
    """Run setup.py as pip and make do; return the modules that it compiled."""
    made = subprocess.run(
        [sys.executable, "-W", "ignore", "setup.py", "--quiet", *command],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=2 * LIMIT,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    return sorted(re.findall(r"Compiling (?:ekf_companion/)?(\S+)\.py because", made.stdout))


def modules(folder):
    """Return the modules that were compiled, and when each was."""
    built = (folder / "build/kernel").rglob("*.so")
    return {path.name.partition(".")[0]: path.stat().st_mtime_ns for path in built}


def test_an_editable_installation_and_make_compile_once(checkout):
    assert compiled(checkout, "editable_wheel", "--dist-dir", "dist") == sorted(COMPILED)
    first = modules(checkout)
    assert {*first} == {"csv_lines", "repetition"}
    assert len(list((checkout / "ekf_companion").rglob("*.so"))) == len(COMPILED)

    assert compiled(checkout, "build_ext", "--inplace") == []
    assert compiled(checkout, "editable_wheel", "--dist-dir", "dist") == []
    assert modules(checkout) == first


def test_a_wheel_and_make_compile_once(checkout):
    assert compiled(checkout, "bdist_wheel", "--dist-dir", "dist") == sorted(COMPILED)
    first = modules(checkout)
    assert {*first} == {"csv_lines", "repetition"}

    compiled(checkout, "build_ext", "--inplace")
    assert modules(checkout) == first
    with zipfile.ZipFile(next((checkout / "dist").glob("*.whl"))) as wheel:
        packed = {name.partition(".")[0] for name in wheel.namelist() if name.endswith(".so")}
    assert packed == {f"ekf_companion/{name}" for name in COMPILED}


def test_an_edited_module_is_compiled_alone(checkout):
    compiled(checkout, "build_ext", "--inplace")
    first = modules(checkout)
    source = checkout / "ekf_companion/logs/csv_lines.py"
    source.write_text(source.read_text() + "\n")

    assert compiled(checkout, "build_ext", "--inplace") == ["logs/csv_lines"]
    after = modules(checkout)
    assert after["csv_lines"] > first["csv_lines"]
    assert after["repetition"] == first["repetition"]


def test_new_times_of_the_compilers_own_headers_compile_nothing(checkout):
    """Each environment of pip's has them anew; the version of Cython is asked for beside them."""
    compiled(checkout, "build_ext", "--inplace")
    later = "import os, Cython, pathlib; [os.utime(p) for p in pathlib.Path(Cython.__file__).parent"
    subprocess.run([sys.executable, "-c", f"{later}.glob('Includes/libc/*.pxd')]"], check=True)

    assert compiled(checkout, "build_ext", "--inplace") == []


def test_another_way_to_compile_compiles_all(checkout):
    compiled(checkout, "build_ext", "--inplace")
    first = modules(checkout)
    (checkout / "setup.py").touch()

    compiled(checkout, "build_ext", "--inplace")
    after = modules(checkout)
    assert all(after[name] > first[name] for name in first)


def test_pip_names_the_folder_of_a_checkout_where_type_checkers_look(checkout):
    """Mypy and pyright follow a path in a .pth file, and no finder."""
    compiled(checkout, "editable_wheel", "--dist-dir", "dist")
    wheel = next((checkout / "dist").glob("*.whl"))
    shutil.unpack_archive(wheel, checkout / "wheel", "zip")
    (path,) = (checkout / "wheel").glob("*.pth")
    assert path.read_text().strip() == str(checkout)
    assert (checkout / "ekf_companion/py.typed").is_file()
