"""Structs declared once: as C for the compiler, as memory for Python.

A class of annotations becomes a :mod:`ctypes` struct, on which the uncompiled kernel runs; and from
that ``setup.py`` makes the ``.pxd`` file of the module, so that both have the same fields, sizes
and numbers.
"""

import ctypes
import math
from enum import IntEnum, IntFlag
from types import ModuleType
from typing import Annotated, Any, TypeAlias, get_args, get_origin

Real: TypeAlias = Annotated[float, ctypes.c_double]
Count: TypeAlias = Annotated[int, ctypes.c_ssize_t]
Vector: TypeAlias = Any
"""Of doubles: ``Annotated[Vector, 3]``; with two sizes a matrix, row by row."""
Dcm: TypeAlias = Any
"""A matrix of 3 by 3, C[row][column]."""
Square: TypeAlias = Any
"""A matrix of N by N."""
Numbers: TypeAlias = Any
"""An array of doubles that came from Python."""
Structs: TypeAlias = Any
"""Several structs: ``Annotated[Structs, Run, 3]``."""


def struct(declared: type) -> Any:
    """Return a C struct whose fields are a class's annotations, after those of its bases."""
    parts = [base for base in _flat(declared) if base is not object]
    hints = [hint for part in parts for hint in vars(part).get("__annotations__", {}).items()]
    fields = [(name, _memory(hint)) for name, hint in hints]
    body = {"__doc__": declared.__doc__, "__module__": declared.__module__, "_fields_": fields}
    return type(declared.__name__, (ctypes.Structure,), body)


def _flat(declared: type) -> list[type]:
    """Return a class after its bases, and those after theirs."""
    return [*(part for base in declared.__bases__ for part in _flat(base)), declared]


def union(declared: type) -> Any:
    """Return a C union of a class's annotations: all lie in the same place."""
    fields = [(name, _memory(hint)) for name, hint in declared.__annotations__.items()]
    body = {"__doc__": declared.__doc__, "__module__": declared.__module__, "_fields_": fields}
    return type(declared.__name__, (ctypes.Union,), body)


def doubles(kind: Any) -> int:
    """Return how many doubles a struct of nothing else has."""
    return ctypes.sizeof(kind) // ctypes.sizeof(ctypes.c_double)


def pxd(module: ModuleType) -> str:
    """Return a module's numbers and structs as Cython declares them."""
    named = vars(module)
    lines = [f"# Made from {module.__name__.rpartition('.')[2]}.py by setup.py"]
    structs = [one for one in named.values() if _is_struct(one)]
    for one in structs:
        if one.__module__ != module.__name__:
            lines.append(f"from {one.__module__} cimport {one.__name__}")
    numbers = {name: one for name, one in named.items() if name.isupper() and type(one) is int}
    for prefix, kind in named.get("ENUMS", {}).items():
        numbers |= {f"{prefix}_{member.name}": int(member) for member in kind}
    if numbers:
        lines += ["cdef enum:", *(f"    {name} = {number}" for name, number in numbers.items())]
    values = {name: one for name, one in named.items() if name.isupper() and type(one) is float}
    if values:
        lines += ["cdef extern from *:", '    """', "    #include <math.h>"]
        lines += [f"    #define EKF_{name} {_c_value(value)}" for name, value in values.items()]
        lines += ['    """', *(f'    double {name} "EKF_{name}"' for name in values)]
    for one in structs:
        if one.__module__ == module.__name__:
            word = "union" if issubclass(one, ctypes.Union) else "struct"
            lines.append(f"ctypedef {word} {one.__name__}:")
            lines += [f"    {_c_field(name, kind)}" for name, kind in one._fields_]
    return "\n".join(lines) + "\n"


def enum_member(enums: dict[str, type[IntEnum] | type[IntFlag]], module: str, name: str) -> int:
    """Return ``PREFIX_MEMBER`` as the compiled kernel has it: a plain number.

    Raises:
        AttributeError: There is none.
    """
    prefix, _, member = name.partition("_")
    if prefix in enums and member in enums[prefix].__members__:
        return int(enums[prefix][member])
    raise AttributeError(f"module {module!r} has no attribute {name!r}")


def _memory(hint: Any) -> Any:
    """Return the type of a field's memory."""
    if get_origin(hint) is not Annotated:
        return hint
    declared, *sizes = get_args(hint)
    if declared is not Any:
        return sizes[0]
    kind = ctypes.c_double if isinstance(sizes[0], int) else sizes.pop(0)
    for size in reversed(sizes):
        kind = kind * size
    return kind


def _is_struct(one: object) -> bool:
    return isinstance(one, type) and issubclass(one, ctypes.Structure | ctypes.Union)


def _c_value(value: float) -> str:
    return "((double) NAN)" if math.isnan(value) else f"({value!r})"


def _c_field(name: str, kind: Any) -> str:
    """Return a field's declaration in C."""
    sizes = ""
    while issubclass(kind, ctypes.Array):
        sizes += f"[{kind._length_}]"
        kind = kind._type_
    if issubclass(kind, ctypes._Pointer):
        return f"{kind._type_.__name__} *{name}{sizes}"
    words = {ctypes.c_double: "double", ctypes.c_ssize_t: "Py_ssize_t"}
    return f"{words.get(kind) or kind.__name__} {name}{sizes}"
