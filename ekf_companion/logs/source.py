"""Reading of a recorded file's bytes."""

from __future__ import annotations

from pathlib import Path

from ekf_companion.errors import LogError


def read_bytes(path: Path, kind: str) -> bytes:
    """Return all bytes of a file; its kind (``DataFlash .bin log``) is for messages.

    Raises:
        LogError: The file is missing, empty, a folder or not readable.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; check the path of the {kind}") from None
    except IsADirectoryError:
        raise LogError(f"{path}: a folder; name the {kind} inside it") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); check its rights") from None
    if not data:
        raise LogError(f"{path}: an empty file, not a {kind}; record or download it again")
    return data
