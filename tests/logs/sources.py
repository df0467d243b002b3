"""The compiled searches of the logs, run from their sources instead."""

import importlib.util
from pathlib import Path
from types import ModuleType

from ekf_companion import logs


def load(name: str) -> ModuleType:
    """Return a module of ``ekf_companion.logs`` as plain Python."""
    path = Path(logs.__path__[0]) / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"uncompiled_{name}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
