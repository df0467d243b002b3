"""``NAME[:key=value,...]``: the syntax of personalities and faults on a command line."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection

from ekf_companion.errors import ConfigError


def split(text: str) -> tuple[str, dict[str, str]]:
    """Return the name, and the values by their keys.

    Raises:
        ConfigError: A key has no value, or occurs twice.
    """
    name, _, rest = text.partition(":")
    values: dict[str, str] = {}
    for item in filter(None, rest.split(",")):
        key, sign, value = item.partition("=")
        if not sign or not key or not value:
            raise ConfigError(f"{text}: {item!r} is not key=value")
        if key in values:
            raise ConfigError(f"{text}: {key} stands twice")
        values[key] = value
    return name, values


def choose(text: str, what: str, name: str, known: Collection[str]) -> str:
    """Return a name if it is known.

    Raises:
        ConfigError: It is not; with the known ones, and the nearest.
    """
    if name in known:
        return name
    near = difflib.get_close_matches(name, known, 1)
    meant = f"; did you mean {near[0]}?" if near else ""
    raise ConfigError(f"{text}: {name!r}: no such {what}; there are {', '.join(known)}{meant}")


def number(text: str, key: str, value: str, low: float, high: float) -> float:
    """Convert a value to a number from ``low`` to ``high``.

    Raises:
        ConfigError: It is not a number, or outside.
    """
    try:
        found = float(value)
    except ValueError:
        found = math.nan
    if not low <= found <= high:
        raise ConfigError(f"{text}: {key}={value}: must be a number from {low:g} to {high:g}")
    return found
