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

FAR_OFF = 1.0
"""m; less is within what a receiver's own slow error is."""
ASKEW = 0.035
"""rad; two degrees, as a compass in the hand is off."""


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
    frame = [found.get(f"anchor_range_frame_{axis}") for axis in ("north", "east", "down")]
    if any(error is not None and is_beyond(error, FAR_OFF) for error in frame):
        north, east, down = (0.0 if error is None else error.value for error in frame)
        yield (
            f"anchors: all of them are {north:+.1f} m north, {east:+.1f} m east, {down:+.1f} m "
            "down of where anchor_range.anchors says, by the receiver; measure their place anew"
        )
    yaw = found.get("anchor_range_frame_yaw")
    if yaw and is_beyond(yaw, ASKEW):
        yield (
            f"anchors: all of them are turned by {math.degrees(yaw.value):.0f} deg from where "
            "anchor_range.anchors says, by the receiver; measure their north anew"
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
