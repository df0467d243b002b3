"""What the guard has decided, in words for the log, the pilot and the status."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace


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
    """Whether the autopilot fuses what is streamed, or does not say so: what it then says of itself
    is partly ours."""
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


def silent(verdict: Verdict) -> Verdict:
    """Give the verdict on an autopilot that answers no more; what it fused, it may still."""
    return replace(
        verdict,
        is_streaming=False,
        is_warning=True,
        reason="the autopilot answers no request for a parameter any more, and what it fuses by "
        "now cannot be known",
        remedy="check that it still hears us on this link, or set output.odometry.mode to always",
        text="no ODOMETRY: no parameter is answered",
    )


def shared(verdict: Verdict, other_id: int) -> Verdict:
    """Give the verdict where another system's autopilot would take what has no address."""
    return replace(
        verdict,
        is_streaming=False,
        is_warning=True,
        reason=f"the autopilot of system {other_id} is on this link too: ODOMETRY bears no "
        "address, and that one was not asked whether it fuses GNSS",
        remedy="give each autopilot a link of its own, or set output.odometry.mode to always",
        text=f"no ODOMETRY: system {other_id} on the link",
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


def says(name: str, value: float | None, meaning: str) -> str:
    """Give what a parameter is, and what that means."""
    is_what = "does not exist" if value is None else f"is {value:g}"
    return f"{name} {is_what}: {meaning}"


def listed(names: list[str] | tuple[str, ...]) -> str:
    """Give a list in words; of a long one, how many more."""
    shown = list(names[:5])
    if len(names) > len(shown):
        return f"{', '.join(shown)} and {len(names) - len(shown)} more"
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)
