"""The recipe of the container image, and what BlueOS reads of it."""

import json
import os
import re
import subprocess

import pytest

from ekf_companion.config.config import load_config
from ekf_companion.version import __version__
from tests.paths import ROOT

FOLDER = ROOT / "systemd"
RECIPE = re.sub(r"\\\n\s*", "", (FOLDER / "Containerfile").read_text())
ARGUMENTS = {
    key: value.strip('"') for key, value in re.findall(r"^ARG (\w+)=(.*)$", RECIPE, re.MULTILINE)
}
QUOTED = r'([\w.]+)="((?:[^"\\]|\\.)*)"'


def labels():
    found = {}
    for line in re.findall(r"^LABEL (.*)$", RECIPE, re.MULTILINE):
        assert re.fullmatch(rf"{QUOTED}( {QUOTED})*", line), line
        for key, value in re.findall(QUOTED, line):
            text = value.replace('\\"', '"')
            found[key] = re.sub(r"\$\{(\w+)\}", lambda it: ARGUMENTS[it[1]], text)
    return found


def test_blueos_reads_its_labels():
    found = labels()
    assert {"version", "permissions", "authors", "company", "readme", "links", "type", "tags"} <= {
        *found
    }
    assert found["version"] == found["org.opencontainers.image.version"] == __version__
    assert found["type"] in ("device-integration", "example", "tool", "other")
    tags = json.loads(found["tags"])
    assert len(tags) <= 10
    assert all(re.fullmatch(r"[a-z0-9-]+", tag) for tag in tags)
    assert json.loads(found["authors"])[0].keys() == {"name", "email"}
    assert json.loads(found["company"]).keys() == {"about", "name", "email"}
    assert isinstance(json.loads(found["links"]), dict)


def test_the_image_asks_for_no_more_than_it_needs():
    host = json.loads(labels()["permissions"])["HostConfig"]
    assert host["NetworkMode"] == "host"  # the router listens on the host's loopback only
    assert host["CapDrop"] == ["ALL"]
    assert host["ReadonlyRootfs"] is True
    assert [bind.partition(":")[2] for bind in host["Binds"]] == ["/data"]
    assert not {"Privileged", "Devices", "CapAdd", "PortBindings"} & {*host}


def test_what_the_recipe_copies_is_not_ignored():
    lines = (FOLDER / "Containerfile.dockerignore").read_text().splitlines()
    assert lines[0] == "*"
    kept = {line[1:] for line in lines if line.startswith("!")}
    assert all((ROOT / name).exists() for name in kept)
    installed = re.search(r"cp -R (.*) \"\$built/src\"", (FOLDER / "install.sh").read_text())[1]
    assert {*installed.split(), "config"} <= kept
    for source in re.findall(r"^COPY (?!--from)(\S+) ", RECIPE, re.MULTILINE):
        assert source == "." or (ROOT / source).is_file()


@pytest.fixture
def start(tmp_path):
    """Return a function that starts the container's script, with a program that says its words."""
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "ekf-companion"
    program.write_text('#!/bin/sh\necho "$@"\n')
    program.chmod(0o755)
    path = f"{program.parent}:{os.environ['PATH']}"

    def run(*words):
        return subprocess.run(
            [FOLDER / "container.sh", *words],
            env={"PATH": path, "DATA": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )

    return run


def test_the_first_start_writes_a_configuration_and_the_next_keeps_it(tmp_path, start):
    first = start()
    config = tmp_path / "config.yaml"
    read = load_config(config)
    assert read.link.url == "tcp:127.0.0.1:5777"
    assert read.record.path == f"{tmp_path}/%s.tlog"
    assert "new; link.url is" in first.stderr
    assert first.stdout == f"run --config {config} --checkpoint {tmp_path}/checkpoint\n"

    config.write_text("link: {url: 'udpin:0.0.0.0:14540'}\n")
    second = start("--link", "serial:/dev/ttyAMA0:921600")
    assert second.stdout.endswith("/checkpoint --link serial:/dev/ttyAMA0:921600\n")
    assert load_config(config).link.url == "udpin:0.0.0.0:14540"
    assert second.stderr == ""
