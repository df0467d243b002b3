"""Trees of other revisions, built below ``build`` with this interpreter and its libraries."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]


def checked_out(revision: str, purpose: str) -> Path:
    """Return the tree of a revision below ``build/PURPOSE``, built; one that is there is kept.

    Raises:
        subprocess.CalledProcessError: There is no such revision, or it cannot be built.
    """
    asked = ["git", "rev-parse", "--verify", "--short=12", f"{revision}^{{commit}}"]
    found = subprocess.run(asked, check=True, cwd=HERE, capture_output=True, text=True)
    commit = found.stdout.strip()
    tree = HERE / "build" / purpose / commit
    if not tree.exists():
        subprocess.run(["git", "worktree", "prune"], check=True, cwd=HERE)
        adding = ["git", "worktree", "add", "--quiet", "--detach", str(tree), commit]
        subprocess.run(adding, check=True, cwd=HERE)
    print(f"building {revision} in {tree.relative_to(HERE)}", file=sys.stderr)
    build(tree)
    return tree


def build(tree: Path) -> None:
    """Compile what has changed of a tree's kernel.

    Raises:
        subprocess.CalledProcessError: It cannot be built.
    """
    command = [sys.executable, "setup.py", "build_ext", "--inplace"]
    subprocess.run(command, check=True, cwd=tree, env=environment(tree), capture_output=True)


def environment(tree: Path) -> dict[str, str]:
    """Return the environment in which Python imports from a tree."""
    return {**os.environ, "PYTHONPATH": str(tree)}
