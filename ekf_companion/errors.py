"""Every exception raised on purpose.

CompanionError
├── ConfigError   a key, a value or a file of the configuration
├── DataError     arrays that cannot be meant: units, axes, times (a ValueError too)
├── LinkError     a URL that names no link, or a link that cannot be opened at all
├── LogError      a recorded file that cannot be read, or holds nothing to estimate from
│   ├── FilterError  a filter whose mathematics end before the recording does
│   └── UnreachableError  a log of a store that does not answer now
├── MissingPackageError  a package that an extra brings is not installed
└── NotCompiledError  the sources are not compiled, and nothing runs them (an ImportError)

Each message says what, where, and what would do. Bad data is not an error: it is counted.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path


class CompanionError(Exception):
    """Anything that this package raises on purpose."""


class ConfigError(CompanionError):
    """The configuration holds something that cannot be meant."""


class DataError(CompanionError, ValueError):
    """Arrays of measurements hold something that cannot be meant."""


class LinkError(CompanionError):
    """A link URL is malformed, or names what this machine does not have."""


class LogError(CompanionError):
    """A log cannot be read, or has nothing in it that could be estimated from."""


class FilterError(LogError):
    """A filter cannot go on: its mathematics end before the recording does."""


class UnreachableError(LogError):
    """A log cannot be fetched now; the next run may."""


class MissingPackageError(CompanionError):
    """A package that an extra of ours brings is not installed."""


class NotCompiledError(CompanionError, ImportError):
    """The package's sources are neither compiled nor can they be interpreted."""


def is_compiled(module: str) -> bool:
    """Return whether a module that belongs compiled is; if not, it must be possible to interpret.

    Raises:
        NotCompiledError: It is a source, and Cython, which would interpret it, is not there.
    """
    spec = find_spec(module)
    if spec is None or not (spec.origin or "").endswith(".py"):
        return True
    if find_spec("cython") is None:
        raise NotCompiledError(f"{how_to_compile()}, and without Cython it does not run")
    return False


def how_to_compile() -> str:
    """Return what to do in a folder of sources that are not compiled."""
    root = Path(__file__).resolve().parents[1]
    return (
        f"ekf_companion in {root} is not compiled for {sys.executable}: `make -C {root} setup` "
        "compiles it, to be run by its .venv/bin/python; or install it with pip"
    )


def remedy(extra: str) -> str:
    """Return the command that installs an extra into this environment."""
    return f"{sys.executable} -m pip install 'ekf-companion[{extra}]'"


@contextmanager
def part_of(extra: str, subject: str) -> Iterator[None]:
    """Import what an extra brings.

    Args:
        extra: The extra's name in the package's metadata.
        subject: What needs the packages, to begin the sentence with.

    Raises:
        MissingPackageError: One of them is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in ("", "ekf_companion", "sim_autopilot"):
            raise
        raise MissingPackageError(
            f"{subject}: needs {package}, which is not installed: {remedy(extra)}"
        ) from None


def require(extra: str, subject: str, package: str) -> None:
    """Refuse, before any work is done, what a missing extra would end.

    Args:
        extra: The extra's name in the package's metadata.
        subject: What needs the package, to begin the sentence with.
        package: The package, or a module of it.

    Raises:
        MissingPackageError: It is not installed.
    """
    with part_of(extra, subject):
        import_module(package)
