"""Tables in markdown, printed or put between their marks in a document."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

DATA = Path("../shared/data")
Part = Callable[[Path, int | None], Iterable[str]]
"""Makes the lines of one table from the folder of recorded flights and a number of simulated
ones (None: its usual number). Without what it needs it has no more than a heading."""


def table(head: str, rows: Iterable[str]) -> Iterator[str]:
    """Yield a heading, its rule and rows; cells are separated by `` | ``."""
    yield f"| {head} |"
    yield "|---" * (head.count(" | ") + 1) + "|"
    for row in rows:
        yield f"| {row} |"


def of_logs(part: Callable[[Path], Iterable[str]]) -> Part:
    """Adapt a part that reads recorded flights only."""
    return lambda data, runs: part(data)


def of_flights(part: Callable[[int | None], Iterable[str]]) -> Part:
    """Adapt a part that simulates all its flights."""
    return lambda data, runs: part(runs)


def is_there(data: Path, log: str) -> bool:
    """Return whether a log can be read, and print that it is left out if not."""
    if not (data / log).exists():
        print(f"{log}: absent, left out")
        return False
    return True


def insert(text: str, name: str, lines: str) -> str:
    """Put lines between the marks ``<!-- name -->`` and ``<!-- end -->`` of a document."""
    marks = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    return marks.sub(lambda match: f"{match[1]}{lines}\n{match[2]}", text)


def write(path: Path, name: str, lines: str) -> None:
    """Put lines between the marks of a document, or of those in a folder that have them."""
    for page in sorted(path.glob("*.md")) if path.is_dir() else [path]:
        before = page.read_text(encoding="utf-8")
        if (after := insert(before, name, lines)) != before:
            page.write_text(after, encoding="utf-8")


def main(description: str | None, parts: Mapping[str, Part]) -> None:
    """Print the parts that are asked for, or write them into documents."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--data", type=Path, default=DATA, help="the recorded flights")
    parser.add_argument(
        "--write", type=Path, metavar="PATH", help="a document with marks, or a folder"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=parts, default=list(parts))
    parser.add_argument("--runs", type=int, help="simulated flights of each kind")
    asked = parser.parse_args()
    if not asked.data.is_dir():
        print(f"{asked.data}: the recorded flights are not here; name their folder with --data")
    for name in asked.only:
        lines = "\n".join(parts[name](asked.data, asked.runs)).strip()
        if asked.write is None:
            print(f"\n## {name}\n\n{lines}")
        elif lines.count("\n") > 1:
            write(asked.write, name, lines)
