"""The kernel's sources run as plain Python, beside the compiled modules."""

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace

import ekf_companion.core
from ekf_companion.core import uncompiled
from ekf_companion.core.memory.signatures import kernel_modules

FOLDER = Path(ekf_companion.core.__file__).parent
NAMES = [f"ekf_companion.core.{name}" for name in kernel_modules()]


class _Sources:
    """Finds the kernel's modules as sources, whatever is compiled beside them."""

    def find_spec(self, name, path=None, target=None):
        if name not in NAMES:
            return None
        stem = name.removeprefix("ekf_companion.core.").replace(".", "/")
        return importlib.util.spec_from_file_location(name, FOLDER / f"{stem}.py")


@cache
def load() -> SimpleNamespace:
    """Return the modules by their last names, importing each other and not the compiled ones."""
    compiled = {name: _take_out(name) for name in NAMES}
    finder = _Sources()
    sys.meta_path.insert(0, finder)
    uncompiled.install()
    try:
        modules = {name.rpartition(".")[2]: importlib.import_module(name) for name in NAMES}
    finally:
        sys.meta_path.remove(finder)
        uncompiled.forget()
        for name, module in compiled.items():
            _take_out(name)
            if module is not None:
                folder, _, last = name.rpartition(".")
                vars(sys.modules[folder])[last] = sys.modules[name] = module
    return SimpleNamespace(**modules)


def _take_out(name: str) -> ModuleType | None:
    """Remove a module from those that are imported, and from its package; return it."""
    folder, _, last = name.rpartition(".")
    if folder in sys.modules:
        vars(sys.modules[folder]).pop(last, None)
    return sys.modules.pop(name, None)
