"""The source of ``order/dispatch.py``: each aid that declares itself, by its number.

A compiled call has no table of functions: whose turn it is, is asked in turn.
"""

from __future__ import annotations

from ekf_companion.core.memory.aid import DECLARED, Value

_CIMPORT = "from cython.cimports.ekf_companion.core"
_FUNCTIONS = (
    (
        "aid_of(kind: int) -> int",
        "Return the number of the aid whose measurement this is, or -1.",
        "kind == KIND_{kind}",
        "AID_{aid}",
        "-1",
    ),
    (
        "begin(x: State, k: Parameters, aid: int, row: Vector) -> bool",
        "Find the slow errors of an aid; return whether its measurement can show them.",
        "aid == AID_{aid}",
        "{name}.begin(x, k, row)",
        "False",
    ),
    (
        "observe(x: State, k: Parameters, o: Observation, aid: int, row: Vector) -> bool",
        "Observe an aid's measurement; return whether it can count now.",
        "aid == AID_{aid}",
        "{name}.observe(x, k, o, row)",
        "False",
    ),
    (
        "place(x: State, k: Parameters, aid: int, row: Vector) -> float",
        "Write the position at a start by an aid alone; return one sigma, m; 0: it shows none.",
        "aid == AID_{aid}",
        "{name}.place(x, k, row)",
        "0.0",
    ),
    (
        "is_possible(kind: int, values: Numbers) -> bool",
        "Return whether an aid's sensor can say this.",
        "kind == KIND_{kind}",
        "{bounds}",
        "False",
    ),
)
"""Signature, docstring, whose turn it is, what is returned then, and for none."""


def source() -> str:
    """Return the module's text."""
    numbers = sorted(
        {f"AID_{one.name.upper()}" for one in DECLARED}
        | {f"KIND_{one.kind.name}" for one in DECLARED}
    )
    lines = [
        '"""The aids that declare themselves, by number; made by setup.py."""',
        "",
        "from __future__ import annotations",
        "",
        f"{_CIMPORT}.aids import {', '.join(one.name for one in DECLARED)}",
        f"{_CIMPORT}.memory.enums import {', '.join(numbers)}",
        f"{_CIMPORT}.memory.overlay import Numbers, Vector",
        f"{_CIMPORT}.memory.parameters import Parameters",
        f"{_CIMPORT}.memory.scratch import Observation",
        f"{_CIMPORT}.memory.state import State",
        "from cython.cimports.libc.math import isnan",
    ]
    for signature, words, condition, returned, otherwise in _FUNCTIONS:
        lines += ["", "", f"def {signature}:", f'    """{words}"""']
        for one in DECLARED:
            if ".place(" in returned and not one.shows_position:
                continue
            known = {"kind": one.kind.name, "aid": one.name.upper(), "name": one.name}
            bounds = " and ".join(_bounds(i, value) for i, value in enumerate(one.row.values()))
            lines.append(f"    if {condition.format(**known)}:")
            lines.append(f"        return {returned.format(**known, bounds=bounds)}")
        lines.append(f"    return {otherwise}")
    return "\n".join(lines) + "\n"


def _bounds(i: int, value: Value) -> str:
    inside = f"{value.low!r} < values[{i}] < {value.high!r}"
    return f"(isnan(values[{i}]) or {inside})" if value.is_optional else inside
