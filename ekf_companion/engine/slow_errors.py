"""What the slow errors of the aids are found to be, and those that no good sensor has, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.core.memory.enums import E_VEL, SLOW_ERRORS, Aid
from ekf_companion.core.memory.overlay import errors
from ekf_companion.core.memory.state import State

SURE = 3.0
"""Sigmas from which on an error is one."""
MISPLACED = 0.3
"""m; six times the spread of the delays of eight anchors of a kind, 0.05."""
SCALED = 0.15
"""More than a focal length is off by."""
TURNED = 0.1
"""rad: a mounting that was not measured."""


class SlowErrorFound(NamedTuple):
    """A slow error of an aid, as it is estimated."""

    value: float
    std: float
    """One sigma."""


def slow_errors(x: State) -> dict[str, SlowErrorFound]:
    """Return those of the aids that have begun, by ``AID_ERROR``."""
    values = errors(x)
    found = {}
    for one in DECLARED:
        if not x.has_aid[Aid[one.name.upper()]]:
            continue
        for i, name in enumerate(one.slow_errors, SLOW_ERRORS[one.name]):
            std = math.sqrt(max(x.P[i][i], 0.0))
            found[f"{one.name}_{name}"] = SlowErrorFound(float(values[i - E_VEL]), std)
    return found


def oddities(found: Mapping[str, SlowErrorFound]) -> Iterator[str]:
    """Yield a sentence for each that no good sensor has, with what to look at."""
    for number in range(8):
        error = found.get(f"anchor_range_bias_{number}")
        if error and is_beyond(error, MISPLACED):
            than = "longer" if error.value > 0.0 else "shorter"
            yield (
                f"anchor {number}: its ranges are {abs(error.value):.2f} m {than} than its place "
                "and the other anchors say; look at anchor_range.anchors, or what stands before it"
            )
    scale = found.get("optical_flow_scale")
    if scale and is_beyond(scale, SCALED):
        yield (
            f"optical flow: {1.0 + scale.value:.2f} times as fast as velocity and height say; "
            "calibrate its scale"
        )
    turn = found.get("optical_flow_turn")
    if turn and is_beyond(turn, TURNED):
        yield (
            f"optical flow: its camera is turned by {math.degrees(turn.value):.0f} deg; set "
            "optical_flow.turn"
        )


def is_beyond(error: SlowErrorFound, limit: float) -> bool:
    """Return whether an error is surely larger than a limit."""
    return abs(error.value) > limit and abs(error.value) > SURE * error.std
