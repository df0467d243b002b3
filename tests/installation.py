"""`make install` into a folder that stands for /, and away again. `make installcheck` runs this."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.manual import COMPLETIONS, MAN, SHARE
from tests.paths import ROOT

ROOTS_HOME = Path("~root").expanduser()
NAME = "ekf_companion-0.1.0"


def make_wheel(folder):
    """Pack what a wheel holds, compiled parts as they are here: building one takes minutes."""
    path = folder / f"{NAME}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for package in ("ekf_companion", "sim_autopilot"):
            for file in sorted((ROOT / package).rglob("*")):
                if file.suffix in (".py", ".so", ".pxd", ".txt"):
                    wheel.write(file, file.relative_to(ROOT))
        scripts = "[console_scripts]\nekf-companion = ekf_companion.cli:app\n"
        wheel.writestr(f"{NAME}.dist-info/entry_points.txt", scripts)
        about = "Metadata-Version: 2.1\nName: ekf-companion\nVersion: 0.1.0\n"
        wheel.writestr(f"{NAME}.dist-info/METADATA", about)
        kind = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        wheel.writestr(f"{NAME}.dist-info/WHEEL", kind)
        names = "".join(f"{name},,\n" for name in wheel.namelist())
        wheel.writestr(f"{NAME}.dist-info/RECORD", names)
    return path


def make(target, **settings):
    result = subprocess.run(
        ["make", "--no-print-directory", target, *(f"{k}={v}" for k, v in settings.items())],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "MAKE"))},
        preexec_fn=lambda: os.umask(0o077),  # as a strict root has it
    )
    return result.returncode, result.stdout + result.stderr


class Staged:
    """An installation under DESTDIR."""

    def __init__(self, folder):
        self.root, self.prefix = folder / "root", folder / "opt" / "ekf"
        self.place = Path(f"{self.root}{self.prefix}")
        self.settings = {
            "DESTDIR": self.root,
            "PREFIX": self.prefix,
            "WHEEL": make_wheel(folder),
            "PIP_FLAGS": "--no-index --no-deps",
            "LOCK": "none",
            "PYTHON": sys.executable,
        }
        self.units = self.root / "etc/systemd/system"
        self.config = self.root / "etc/ekf-companion/config.yaml"
        self.rule = self.root / "etc/udev/rules.d/70-ekf-companion.rules"


@pytest.fixture(scope="module")
def staged(tmp_path_factory):
    it = Staged(tmp_path_factory.mktemp("staged"))
    code, words = make("install", CONFIG="config/ardupilot.yaml", **it.settings)
    assert code == 0, words
    assert f"{it.config}: new; set link.url in it" in words
    return it


def test_everything_is_in_its_place(staged):
    for name in ("ekf-companion.service", "ekf-companion@.service", "ekf-companion-lidar.service"):
        unit = (staged.units / name).read_text()
        assert f"ExecStart={staged.prefix}/bin/ekf-companion run" in unit
        assert "/opt/ekf-companion" not in unit
    assert staged.config.read_bytes() == (ROOT / "config/ardupilot.yaml").read_bytes()
    assert staged.rule.read_bytes() == (ROOT / "systemd/70-ekf-companion.rules").read_bytes()
    share = staged.place / "share/ekf-companion"
    for name in ("px4.yaml", "reference.yaml"):
        assert (share / "config" / name).exists()
    assert (share / "drop-ins/signing.conf").exists()
    assert (share / "mavlink-router.conf").exists()


def test_the_command_its_man_page_and_its_completions_are_found(staged):
    link = staged.root / "usr/local/bin/ekf-companion"
    assert str(link.readlink()) == f"{staged.prefix}/bin/ekf-companion"
    for path in (MAN, *COMPLETIONS.values()):
        there = staged.root / "usr/local/share" / path.relative_to(SHARE)
        assert there.read_bytes() == path.read_bytes()


def test_whoever_runs_the_service_may_read_and_run_it(staged):
    for path in [staged.root, *staged.root.rglob("*")]:
        if not path.is_symlink():
            mode, least = path.stat().st_mode, 0o755 if path.is_dir() else 0o644
            assert mode & least == least, path
    assert (staged.place / "bin" / "ekf-companion").stat().st_mode & 0o005 == 0o005


def test_nothing_points_back_into_the_folder_that_stood_for_root(staged):
    named = subprocess.run(
        ["grep", "-rlF", str(staged.root), str(staged.root)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert named.stdout == ""
    program = staged.place / "bin" / "ekf-companion"
    assert f"{staged.prefix}/bin/python" in program.read_text()
    # Compiled for good: the service may not write there
    assert list(
        staged.place.glob("lib/*/site-packages/ekf_companion/daemon/__pycache__/daemon.*.pyc")
    )


def test_moved_to_where_it_belongs_it_runs(staged):
    staged.prefix.parent.mkdir()
    staged.place.rename(staged.prefix)
    try:
        dependencies = [path for path in sys.path if path.endswith("site-packages")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(dependencies)}
        result = subprocess.run(
            [staged.prefix / "bin/ekf-companion", "check-config", staged.config],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            cwd=staged.root,
        )
        assert result.returncode == 0, result.stderr
        assert "component_id: 194" in result.stdout
    finally:
        staged.prefix.rename(staged.place)


def test_a_second_time_it_keeps_the_configuration_and_then_leaves_it_behind(staged):
    staged.config.write_text("link: {component_id: 191}\n")
    code, words = make("install", **staged.settings)
    assert code == 0, words
    assert f"{staged.config}: kept as it is" in words
    assert staged.config.read_text() == "link: {component_id: 191}\n"

    code, words = make("uninstall", **staged.settings)
    assert code == 0, words
    assert f"Kept, for you to delete: {staged.config.parent}," in words
    left = [path for path in staged.root.rglob("*") if path.is_file()]
    assert left == [staged.config]
    assert not (staged.root / "usr/local/bin/ekf-companion").is_symlink()
    assert not staged.place.exists()


def make_python(folder, home):
    """Return a Python that lives somewhere, and would make no environment."""
    path = folder / "python"
    path.write_text(f'#!/bin/sh\n[ "$1" = -c ] && echo {home}\n')
    path.chmod(0o755)
    return path


@pytest.mark.parametrize(
    ("prefix", "home", "words"),
    [
        ("/home/pilot/ekf", "/usr", "PREFIX=/home/pilot/ekf: is in /home/pilot/ekf, and the serv"),
        ("/opt/nowhere/ekf", "/home/pilot/.pyenv/versions/3.12.1", "is in /home/pilot/.pyenv/vers"),
        (
            "/opt/nowhere/ekf",
            ROOTS_HOME / ".local/share/uv",
            "name one of the system's, as in PYTHON=",
        ),
    ],
)
def test_what_the_service_cannot_see_is_no_place_for_it(tmp_path, prefix, home, words):
    """ProtectHome=yes hides it: the unit would fail each second, 203/EXEC."""
    code, said = make("install", PREFIX=prefix, PYTHON=make_python(tmp_path, home))
    assert code != 0
    assert words in said
    assert "the service sees nobody's home" in said
    assert not Path(prefix).exists()


@pytest.mark.parametrize("target", ["install", "uninstall"])
def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path, target):
    (tmp_path / "usr").mkdir()
    (tmp_path / "usr" / "precious").touch()
    code, words = make(target, DESTDIR=tmp_path, PREFIX="/usr", PYTHON=sys.executable)
    assert code != 0
    assert "PREFIX=/usr" in words or f"PREFIX={tmp_path}/usr" in words
    assert "holds something else; name a folder of its own" in words
    assert [path.name for path in tmp_path.rglob("*")] == ["usr", "precious"]


@pytest.mark.parametrize("target", ["install", "uninstall"])
@pytest.mark.parametrize("sign", [" ", "|", "&", "%", "'", "\\", "*", "\n"])
@pytest.mark.parametrize("key", ["PREFIX", "DESTDIR"])
def test_a_path_that_a_unit_or_a_script_would_misread_is_refused_up_front(
    tmp_path, target, sign, key
):
    places = {"PREFIX": "/opt/ekf", "DESTDIR": str(tmp_path / "root")}
    places[key] += f"{sign}x"
    result = subprocess.run(
        [ROOT / "systemd/install.sh", target],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **places, "PYTHON": sys.executable},
    )
    assert result.returncode == 1
    assert f"{key}={places[key]}" in result.stderr
    assert "use letters, digits and / . _ + - only, no space" in result.stderr
    assert not list(tmp_path.iterdir())
