"""Decisions of the guard, worded for the log, the pilot and the status."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """Whether ODOMETRY is sent, and why."""

    is_streaming: bool
    reason: str
    """A sentence without its full stop."""
    remedy: str = ""
    """Which parameter to set to what; empty: nothing to change."""
    text: str = ""
    """Reason and remedy for the pilot, short enough for one STATUSTEXT with our name before it."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """The autopilot's parameters that decide, as read."""
    is_warning: bool = False
    """Whether a human should look."""
    is_fused: bool = False
    """Whether the autopilot fuses our estimate, or may: its own position is then partly ours."""
    is_yaw_fused: bool = False
    """Whether it fuses our yaw too, or may: its own heading is then partly ours."""
    is_alternative: bool = False
    """Whether the autopilot can be switched in flight, to and from a source that is not ours."""
    is_followed_from_start: bool = False
    """Whether its position is ours from its start on, and no receiver's of its own."""
    is_double: bool = False
    """Whether the autopilot would fuse it together with the GNSS that is in it."""
    is_settled: bool = True
    """Whether all parameters that decide were answered, or given up."""

    @property
    def sentence(self) -> str:
        """The decision as one sentence for the log."""
        said = "streamed" if self.is_streaming else "withheld"
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"ODOMETRY is {said}: {self.reason}{remedy}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold:
    """Why ODOMETRY waits although the guard would let it through."""

    reason: str
    """A sentence without its full stop."""
    remedy: str = ""
    """What to do about it; empty: nothing, it passes."""
    text: str = ""
    """For the pilot, after ``no ODOMETRY: ``; empty: it is over in a moment, and not announced."""


def streamed(reason: str, text: str = "ODOMETRY is streamed") -> Decision:
    """Return the decision to send it."""
    return Decision(is_streaming=True, reason=reason, text=text)


def withheld(reason: str, remedy: str = "", text: str = "", *, is_double: bool = False) -> Decision:
    """Return the decision to withhold it: a warning where something can be done about it."""
    return Decision(
        is_streaming=False,
        reason=reason,
        remedy=remedy,
        text=text,
        is_warning=bool(remedy),
        is_double=is_double,
    )


def silent(decision: Decision) -> Decision:
    """Return the decision on an autopilot that no longer answers; what it fused, it may still."""
    return replace(
        decision,
        is_streaming=False,
        is_warning=True,
        reason="the autopilot answers no request for a parameter any more, and what it fuses by "
        "now cannot be known",
        remedy="check that it still hears us on this link, or set output.odometry.mode to always",
        text="no ODOMETRY: no parameter is answered",
    )


def shared(decision: Decision, other_id: int) -> Decision:
    """Return the decision where another system's autopilot would fuse it too: it has no address."""
    return replace(
        decision,
        is_streaming=False,
        is_warning=True,
        reason=f"the autopilot of system {other_id} is on this link too: ODOMETRY bears no "
        "address, and that one was not asked whether it fuses GNSS",
        remedy="give each autopilot a link of its own, or set output.odometry.mode to always",
        text=f"no ODOMETRY: system {other_id} on the link",
    )


def kept(decision: Decision, doubt: Decision) -> Decision:
    """Return the decision to go on in flight in spite of a doubt: a heartbeat may be forged."""
    return replace(
        decision,
        is_warning=True,
        reason=f"{doubt.reason}; this began in flight and is no proof, so it goes on",
        remedy=f"{doubt.remedy}; output.odometry.withhold_in_flight: true would have stopped it",
        text=f"{doubt.text.removeprefix('no ODOMETRY: ')}, still sent",
    )


def stream_state(
    decision: Decision,
    twin: tuple[int, int] | None,
    slowed: tuple[int, int, float] | None,
    hold: Hold | None = None,
) -> Decision:
    """Return the decision, all things considered: guard, clash of ids, hold, commanded rate.

    ``twin`` is our system and component id where somebody else has the same; ``slowed`` is who has
    commanded a lower rate than the default (system and component id), and that rate, Hz, 0: off;
    ``hold`` is why it waits.
    """
    if twin is not None:
        return replace(
            decision,
            is_streaming=False,
            reason=f"somebody else speaks as system {twin[0]}, component {twin[1]}",
            remedy="give one of us another link.component_id",
        )
    if decision.is_streaming and hold is not None:
        return replace(
            decision,
            is_streaming=False,
            reason=hold.reason,
            remedy=hold.remedy,
            is_warning=bool(hold.text),
        )
    if decision.is_streaming and slowed is not None:
        system_id, component_id, rate = slowed
        did = f"commanded {rate:g} Hz" if rate > 0.0 else "switched it off"
        return replace(
            decision,
            is_streaming=rate > 0.0,
            reason=f"system {system_id}, component {component_id} has {did}",
            remedy="send SET_MESSAGE_INTERVAL of ODOMETRY with 0 for the rate by default",
        )
    return decision


def says(name: str, value: float | None, meaning: str) -> str:
    """Return the value of a parameter, and what it means, in words."""
    is_what = "does not exist" if value is None else f"is {value:g}"
    return f"{name} {is_what}: {meaning}"


def listed(names: list[str] | tuple[str, ...]) -> str:
    """Return names as words; of a long list the first few, and how many more."""
    shown = list(names[:5])
    if len(names) > len(shown):
        return f"{', '.join(shown)} and {len(names) - len(shown)} more"
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)
