"""Messages that are read where they lie, as structs of C: ``setup.py`` makes ``record.pxd``."""

from __future__ import annotations

import re
from typing import Any, TypeAlias

from ekf_companion.mavlink.messages import by_name

HighresImu: TypeAlias = Any
Attitude: TypeAlias = Any
GpsRawInt: TypeAlias = Any
GlobalPositionInt: TypeAlias = Any
Timesync: TypeAlias = Any
_C = {"B": "unsigned char", "H": "unsigned short", "I": "unsigned int", "Q": "unsigned long long"}
_C |= {"b": "signed char", "h": "short", "i": "int", "q": "long long", "f": "float", "d": "double"}


def pxd() -> str:
    """Return the structs as Cython declares them; fields in the order of the wire."""
    lines = ["# Made from mavlink.record by setup.py"]
    for name in [one for one, kind in globals().items() if kind is Any and one != "Any"]:
        layout = by_name(re.sub("(?<=[a-z])(?=[A-Z])", "_", name).upper())
        lines.append(f"cdef packed struct {name}:")
        lines += [f"    {_C[field.code]} {field.name}" for field in layout.fields]
    return "\n".join(lines) + "\n"
