"""Check names of files that the configuration gives, and the folders that they are in."""

from __future__ import annotations

import os
from pathlib import Path

from ekf_companion.errors import ConfigError


def check_name(key: str, name: str) -> None:
    """Refuse what can never be the name of a file, without a look at the disk.

    Raises:
        ConfigError: It is no name of a file; the sentence names the key.
    """
    try:
        is_name = b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:
        is_name = False
    if not is_name or not Path(name).name or name.endswith(("/", "/.", "/..")) or name == "..":
        raise ConfigError(
            f"{key}: {name!r} is no name of a file; name one, and the folder it is in"
        )


def why_not_writable(key: str, name: str) -> str | None:
    """Return why no file of that name could be created now, or None if one could.

    Permissions are not checked: the service runs as another user than whoever asks.

    Raises:
        ConfigError: No file can ever have that name.
    """
    check_name(key, name)
    path = Path(name)
    try:
        if path.parent.is_dir() and not path.is_dir():
            return None
    except OSError:  # this user may not look there
        return None
    if path.is_dir():
        return f"{key}: {name}: is a folder; name a file in it"
    return f"{key}: {name}: there is no folder {path.parent}; make it, or name another"
