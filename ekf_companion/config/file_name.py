"""Where files are to be kept: whether a name can be one at all, and what its folder looks like."""

from __future__ import annotations

import os
from pathlib import Path

from ekf_companion.errors import ConfigError


def check_name(key: str, name: str) -> None:
    """Refuse what can never be the name of a file; the disk is not looked at.

    Raises:
        ConfigError: It cannot; the sentence names the key.
    """
    try:
        is_one = b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:
        is_one = False
    if not is_one or not Path(name).name or name.endswith(("/", "/.", "/..")) or name == "..":
        raise ConfigError(
            f"{key}: {name!r} is no name of a file; name one, and the folder it is in"
        )


def complaint(key: str, name: str) -> str | None:
    """Say why no file of that name could be begun now; None: nothing speaks against it.

    Rights are not looked at: the service has another user than whoever asks.

    Raises:
        ConfigError: No file can ever have that name.
    """
    check_name(key, name)
    path = Path(name)
    try:
        if path.parent.is_dir() and not path.is_dir():
            return None
    except OSError:  # not for us to see
        return None
    if path.is_dir():
        return f"{key}: {name}: is a folder; name a file in it"
    return f"{key}: {name}: there is no folder {path.parent}; make it, or name another"
