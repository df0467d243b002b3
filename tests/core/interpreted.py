"""The kernel's sources run as plain Python, beside the compiled modules."""

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import ekf_companion.core

NAMES = (
    *("propagate", "correct", "observe", "proof", "gate"),
    *("yaw_frame", "yaw_filter", "yaw_bank", "yaw_reset", "heading", "align", "gnss"),
    *("tape", "kernel", "odometry", "timeline", "hindsight", "smooth"),
)
FOLDER = Path(ekf_companion.core.__file__).parent


@cache
def load() -> SimpleNamespace:
    """Give the modules by name, importing each other and not the compiled ones."""
    package = ekf_companion.core
    compiled = {name: importlib.import_module(f"ekf_companion.core.{name}") for name in NAMES}
    modules = {}
    try:
        for name in NAMES:
            full = f"ekf_companion.core.{name}"
            spec = importlib.util.spec_from_file_location(full, FOLDER / f"{name}.py")
            module = importlib.util.module_from_spec(spec)
            sys.modules[full] = module
            setattr(package, name, module)
            spec.loader.exec_module(module)
            modules[name] = module
    finally:
        for name in NAMES:
            sys.modules[f"ekf_companion.core.{name}"] = compiled[name]
            setattr(package, name, compiled[name])
    return SimpleNamespace(**modules)
