"""The result of a calibration: keys to paste as YAML, each with its uncertainty, or JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from typing import Any, get_type_hints

import numpy as np

from ekf_companion.config.config import Config

Value = float | Sequence[float] | Sequence[Sequence[float]]
_wrapped = partial(textwrap.wrap, break_long_words=False, break_on_hyphens=False)
COMMENT_COLUMN = 30
"""Column in which all comments begin."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A measured key of the configuration."""

    key: str
    """``section.key`` of the configuration."""
    value: Value
    comment: str
    """Its unit and uncertainty."""
    is_sure: bool = True
    """False: the key is printed as a comment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The result of a calibration from a log."""

    settings: Sequence[Setting]
    notes: Sequence[str]
    """What the user should know, one sentence each."""
    data: dict[str, Any] = field(default_factory=dict)
    """Everything measured, for JSON: numbers, words and lists of them."""

    def after(self, notes: Sequence[str]) -> Result:
        """Return the same with the notes of the log's reader before its own."""
        return replace(self, notes=[*notes, *self.notes])

    def to_dict(self, log: str) -> dict[str, Any]:
        """Return everything for JSON."""
        keys = {
            one.key: {"value": one.value, "comment": one.comment, "is_sure": one.is_sure}
            for one in self.settings
        }
        return {"log": log, "keys": keys, "notes": list(self.notes), **self.data}


def lines(title: str, result: Result) -> list[str]:
    """Return the result as lines of YAML: sure settings as keys, everything else as comments.

    A key that the configuration does not have is a comment too.
    """
    text = [f"# {title}"]
    text += [f"# {part}" for note in result.notes for part in _wrapped(note, 96)]
    sections: dict[str, list[Setting]] = {}
    for one in result.settings:
        sections.setdefault(one.key.split(".")[0], []).append(one)
    for section, settings in sections.items():
        text.append(f"{section}:")
        for one in settings:
            is_key = one.is_sure and is_known(one.key)
            name = one.key.split(".", 1)[1]
            entry = f"  {'' if is_key else '#'}{name}: {spelled(one.value)}"
            if len(entry) >= COMMENT_COLUMN:
                text += [f"  # {part}" for part in _wrapped(one.comment, 96)]
                text.append(entry)
            else:
                for part in _wrapped(one.comment, 96 - COMMENT_COLUMN):
                    text.append(f"{entry:<{COMMENT_COLUMN}}# {part}")
                    entry = ""
    return text


def is_known(key: str) -> bool:
    """Return whether the configuration has a key of this dotted name."""
    kind: Any = Config
    for part in key.split("."):
        if not is_dataclass(kind) or part not in {entry.name for entry in fields(kind)}:
            return False
        kind = get_type_hints(kind)[part]
    return True


def spelled(value: Value) -> str:
    """Return a number, a vector or a matrix as YAML, with three significant digits; or a truth."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:.3g}" if abs(value) >= 1e-4 or value == 0.0 else f"{value:.2e}"
    return f"[{', '.join(spelled(part) for part in value)}]"


def rounded(values: Any) -> Any:
    """Return numbers, or arrays of them, as plain lists with six significant digits."""
    array = np.asarray(values, dtype=float)
    if array.ndim:
        return [rounded(part) for part in array]
    return float(f"{array:.6g}") if np.isfinite(array) else None
