"""Compare every bit of all results with a revision's: ``make bits BASE=REVISION``.

The revision is checked out and built below ``build/bits``, with the same interpreter and libraries.
Both trees hash all results (:mod:`benchmarks.bits.hashes`, the base by its own if it has one); each
case and quantity that differs is named, and the exit code is 1 if one does. A quantity that only
one of them has, as a new column of the estimates, is named but is not a difference. Nothing is
recorded.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.bits.hashes import DATA, Hashes
from benchmarks.tree import HERE, checked_out, environment

SCRIPT = Path("benchmarks/bits/hashes.py")
NAMED = 8
"""Quantities and cases that a line names; the others are counted."""

Found = dict[str, Hashes]


def hashed(tree: Path, asked: argparse.Namespace) -> Found:
    """Return the hashes of a tree's results of the cases."""
    script = tree / SCRIPT
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "hashes.json"
        command = [sys.executable, str(script if script.exists() else HERE / SCRIPT), str(out)]
        command += [*asked.pattern, "--data", str(asked.data), "--jobs", str(asked.jobs)]
        subprocess.run(command, check=True, cwd=tree, env=environment(tree))
        found: Found = json.loads(out.read_text(encoding="utf-8"))
    return found


def compare(base: Found, here: Found) -> tuple[list[str], int]:
    """Return a line for all that differs, is new or gone in the same cases, and how many differ.

    A bug differs from everything, even from itself.
    """
    kinds: dict[str, dict[str, list[str]]] = {"differ": {}, "are new": {}, "are gone": {}}
    for case in sorted({*base} & {*here}):
        before, now = base[case], here[case]
        for quantity in sorted({*before, *now}):
            if quantity == "bug":
                words = f"bug: {now.get(quantity) or before[quantity]}"
                kinds["differ"].setdefault(words, []).append(case)
            elif quantity not in before:
                kinds["are new"].setdefault(quantity, []).append(case)
            elif quantity not in now:
                kinds["are gone"].setdefault(quantity, []).append(case)
            elif before[quantity] != now[quantity]:
                kinds["differ"].setdefault(quantity, []).append(case)
    lines = []
    for kind, found in kinds.items():
        alike: dict[tuple[str, ...], list[str]] = {}
        for quantity, cases in found.items():
            alike.setdefault(tuple(cases), []).append(quantity)
        lines += [f"{_some(names)} {kind} in {_some(cases)}" for cases, names in alike.items()]
    lines += [f"{case}: done by one of them only" for case in sorted({*base} ^ {*here})]
    return lines, sum(map(len, kinds["differ"].values()))


def _some(names: Sequence[str]) -> str:
    """Return the first names and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def main() -> None:
    """Compare this tree with a base."""
    parser = argparse.ArgumentParser(prog="benchmarks.bits", description=__doc__)
    parser.add_argument("base", help="a revision of git")
    parser.add_argument("pattern", nargs="*", default=["*"], help="cases, as a shell would match")
    parser.add_argument("--data", type=Path, default=DATA, help="the recordings")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_intermixed_args()
    if not asked.data.is_dir():
        print(f"{asked.data}: absent; only the simulated flights are compared")
    base, here = (hashed(tree, asked) for tree in (checked_out(asked.base, "bits"), HERE))
    lines, wrong = compare(base, here)
    for line in lines:
        print(line)
    quantities = sum(map(len, here.values()))
    print(f"{quantities} hashes of {len(here)} cases: {wrong or 'none'} differ from {asked.base}")
    sys.exit(int(wrong > 0))


if __name__ == "__main__":
    main()
