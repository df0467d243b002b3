"""What the guard has decided, in words for the log, the pilot and the status."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Whether ODOMETRY is sent, and why."""

    is_streaming: bool
    reason: str
    """A sentence without its full stop."""
    remedy: str = ""
    """What to change, parameter and value; empty: nothing need be."""
    text: str = ""
    """Both for the pilot, so short that our name before it leaves it one STATUSTEXT."""
    parameters: Mapping[str, float]
    """The autopilot's that decide, as read."""
    is_warning: bool = False
    """Whether a human should look."""
    is_fused: bool = False
    """Whether the autopilot fuses what is streamed: what it then says of itself is partly ours."""
    is_yaw_fused: bool = False
    """Whether our yaw too: its own heading is then partly ours."""
    is_double: bool = False
    """Whether the autopilot would fuse it together with the GNSS that is in it."""
    is_settled: bool = True
    """Whether all that decides has been answered, or asked for in vain."""

    @property
    def sentence(self) -> str:
        """All of it for the log."""
        said = "streamed" if self.is_streaming else "withheld"
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"ODOMETRY is {said}: {self.reason}{remedy}"


@dataclass(frozen=True, slots=True)
class Slowed:
    """Somebody wants less of a message than comes by default."""

    system_id: int
    component_id: int
    rate: float
    """Hz; 0: not at all."""


@dataclass(frozen=True, slots=True)
class StreamState:
    """Whether ODOMETRY is sent, all things considered: guard, clash of ids, commanded rate."""

    is_streaming: bool
    reason: str
    """A sentence without its full stop."""
    remedy: str = ""
    """What to change; empty: nothing need be."""


def streamed(reason: str, text: str, read: Mapping[str, float]) -> Verdict:
    """Let it be sent."""
    return Verdict(
        is_streaming=True, reason=reason, text=text or "ODOMETRY is streamed", parameters=read
    )


def withheld(
    reason: str, remedy: str, text: str, read: Mapping[str, float], *, is_double: bool = False
) -> Verdict:
    """Keep it back; a human should look where something can be done."""
    return Verdict(
        is_streaming=False,
        reason=reason,
        remedy=remedy,
        text=text,
        parameters=read,
        is_warning=bool(remedy),
        is_double=is_double,
    )


def stream_state(
    verdict: Verdict, twin: tuple[int, int] | None, slowed: Slowed | None
) -> StreamState:
    """Give whether ODOMETRY is sent, and why.

    Args:
        verdict: The guard's.
        twin: Our system and component id where somebody else bears them too; None: nobody does.
        slowed: Who has commanded less ODOMETRY than comes by default; None: nobody has.
    """
    if twin is not None:
        reason = f"somebody else speaks as system {twin[0]}, component {twin[1]}"
        return StreamState(False, reason, "give one of us another link.component_id")
    if verdict.is_streaming and slowed is not None:
        who = f"system {slowed.system_id}, component {slowed.component_id}"
        is_on = slowed.rate > 0.0
        return StreamState(
            is_on,
            f"{who} has commanded {slowed.rate:g} Hz" if is_on else f"{who} has switched it off",
            "send SET_MESSAGE_INTERVAL of ODOMETRY with 0 for the rate by default",
        )
    return StreamState(verdict.is_streaming, verdict.reason, verdict.remedy)
