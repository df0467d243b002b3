"""A Snapshot in which every field is set, each by its own name, so that nothing stays unsaid."""

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Union, get_args, get_origin, get_type_hints
from zlib import crc32

from ekf_companion.status.snapshot import Snapshot


def number(path):
    """Return a whole number that belongs to a path, the same wherever the field stands."""
    return 1 + crc32(path.encode()) % 997


def filled(kind=Snapshot, path=""):
    """Return a value of a type with all that is in it set, whatever it may leave out."""
    arguments = get_args(kind)
    if get_origin(kind) in (Union, types.UnionType):
        return filled(next(one for one in arguments if one is not type(None)), path)
    if get_origin(kind) is Mapping:
        return entries(*arguments, path)
    if get_origin(kind) is tuple:
        count = 3 if arguments[-1] is ... else len(arguments)
        return tuple(number(f"{path}.{place}") + 0.5 for place in range(count))
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        return kind(
            **{one.name: filled(hints[one.name], f"{path}.{one.name}") for one in fields(kind)}
        )
    if issubclass(kind, Enum):
        return list(kind)[number(path) % len(kind)]
    if kind is bool:
        return number(path) % 2 == 1
    if kind is str:
        return f"the {path.rpartition('.')[2]}"
    return number(path) if kind is int else number(path) + 0.25


def entries(key, value, path):
    if key is float:
        return {bound: filled(value, f"{path}.{bound}") for bound in (0.1, 1.0, 50.0)}
    if key is str:
        names = ("ATTITUDE: a reason", "GPS_RAW_INT: another")
        return {
            name: "on" if value is object else filled(value, f"{path}.{name}") for name in names
        }
    return {one: filled(value, f"{path}.{one.name}") for one in key}
