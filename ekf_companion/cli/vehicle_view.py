"""Layout for a terminal of the vehicle's state, the aids in use, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

Data = Mapping[str, Any]
_COLOURS = {"used": None, "refused": "red", "lost": "red", "none": "dim"}
"""Colours of the states of an aid."""
_USUAL = ("position", "height", "velocity", "heading", "baro", "rest")
"""Aids of which each is shown, whether there is one or not."""
_OLD_S = 1.0
"""Age, s, from which on an estimate is shown with its age."""


def named(data: Data) -> str:
    """Return which vehicle a status is of, over which link."""
    peer, link = data["peer"], data["link"]["url"]
    if not peer:
        return f"no autopilot yet, on {link}"
    text = f"system {peer['system_id']}, {peer['family']} {peer['version']}".strip()
    return f"{text}, on {link}"


def vehicle_parts(data: Data, *, is_brief: bool = False) -> list[RenderableType]:
    """Return verdict, vehicle and aids; nothing if the daemon is too old to send them.

    In brief an aid that has never been heard is left out.
    """
    from rich.text import Text

    if not data.get("vehicle"):
        return []
    verdict, aids = data["preflight"], data["vehicle"]["aids"]
    colour = "green" if verdict["ready"] else "yellow"
    sentence = Text(f"take-off: {verdict['sentence']}", style=colour)
    return [
        sentence,
        _numbers(data["vehicle"], data["sample_age_s"]),
        _aids({name: aid for name, aid in aids.items() if not is_brief or _is_there(name, aid)}),
    ]


def _is_there(name: str, aid: Data) -> bool:
    return bool(name in _USUAL or aid["state"] != "none")


def _plain_table(*columns: str) -> Table:
    """Return a table without lines, for a small screen."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", no_wrap=True)
    return table


def _numbers(vehicle: Data, age_s: float | None) -> Table:
    sigma, other = vehicle["sigma"], vehicle["autopilot"] or {}
    age = "" if not other else f", {fixed(other['age_s'], 1)} s ago"
    is_old = age_s is not None and age_s > _OLD_S
    estimate = f"estimate, {fixed(age_s, 1)} s ago" if is_old else "estimate"
    table = _plain_table("Vehicle", estimate, "one sigma", f"autopilot{age}", "")
    table.columns[4].justify = "left"
    for column in (1, 3):  # their titles are longer than the numbers
        table.columns[column].no_wrap = False
    for name, key, std, digits, unit in (
        ("latitude", "lat_deg", f"{fixed(sigma['north_m'], 2)} m", 7, "deg"),
        ("longitude", "lon_deg", f"{fixed(sigma['east_m'], 2)} m", 7, "deg"),
        ("height", "alt_m", f"{fixed(sigma['alt_m'], 2)} m", 2, "m AMSL"),
        ("roll", "roll_deg", f"{fixed(sigma['roll_deg'], 1)} deg", 1, "deg"),
        ("pitch", "pitch_deg", f"{fixed(sigma['pitch_deg'], 1)} deg", 1, "deg"),
        ("heading", "heading_deg", f"{fixed(sigma['heading_deg'], 1)} deg", 1, "deg"),
    ):
        table.add_row(name, fixed(vehicle[key], digits), std, fixed(other.get(key), digits), unit)
    theirs = other.get("vel_ned_m_s", (None, None, None))
    velocities = zip(vehicle["vel_ned_m_s"], sigma["vel_ned_m_s"], theirs, strict=True)
    for name, (ours, std, own) in zip(("north", "east", "down"), velocities, strict=True):
        numbers = fixed(ours, 2), f"{fixed(std, 2)} m/s", fixed(own, 2)
        table.add_row(f"speed {name}", *numbers, "m/s")
    return table


def _aids(aids: Mapping[str, Data]) -> Table:
    from rich.markup import escape

    table = _plain_table("Aid", "for", "from")
    table.columns[2].justify = "left"
    table.columns[2].no_wrap = False
    absent = [name for name in aids if name not in _USUAL and aids[name]["state"] == "none"]
    for name, aid in aids.items():
        if name in absent:
            continue
        state = aid["state"]
        # A vehicle that moves has lost nothing
        word = "moving" if (name, state) == ("rest", "lost") else state
        since = f"{fixed(aid['since_s'], 0)} s" if state == "used" else word
        why = f": {aid['why']}" if state == "refused" else ""
        table.add_row(name, since, escape(f"{aid['source']}{why}"), style=_COLOURS.get(word))
    if absent:
        table.add_row("others", "none", ", ".join(absent), style=_COLOURS["none"])
    return table


def fixed(value: float | None, digits: int) -> str:
    """Return a number with so many decimals; ``-`` if it is not known."""
    return "-" if value is None else f"{round(value, digits) + 0.0:.{digits}f}"  # no -0.0
