"""What an aid declares of itself: from that the layout, the bounds and the dispatch are made.

An aid is a file of ``core/aids`` with a class that ``@aid`` marks. Memory is laid out before any
aid is compiled, so the class is read from the source of its file, and nothing else of it.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ekf_companion.errors import ConfigError
from ekf_companion.nav.measurements import WIDTH, Kind

FOLDER = Path(__file__).parent.parent / "aids"


@dataclass(frozen=True, slots=True)
class Value:
    """A number of the aid's row, which no sensor can have at or beyond its bounds."""

    unit: str
    low: float
    high: float
    is_optional: bool = False
    """NaN stands for: not known."""


@dataclass(frozen=True, slots=True)
class SlowError:
    """One error state, which walks by the named settings of its aid."""

    unit: str
    walk: str | None = "walk"
    """Of its unit by sqrt(s); None: it keeps still."""
    speed_walk: str | None = "speed_walk"
    """The same for each m/s of speed."""
    climb_walk: str | None = None
    """The same for each m/s of climb or descent."""


@dataclass(frozen=True, slots=True)
class Kept:
    """What is kept from one measurement to the next, beside the slow errors; 0 at the start."""

    unit: str
    size: int = 1


@dataclass(frozen=True, slots=True)
class Declaration:
    """An aid, as its file declares it."""

    name: str
    """Of its file, of its settings and of its column."""
    kind: Kind
    words: str
    """What it measures, as a user calls it."""
    sensor: str
    """What measures it."""
    advice: str
    """What helps where it is refused."""
    row: dict[str, Value]
    """By name; they stand in this order from the first number of the row."""
    slow_errors: dict[str, SlowError]
    stuck_after: float
    """Time for which a sensor that works cannot repeat a reading to the bit, s; 0: it can."""
    patience: int
    """Readings in a row that may lie between the gates; more are refused. 0: any number may."""
    yields: bool
    """Whether the receiver's velocity is right where the two contradict each other."""
    is_tried: bool
    """No single reading shows its slow errors: it counts once its readings have agreed for long."""
    kept: dict[str, Kept]
    parts: int
    """How many observations one measurement makes, one after another."""
    shows_position: bool
    """It has a ``place``: navigation can start by it, and goes on by it without fixes."""
    shows_velocity: bool
    """Navigation goes on by it without fixes."""


def aid(
    kind: Kind,
    *,
    words: str,
    sensor: str,
    advice: str,
    stuck_after: float = 0.0,
    patience: int = 0,
    yields: bool = False,
    is_tried: bool = False,
    parts: int = 1,
    shows_position: bool = False,
    shows_velocity: bool = False,
) -> Callable[[type], type]:
    """Mark the class that declares an aid; its values and slow errors are what it assigns."""

    def mark(declared: Any) -> type:
        row = {key: one for key, one in vars(declared).items() if isinstance(one, Value)}
        errors = {key: one for key, one in vars(declared).items() if isinstance(one, SlowError)}
        if len(row) > WIDTH:
            raise ValueError(f"{declared.__name__}: a row has {WIDTH} numbers, this {len(row)}")
        name = declared.__module__.rpartition(".")[2]
        kept = {key: one for key, one in vars(declared).items() if isinstance(one, Kept)}
        faults = stuck_after, patience, yields, is_tried
        shows = shows_position, shows_velocity
        declared.found = Declaration(
            name, kind, words, sensor, advice, row, errors, *faults, kept, parts, *shows
        )
        return declared

    return mark


def declared_in(path: Path) -> Declaration | None:
    """Return what a file declares; None: it is no aid of its own.

    Raises:
        ValueError: It declares a name twice, of which the second would hide the first.
    """
    text = path.read_text(encoding="utf-8")
    if "\n@aid(" not in text:
        return None
    node = next(one for one in ast.parse(text).body if isinstance(one, ast.ClassDef))
    targets = [ast.unparse(one.targets[0]) for one in node.body if isinstance(one, ast.Assign)]
    if len({*targets}) < len(targets):
        raise ValueError(f"{path.name}: {node.name} declares a name twice")
    names: dict[str, Any] = {one.__name__: one for one in (aid, Value, SlowError, Kept, Kind)}
    names["__name__"] = path.stem
    exec(compile(ast.Module([node], []), path, "exec"), names)
    found: Declaration = names[node.name].found
    return found


DECLARED = tuple(
    sorted(
        (found for path in FOLDER.glob("[!.]*.py") if (found := declared_in(path)) is not None),
        key=lambda one: one.kind,
    )
)
"""All that are declared, by kind."""
BY_KIND = {one.kind: one for one in DECLARED}


def find(name: str) -> Declaration:
    """Return what an aid declares, by its name.

    Raises:
        ConfigError: There is none of this name.
    """
    for one in DECLARED:
        if one.name == name:
            return one
    known = ", ".join(one.name for one in DECLARED)
    raise ConfigError(f"aids: {name}: there is none of this name; known are {known}")
