"""Run the kernel's sources as plain Python, where nobody has compiled them.

A source names what it needs of another as the compiler finds it, ``cython.cimports.X``. Here that
becomes a plain import of ``X``, and the address of a struct the struct itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import cython

from ekf_companion.core.memory import dispatch

CIMPORTS = "cython.cimports."
OURS = CIMPORTS + "ekf_companion"
MADE, MADE_FILE = "ekf_companion.core.order.dispatch", Path(__file__).parent / "order/dispatch.py"
"""What a build writes, and a checkout where nothing was built lacks."""


class _Cimports(MetaPathFinder, Loader):
    """Finds ``cython.cimports.ekf_companion`` and all below it, and what nobody has built."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        del path, target
        is_ours = name == OURS or name.startswith(OURS + ".")
        is_ours |= name == MADE and not MADE_FILE.exists()
        return ModuleSpec(name, self, is_package=True) if is_ours else None

    def exec_module(self, module: ModuleType) -> None:
        if module.__name__ == MADE:
            exec(compile(dispatch.source(), MADE, "exec"), vars(module))
            return
        source = import_module(module.__name__.removeprefix(CIMPORTS))
        vars(module)["__getattr__"] = source.__getattribute__


def install() -> None:
    """Let the sources import each other from now on."""
    if not any(isinstance(finder, _Cimports) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Cimports())
    # The package that Cython itself provides has no specification, which an import below it needs
    sys.modules["cython.cimports"].__spec__ = ModuleSpec("cython.cimports", None, is_package=True)
    cython.address = lambda struct: struct


def forget() -> None:
    """Forget what was imported this way: it may be imported from other sources next."""
    for name in [name for name in sys.modules if name.startswith(OURS)]:
        del sys.modules[name]
