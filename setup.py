"""Compile the kernel and the readers of logs: what ``pyproject.toml`` cannot say.

The same files also run as plain Python. No -ffast-math, and no contraction of a*b+c: every board
gives the same bits.
"""

import importlib
import sys
from pathlib import Path

from Cython.Build import cythonize
from setuptools import Extension, setup

ROOT = Path(__file__).resolve().parent
CORE = ROOT / "ekf_companion" / "core"
LOGS = ROOT / "ekf_companion" / "logs"
DECLARED = ("enums", "state", "parameters", "scratch")
"""Modules whose structs and numbers the compiler is told of by a file that is made here."""
HEADERS_ONLY = ("memory",)


def declare() -> None:
    """Write the .pxd files of the declarations, where they have changed."""
    sys.path.insert(0, str(ROOT))
    from ekf_companion.core.declare import pxd

    for name in DECLARED:
        path = CORE / f"{name}.pxd"
        text = pxd(importlib.import_module(f"ekf_companion.core.{name}"))
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


declare()
names = sorted({path.stem for path in CORE.glob("*.pxd")} - {*DECLARED, *HEADERS_ONLY})
modules = [f"core.{name}" for name in names]
modules += sorted(f"logs.{path.stem}" for path in LOGS.glob("*.pxd"))
setup(
    ext_modules=cythonize(
        [
            Extension(
                f"ekf_companion.{name}",
                [f"ekf_companion/{name.replace('.', '/')}.py"],
                extra_compile_args=["-O3", "-ffp-contract=off", "-g0"],
                extra_link_args=["-s"],
            )
            for name in modules
        ],
        compiler_directives={
            "language_level": 3,
            "boundscheck": False,
            "wraparound": False,
            "cdivision": True,
            "initializedcheck": False,
            # Types are those of the .pxd files; local variables have that of what they are given
            "annotation_typing": False,
            "infer_types": True,
        },
    )
)
