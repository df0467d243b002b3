"""The kernel's sources run as plain Python, beside the compiled modules."""

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import ekf_companion.core
from ekf_companion.core import uncompiled

FOLDER = Path(ekf_companion.core.__file__).parent
NAMES = sorted(
    path.stem
    for path in FOLDER.glob("*.py")
    if "cython.cimports" in path.read_text(encoding="utf-8") and path.stem != "uncompiled"
)


class _Sources:
    """Finds the kernel's modules as sources, whatever is compiled beside them."""

    def find_spec(self, name, path=None, target=None):
        stem = name.removeprefix("ekf_companion.core.")
        if stem == name or stem not in NAMES:
            return None
        return importlib.util.spec_from_file_location(name, FOLDER / f"{stem}.py")


@cache
def load() -> SimpleNamespace:
    """Return the modules by name, importing each other and not the compiled ones."""
    package = ekf_companion.core
    compiled = {name: vars(package).pop(name, None) for name in NAMES}
    for name in NAMES:
        sys.modules.pop(f"{package.__name__}.{name}", None)
    finder = _Sources()
    sys.meta_path.insert(0, finder)
    uncompiled.install()
    try:
        modules = {name: importlib.import_module(f"{package.__name__}.{name}") for name in NAMES}
    finally:
        sys.meta_path.remove(finder)
        uncompiled.forget()
        for name, module in compiled.items():
            vars(package).pop(name, None)
            sys.modules.pop(f"{package.__name__}.{name}", None)
            if module is not None:
                vars(package)[name] = sys.modules[f"{package.__name__}.{name}"] = module
    return SimpleNamespace(**modules)
