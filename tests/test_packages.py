"""What a wheel holds."""

import ast
import re

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
