"""The script that dpkg runs after the package is gone."""

import subprocess

import pytest

from tests.paths import ROOT


@pytest.mark.parametrize("action", ["remove", "upgrade", "purge"])
def test_purge_takes_the_state_of_instances_too_and_leaves_recordings(tmp_path, action):
    kept = ["var/log/ekf-companion-quad/1.tlog", "var/lib/other/state", "etc/other.yaml"]
    gone = [
        *("var/lib/ekf-companion/checkpoint", "var/lib/ekf-companion-quad/checkpoint"),
        *("var/lib/private/ekf-companion-quad/checkpoint", "etc/ekf-companion/quad.yaml"),
    ]
    for name in (*kept, *gone):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    script = (ROOT / "systemd/debian/postrm").read_text()
    for root in ("/var/", "/etc/", "/opt/"):
        script = script.replace(f" {root}", f" {tmp_path}{root}")
    script = script.replace("systemctl", ":")
    subprocess.run(["sh", "-e", "-c", script, "postrm", action], check=True)
    assert all((tmp_path / name).exists() for name in kept)
    assert [(tmp_path / name).exists() for name in gone] == [action != "purge"] * len(gone)
