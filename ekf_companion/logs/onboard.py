"""What an autopilot writes into its log beside measurements: firmware, parameters, messages.

All of it is untrusted text: nothing here interprets it, and whatever shows it must escape it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

MOST = 1000
"""Messages that are kept: a damaged file may hold any number."""
MOST_PARAMETERS = 10_000
"""Parameters that are kept: the largest autopilots have 2000."""
LONGEST = 200
"""Characters of a message or a version that are kept; a parameter's name has 16."""
FIRMWARE = re.compile(r"(?:APM:|Ardu|AntennaTracker|Blimp)\w* ?\w* V\d")
"""Begins the message that ArduPilot writes at its start: ``ArduCopter V4.5.1 (9ea3ccfe)``."""
LEVELS = (
    *("emergency", "alert", "critical", "error"),
    *("warning", "notice", "info", "debug"),
)
"""Names of the severities of syslog, which PX4 and MAVLink use."""


class Message(NamedTuple):
    """One line of the autopilot's own log."""

    t_ns: int | None
    """Time at which it was written, on the clock of the log's other stamps, ns; None: not known."""
    level: str
    """One of ``LEVELS``; empty: the log does not say."""
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Onboard:
    """Firmware, parameters and messages of an autopilot."""

    firmware: str = ""
    """Name and version; empty: the log does not say."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """The first value of each, by name."""
    messages: tuple[Message, ...] = ()
    """The first ``MOST``."""
    left_out: int = 0
    """Messages beyond these."""


def clean(text: bytes | str) -> str:
    """Return a text on one line, without invisible characters, cut to ``LONGEST``."""
    if isinstance(text, bytes):
        # Wherever a fixed field ends, a character of several bytes may be cut
        text = text.partition(b"\0")[0].decode("utf-8", "replace")
    shown = "".join(one if one.isprintable() else " " for one in text[: 4 * LONGEST])
    return " ".join(shown.split())[:LONGEST]


def level_of(severity: int) -> str:
    """Return the name of a syslog severity; empty: there is none."""
    return LEVELS[severity] if 0 <= severity < len(LEVELS) else ""


def onboard(
    messages: Iterable[Message],
    parameters: Mapping[str, float],
    firmware: str = "",
    left_out: int = 0,
) -> Onboard:
    """Return what is kept; messages without a letter are dropped.

    Without a ``firmware`` the one that a message names is taken.
    """
    kept = [one for one in messages if one.text]
    firmware = firmware or next((one.text for one in kept if FIRMWARE.match(one.text)), "")
    named = {name: value for name, value in parameters.items() if name}
    return Onboard(
        firmware=clean(firmware),
        parameters=dict(list(named.items())[:MOST_PARAMETERS]),
        messages=tuple(kept[:MOST]),
        left_out=left_out + max(len(kept) - MOST, 0),
    )
