"""Draw which room hands which data to which, docs/images/flow.svg, from the code.

A room is a lifeline, a kind of data an arrow from the rooms that make it to those that take it. A
room makes what it constructs or returns, and takes what a parameter of its functions is. Run by
``make reference``.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

from tests.paths import ROOT

PACKAGE = "ekf_companion"
PICTURE = ROOT / "docs" / "images" / "flow.svg"
ROOMS = (
    *("link", "daemon", "status", "engine", "mavlink", "core"),
    *("logs", "replay", "review", "filters", "calibrate", "analysis"),
)
"""From left to right. Not drawn are those whose data are everybody's: nav, config, cli, doctor."""
FLOWS = {
    "live": (
        *("link.link.Received", "mavlink.frame.Frame", "nav.measurements.Row"),
        *("engine.pipeline.Estimate", "nav.state.Odometry", "mavlink.outbox.Message"),
        "status.snapshot.Snapshot",
    ),
    "from a log": (
        *("logs.recording.Recording", "nav.measurements.Events", "filters.solution.Solution"),
        *("nav.state.Table", "nav.state.Trajectory"),
    ),
}
"""Kinds of data, from top to bottom."""
LAST = {name.rpartition(".")[2] for group in FLOWS.values() for name in group}
LEFT, STEP, TOP, ROW = 440, 78, 64, 44
"""Of the words' column, from room to room, above the first row, from row to row: pixels."""
STYLE = (
    "text{font:12px sans-serif;fill:#222}.room,.kind{font-weight:bold}"
    ".group{font-style:italic}.words{fill:#666;font-size:11px}"
    "line{stroke:#bbb}.flow{stroke:#0b62a4;stroke-width:2}circle,path{fill:#0b62a4}"
)


@dataclass
class Kind:
    """A kind of data."""

    words: str
    """First sentence of its docstring."""
    makers: set[str]
    takers: set[str]


@cache
def _module(name: str) -> ast.Module | None:
    path = ROOT / Path(*name.split("."))
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.exists():
            return ast.parse(file.read_text(encoding="utf-8"))
    return None


@cache
def _names(module: str) -> dict[str, str]:
    """Return where each global name of a module is defined, and its imported modules."""
    tree, names = _module(module), {}
    for node in ast.walk(tree) if tree else ():
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
            for one in node.names:
                names[one.asname or one.name] = f"{node.module}.{one.name}"
    for node in tree.body if tree else ():
        if isinstance(node, ast.ClassDef):
            names[node.name] = f"{module}.{node.name}"
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            names[node.targets[0].id] = f"{module}.{node.targets[0].id}"
    return names


def _origin(module: str, node: ast.AST) -> str | None:
    """Return where a kind of data that an expression names is defined."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.attr in LAST:
        name = _names(module).get(node.value.id, "") + f".{node.attr}"
    elif isinstance(node, ast.Name) and node.id in LAST:
        name = _names(module).get(node.id, "")
    else:
        return None
    while name:
        owner, _, last = name.rpartition(".")
        found = _names(owner).get(last, name) if owner else name
        if found == name:
            return name
        name = found
    return None


def _origins(module: str, annotation: ast.expr | None) -> Iterator[str]:
    for node in ast.walk(annotation) if annotation is not None else ():
        if (name := _origin(module, node)) is not None:
            yield name


def _words(kind: str) -> str:
    """Return the first sentence below the definition of a kind of data."""
    module, _, name = kind.rpartition(".")
    tree = _module(module)
    body = tree.body if tree else []
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        if isinstance(node, ast.ClassDef) and node.name == name:
            return (ast.get_docstring(node) or "").split(".")[0].split("\n\n")[0]
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            assert isinstance(after, ast.Expr), f"{kind} has no docstring"
            return ast.literal_eval(after.value).split(".")[0]
    raise AssertionError(f"{kind} is not defined: name what took its place in FLOWS")


def read() -> dict[str, Kind]:
    """Return the rooms that make and take each kind of data."""
    names = [f"{PACKAGE}.{name}" for group in FLOWS.values() for name in group]
    constructed, returned, taken = ({name: set[str]() for name in names} for _ in range(3))
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        room = module.split(".")[1]
        tree = _module(module) if room in ROOMS else None
        for node in ast.walk(tree) if tree else ():
            if isinstance(node, ast.Call) and (made := _origin(module, node.func)) in constructed:
                constructed[made].add(room)
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                every = [*node.args.args, *node.args.kwonlyargs]
                given = {name for one in every for name in _origins(module, one.annotation)}
                for name in taken.keys() & given:
                    taken[name].add(room)
                for name in returned.keys() & set(_origins(module, node.returns)) - given:
                    returned[name].add(room)
    # A room that returns what others construct has got it from them
    return {
        name: Kind(
            " ".join(_words(name).replace("``", "").split()),
            constructed[name] or returned[name],
            (returned[name] | taken[name]) - (constructed[name] or returned[name]),
        )
        for name in names
    }


def draw(kinds: dict[str, Kind]) -> str:
    """Return the picture."""
    at = {room: LEFT + STEP * (number + 0.5) for number, room in enumerate(ROOMS)}
    width = LEFT + STEP * len(ROOMS)
    shapes, y = [], TOP
    for title, group in FLOWS.items():
        shapes.append(f'<text class="group" x="12" y="{y}">{title}</text>')
        y += ROW - 12
        for name in group:
            kind = kinds[f"{PACKAGE}.{name}"]
            module, _, last = name.rpartition(".")
            shapes += [
                f'<text x="12" y="{y}"><tspan class="kind">{last}</tspan> of {module}</text>',
                f'<text class="words" x="12" y="{y + 15}">{escape(kind.words)}</text>',
            ]
            makers = [at[room] for room in ROOMS if room in kind.makers]
            ends = [*makers, *(at[room] for room in ROOMS if room in kind.takers)]
            line = f'x1="{min(ends):g}" x2="{max(ends):g}" y1="{y}" y2="{y}"'
            shapes.append(f'<line class="flow" {line}/>')
            shapes += [f'<circle cx="{x:g}" cy="{y}" r="5"/>' for x in makers]
            for x in ends[len(makers) :]:
                # The arrow comes from the nearest room that makes it
                back = -11 if min(makers, key=lambda maker: abs(maker - x)) < x else 11
                shapes.append(f'<path d="M{x:g} {y}l{back} -6v12z"/>')
            y += ROW
        y += ROW // 4
    lanes = [
        f'<text class="room" x="{x:g}" y="28" text-anchor="middle">{room}</text>'
        f'<line x1="{x:g}" x2="{x:g}" y1="36" y2="{y - ROW // 2}"/>'
        for room, x in at.items()
    ]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {y - ROW // 4}">'
    back = '<rect width="100%" height="100%" fill="#fff"/>'
    return "\n".join([head, f"<style>{STYLE}</style>", back, *lanes, *shapes, "</svg>", ""])


if __name__ == "__main__":
    PICTURE.write_text(draw(read()), encoding="utf-8")
