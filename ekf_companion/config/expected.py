"""What a key takes, and what was found in its place, in the words of a user."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from msgspec import Meta

from ekf_companion.core.settings.setting import Setting

_KINDS = {float: "number", int: "whole number", str: "text"}
_FOUND = {float: "a number", int: "a number", str: "a text", list: "a list", dict: "a table"}


def range_of(meta: Meta, unbounded: float = math.inf) -> str:
    """Return a range in words, without an upper limit of ``unbounded`` or more."""
    low = f"{meta.ge:g}" if meta.ge is not None else f"above {meta.gt:g}"
    high, limit = ("to", meta.le) if meta.le is not None else ("and below", meta.lt)
    if limit is not None and limit < unbounded:
        return f"{low} {high} {limit:g}"
    return f"{low} or more" if meta.ge is not None else low


def expected(hint: Any) -> str:
    """Return what a type with its range and unit takes: ``a number in s, -1 to 1, or auto``."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        units = [one.unit for one in arguments if isinstance(one, Setting) and one.unit]
        ranges = [range_of(one) for one in arguments if isinstance(one, Meta)]
        words = _within(expected(arguments[0]), units)
        return ", ".join([words, *ranges])
    if origin in (Union, UnionType):
        return ", or ".join(map(expected, arguments))
    if origin is Literal:
        return " or ".join(filter(None, (", ".join(arguments[:-1]), arguments[-1])))
    if origin is tuple:
        return _listed(arguments)
    if hint is NoneType:
        return "null"
    return "true or false" if hint is bool else f"a {_KINDS[hint]}"


def _within(words: str, units: Sequence[str]) -> str:
    """Return a type's words with the unit behind its first number or numbers."""
    head, comma, rest = words.partition(",")
    return f"{head} in {units[0]}{comma}{rest}" if units else words


def _listed(arguments: Sequence[Any]) -> str:
    """Return what a list takes: how many, and of what."""
    one = expected(arguments[0]).removeprefix("a ")
    head, comma, rest = one.partition(", ")
    kind, of, parts = head.partition(" of ")
    count = "" if arguments[-1] is Ellipsis else f"{len(arguments)} "
    each = f", each {rest.removeprefix('each ')}" if comma else ""
    return f"a list of {count}{kind}s{of}{parts}{each}"


def found(value: object) -> str:
    """Return a value as a file has it, and of which kind it is: ``'fast' is a text``."""
    if value is None:
        return "null is no value"
    if isinstance(value, bool):
        return f"{str(value).lower()} is true or false"
    kind = next(
        (words for one, words in _FOUND.items() if isinstance(value, one)),
        "neither number nor text",
    )
    return f"{value!r:.60} is {kind}"
