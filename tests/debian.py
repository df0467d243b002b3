"""`make deb`, without the dependencies that it would download. `make installcheck` runs this."""

import shutil
import subprocess
import tarfile

import pytest

from ekf_companion.version import __version__
from tests.installation import make, make_wheel
from tests.manual import COMPLETIONS, MAN, SHARE
from tests.paths import ROOT
from tests.test_systemd import analyze

PYTHON = "/usr/bin/python3"


def has_venv():
    command = [PYTHON, "-c", "import ensurepip"]
    return shutil.which(PYTHON) and subprocess.run(command, capture_output=True).returncode == 0


pytestmark = [
    pytest.mark.skipif(not shutil.which("dpkg-deb"), reason="dpkg-deb is not installed"),
    pytest.mark.skipif(not has_venv(), reason="python3-venv is not installed"),
]


@pytest.fixture(scope="module")
def deb(tmp_path_factory):
    folder = tmp_path_factory.mktemp("deb")
    settings = {"PIP_FLAGS": "--no-index --no-deps", "LOCK": "none", "OUT": folder / "out"}
    code, words = make("deb", WHEEL=make_wheel(folder), **settings)
    assert code == 0, words
    (path,) = (folder / "out").glob("*.deb")
    return path


@pytest.fixture(scope="module")
def tree(deb, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tree")
    subprocess.run(["dpkg-deb", "--raw-extract", deb, folder], check=True)
    return folder


def field(deb, name):
    command = ["dpkg-deb", "--field", deb, name]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_its_metadata_name_the_python_that_it_was_made_for(deb):
    command = [PYTHON, "-c", "import sys; print(*sys.version_info[:2], sep='.')"]
    python = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    version = f"{__version__}+py{python}"
    assert field(deb, "Package") == "ekf-companion"
    assert field(deb, "Version") == version
    after = f"3.{int(python.split('.')[1]) + 1}"
    assert f"python3 (>= {python}), python3 (<< {after})" in field(deb, "Depends")
    assert deb.name == f"ekf-companion_{version}_{field(deb, 'Architecture')}.deb"


def test_everything_is_where_a_package_has_it(tree):
    units = sorted(path.name for path in (tree / "usr/lib/systemd/system").iterdir())
    assert units == [
        "ekf-companion-lidar.service",
        "ekf-companion.service",
        "ekf-companion@.service",
    ]
    rule = tree / "usr/lib/udev/rules.d/70-ekf-companion.rules"
    assert rule.read_bytes() == (ROOT / "systemd/70-ekf-companion.rules").read_bytes()
    for path in (MAN.with_name(MAN.name + ".gz"), *COMPLETIONS.values()):
        assert (tree / "usr/share" / path.relative_to(SHARE)).is_file()
    link = (tree / "usr/bin/ekf-companion").readlink()
    assert str(link) == "/opt/ekf-companion/bin/ekf-companion"
    assert (tree / str(link)[1:]).read_text().startswith("#!/opt/ekf-companion/bin/python")
    assert (tree / "opt/ekf-companion/bin/python3").readlink().as_posix() == PYTHON
    assert not (tree / "usr/local").exists()
    assert not (tree / "etc/systemd").exists()


def test_an_upgrade_keeps_the_configuration(tree):
    assert (tree / "DEBIAN/conffiles").read_text() == "/etc/ekf-companion/config.yaml\n"
    config = tree / "etc/ekf-companion/config.yaml"
    assert config.read_bytes() == (ROOT / "config/px4.yaml").read_bytes()


def test_all_belongs_to_root_and_all_may_read_it(deb, tmp_path):
    path = tmp_path / "data.tar"
    with path.open("wb") as file:
        subprocess.run(["dpkg-deb", "--fsys-tarfile", deb], stdout=file, check=True)
    with tarfile.open(path) as archive:
        for one in archive:
            assert (one.uid, one.gid) == (0, 0), one.name
            if not one.issym():
                least = 0o755 if one.isdir() else 0o444
                assert one.mode & least == least, one.name
                assert not one.mode & 0o6022, one.name


def test_systemd_reads_every_line_of_its_units(tree):
    for unit in (tree / "usr/lib/systemd/system").iterdir():
        text = unit.read_text().replace("/opt/ekf-companion/bin/ekf-companion", PYTHON)
        path = tree / unit.name.replace("@.", "@quad.")
        path.write_text(text)
        assert analyze("verify", path) == (0, ""), unit.name


def test_its_scripts_start_nothing_and_restart_nothing(tree):
    """The vehicle may be in the air."""
    for name in ("postinst", "prerm", "postrm"):
        script = tree / "DEBIAN" / name
        subprocess.run(["sh", "-n", script], check=True)
        lines = [line.strip() for line in script.read_text().splitlines()]
        done = [line for line in lines if line.startswith("systemctl") and " stop " not in line]
        assert all("daemon-reload" in line or "disable" in line for line in done), name
    # An upgrade calls `prerm upgrade`: the service flies on
    assert '[ "$1" = remove ] &&' in (tree / "DEBIAN/prerm").read_text()


def test_a_python_that_other_systems_lack_is_refused(tmp_path):
    python = tmp_path / "python3"
    python.write_text("#!/bin/sh\necho /home/pilot/.pyenv\n")
    python.chmod(0o755)
    code, words = make("deb", SYSTEM_PYTHON=python, OUT=tmp_path)
    assert code != 0
    assert f"PYTHON={python}: is not of this system's packages; name /usr/bin/python3" in words
    assert not list(tmp_path.glob("*.deb"))
