"""The name of this build: results of two builds are never taken for each other's."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from ekf_companion.config.config import Config
from ekf_companion.version import __version__

WITHOUT = ("arrays", "calibrate", "cli", "daemon", "doctor", "status")
"""Rooms that no result of a fleet goes through."""


@cache
def build_name() -> str:
    """Return the version, and eight digits of the hash of all sources that results depend on."""
    root = Path(__file__).resolve().parents[1]
    found = hashlib.blake2b(digest_size=4)
    for path in sorted(root.rglob("*.py")):
        place = path.relative_to(root)
        if place.parts[0] not in WITHOUT:
            found.update(place.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{__version__}-{found.hexdigest()}"


def fingerprint(config: Config) -> str:
    """Return 16 digits of the hash of version and configuration."""
    return hashlib.sha256(f"{__version__} {config!r}".encode()).hexdigest()[:16]
