"""``NAME[:key=value,...]``: how a personality and a fault are written on a command line."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection

from ekf_companion.errors import ConfigError


def split(text: str) -> tuple[str, dict[str, str]]:
    """Give the name, and the values by their keys.

    Raises:
        ConfigError: A key has no value, or stands twice.
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
    """Give a name that is known.

    Raises:
        ConfigError: It is not; says what there is, and what may be meant.
    """
    if name in known:
        return name
    near = difflib.get_close_matches(name, known, 1)
    meant = f"; did you mean {near[0]}?" if near else ""
    raise ConfigError(f"{text}: {name!r}: no such {what}; there are {', '.join(known)}{meant}")


def number(text: str, key: str, value: str, low: float, high: float) -> float:
    """Give a value as a number from ``low`` to ``high``.

    Raises:
        ConfigError: It is none, or outside.
    """
    try:
        found = float(value)
    except ValueError:
        found = math.nan
    if not low <= found <= high:
        raise ConfigError(f"{text}: {key}={value}: must be a number from {low:g} to {high:g}")
    return found
