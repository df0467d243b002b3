"""The wings of the kernel: what the compiler imports points down too, and who writes P."""

import ast
import re

import pytest

from ekf_companion.core.memory.signatures import CIMPORTS, CORE, kernel_modules

WINGS = ("memory", "settings", "filter", "trust", "aids", "start", "output", "order", "rts")
"""Each imports only those before it, and its own."""
ANTENNA = {"aids.gnss": "aids.lever_arm", "aids.delay": "aids.lever_arm"}
"""Aids that use another: where the antenna is belongs to what its receiver measures."""
WRITERS = ("filter.update", "filter.slow_error", "filter.covariance", "rts")
WRITES_P = re.compile(r"\b(?:x|y)\.P(?:\[[^=\n]*\])+ [-+*/]?= ")


def imported(name: str) -> set[str]:
    """Return the modules of the kernel that a module names to the compiler."""
    found = set()
    for node in ast.walk(ast.parse(source(name))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(CIMPORTS):
            module = node.module.removeprefix(f"{CIMPORTS}ekf_companion.core.")
            nested = {f"{module}.{alias.name}" for alias in node.names}
            found |= nested & {*kernel_modules()} or {module}
    return found


def source(name: str) -> str:
    return (CORE / f"{name.replace('.', '/')}.py").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", kernel_modules())
def test_a_wing_imports_only_those_before_it(name):
    wing = WINGS.index(name.partition(".")[0])
    ours = {one for one in imported(name) if one.partition(".")[0] in WINGS}
    assert not {one for one in ours if WINGS.index(one.partition(".")[0]) > wing}


@pytest.mark.parametrize("name", [one for one in kernel_modules() if one.startswith("aids.")])
def test_an_aid_knows_neither_another_aid_nor_who_judges_it(name):
    known = {one for one in imported(name) if one.startswith(("aids.", "trust."))}
    assert known <= {ANTENNA.get(name)}


@pytest.mark.parametrize("name", kernel_modules())
def test_the_covariance_is_written_by_the_filter_alone(name):
    assert bool(WRITES_P.search(source(name))) == (name in WRITERS)
