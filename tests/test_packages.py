"""What a wheel holds."""

import ast
import re
import subprocess

import pytest

from tests.manual import COMPLETIONS, MAN, SHARE
from tests.paths import ROOT


def test_every_package_is_in_the_wheel():
    text = (ROOT / "pyproject.toml").read_text()
    listed = re.search(r"\[tool\.setuptools\]\npackages = \[(.*?)\]", text, re.DOTALL)[1]
    folders = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for top in ("ekf_companion", "sim_autopilot")
        for path in (ROOT / top).rglob("__init__.py")
    }
    assert set(re.findall(r'"([^"]+)"', listed)) == folders


def sentences(path):
    """Return the strings of a module that are no docstrings, or texts below a field."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    texts = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in texts:
            yield node.value


def test_no_sentence_points_to_what_is_not_in_the_wheel():
    """Whoever installed a wheel has no docs/, no config/ and no Makefile."""
    absent = re.compile(r"\bdocs/|\bconfig/|README|\bmake (setup|demo|test|wheel|install)\b")
    for package in ("ekf_companion", "sim_autopilot"):
        for path in (ROOT / package).rglob("*.py"):
            found = [text for text in sentences(path) if absent.search(text)]
            assert not found, f"{path}: {found}"


def metadata(section):
    """Return the quoted names of a list of pyproject.toml."""
    text = (ROOT / "pyproject.toml").read_text()
    found = re.search(rf"^{section} = \[(.*?)\]\n", text, re.MULTILINE | re.DOTALL)[1]
    return set(re.findall(r'"([\w-]+)', found))


def test_the_wheel_has_the_man_page_and_the_completions():
    text = (ROOT / "pyproject.toml").read_text()
    section = re.search(r"\[tool.setuptools.data-files\]\n(.*?)\n\n", text, re.DOTALL)[1]
    listed = dict(re.findall(r'^"(.+)" = \["(.+)"\]$', section, re.MULTILINE))
    files = {ROOT / name: place for place, name in listed.items()}
    assert {*files} == {MAN, *COMPLETIONS.values()}
    for path, place in files.items():
        assert place == f"share/{path.parent.relative_to(SHARE)}"


LOCKS = {"requirements-run.txt": (), "requirements-report.txt": ("report",)}


@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_has_every_dependency_with_a_hash(name):
    """`make lock` writes it."""
    text = (ROOT / "systemd" / name).read_text()
    entries = re.split(r"\n(?=\w)", text)
    for entry in entries:
        assert re.match(r"[\w.-]+==[\w.]+", entry), entry
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), entry
    locked = {re.split("==", entry)[0] for entry in entries}
    wanted = metadata("dependencies").union(*map(metadata, LOCKS[name]))
    assert {one.lower().replace("_", "-") for one in wanted} <= locked


@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_names_no_host_and_no_folder(name):
    text = (ROOT / "systemd" / name).read_text()
    assert not re.search(r"://|--(extra-)?index-url|--find-links|@ ", text)


def test_the_tools_that_build_the_wheel_are_locked_too():
    """Where a wheel is built, pip would else fetch any version of them, unseen."""
    text = (ROOT / "systemd/requirements-build.txt").read_text()
    locked = {}
    for entry in re.split(r"\n(?=\w)", text):
        name, version = re.match(r"([\w.-]+)==([\w.]+)", entry).groups()
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), entry
        locked.setdefault(name, set()).add(version)
    project = (ROOT / "pyproject.toml").read_text()
    needs = re.search(r"^requires = \[(.*)\]$", project, re.MULTILINE)[1]
    assert {re.match(r"[a-z]+", one)[0] for one in re.findall(r'"(.+?)"', needs)} <= {*locked}
    # The kernel is compiled for the NumPy that it runs with
    running = (ROOT / "systemd/requirements-run.txt").read_text()
    assert locked["numpy"] == {*re.findall(r"^numpy==([\w.]+)", running, re.MULTILINE)}
    assert not re.search(r"://|--(extra-)?index-url|--find-links|@ ", text)


def test_the_extra_all_has_every_other_but_those_of_fleets_and_developers():
    """And but Ouster's SDK, which holds other packages at old versions."""
    text = (ROOT / "pyproject.toml").read_text()
    section = re.search(r"\[project.optional-dependencies\]\n(.*?)\n\n", text, re.DOTALL)[1]
    names = set(re.findall(r"^(\w+) = \[", section, re.MULTILINE)) - {
        "all",
        "docs",
        "dev",
        "fleet",
        "gs",
        "ouster",
    }
    inside = re.search(r'all = \["ekf-companion\[([\w,]+)\]"\]', section)[1]
    assert set(inside.split(",")) == names
    assert "ekf-companion" in metadata("dev")


def test_every_extra_that_a_sentence_names_is_one():
    text = (ROOT / "pyproject.toml").read_text()
    for package in ("ekf_companion", "sim_autopilot"):
        for path in (ROOT / package).rglob("*.py"):
            source = path.read_text()
            for extra in re.findall(r'(?:part_of|remedy|require)\(["\'](\w+)["\']', source):
                assert re.search(rf"^{extra} = \[", text, re.MULTILINE), (path, extra)


@pytest.mark.parametrize(("target", "what"), [("deb", "package"), ("wheel", "wheel")])
def test_whoever_waits_for_make_sees_that_it_goes_on(target, what):
    said = subprocess.run(
        ["make", "--dry-run", target], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert f"Making a {what} in dist: packages are downloaded and the kernel is compiled" in said
    assert "up to six minutes on two cores of a server" in said
    assert 'echo "  working, $seconds s"' in said
