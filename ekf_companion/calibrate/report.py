"""What a calibration found: keys to paste as YAML, each with how sure it is, or all as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, get_type_hints

import numpy as np

from ekf_companion.config.config import Config

Value = float | Sequence[float] | Sequence[Sequence[float]]
COMMENT_COLUMN = 30
"""Where the comments begin, so that they can be read down the page."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One number of the configuration."""

    key: str
    """``section.key`` of the configuration."""
    value: Value
    comment: str
    """Its unit and how sure it is."""
    is_sure: bool = True
    """False: it is shown, but commented out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What a calibration of a log gives."""

    findings: Sequence[Finding]
    notes: Sequence[str]
    """What the user should know, one sentence each."""
    data: dict[str, Any] = field(default_factory=dict)
    """Everything measured, for JSON: numbers, words and lists of them."""

    def after(self, notes: Sequence[str]) -> Result:
        """Give the same with what the log's reader saw before it."""
        return replace(self, notes=[*notes, *self.notes])

    def to_dict(self, log: str) -> dict[str, Any]:
        """Give everything for JSON."""
        keys = {
            one.key: {"value": one.value, "comment": one.comment, "is_sure": one.is_sure}
            for one in self.findings
        }
        return {"log": log, "keys": keys, "notes": list(self.notes), **self.data}


def lines(title: str, result: Result) -> list[str]:
    """Give the result as YAML: what is sure as keys, everything else as comments.

    A key that the configuration does not have (yet) is a comment too.
    """
    text = [f"# {title}"]
    text += [f"# {part}" for note in result.notes for part in _wrapped(note)]
    sections: dict[str, list[Finding]] = {}
    for one in result.findings:
        sections.setdefault(one.key.split(".")[0], []).append(one)
    for section, findings in sections.items():
        text.append(f"{section}:")
        for one in findings:
            is_key = one.is_sure and is_known(one.key)
            name = one.key.split(".", 1)[1]
            entry = f"  {'' if is_key else '#'}{name}: {spelled(one.value)}"
            comment = _wrapped(one.comment, 96 - COMMENT_COLUMN)
            if len(entry) >= COMMENT_COLUMN:
                text += [f"  # {part}" for part in _wrapped(one.comment)]
                text.append(entry)
            else:
                text += [
                    f"{entry if index == 0 else '':<{COMMENT_COLUMN}}# {part}"
                    for index, part in enumerate(comment)
                ]
    return text


def is_known(key: str) -> bool:
    """Whether the configuration has a key, by its dotted name."""
    kind: Any = Config
    for part in key.split("."):
        if not is_dataclass(kind) or part not in {entry.name for entry in fields(kind)}:
            return False
        kind = get_type_hints(kind)[part]
    return True


def spelled(value: Value) -> str:
    """Give a number, a vector or a matrix as YAML, numbers with three digits that count."""
    if isinstance(value, (int, float)):
        return f"{value:.3g}" if abs(value) >= 1e-4 or value == 0.0 else f"{value:.2e}"
    return f"[{', '.join(spelled(part) for part in value)}]"


def rounded(values: Any) -> Any:
    """Give numbers, or arrays of them, as plain lists of numbers with six digits that count."""
    array = np.asarray(values, dtype=float)
    if array.ndim:
        return [rounded(part) for part in array]
    return float(f"{array:.6g}") if np.isfinite(array) else None


def _wrapped(text: str, width: int = 96) -> list[str]:
    words: list[str] = []
    done: list[str] = []
    for word in text.split():
        if words and len(" ".join([*words, word])) > width:
            done.append(" ".join(words))
            words = []
        words.append(word)
    return [*done, " ".join(words)]
