"""The secret of signing from its file, and the times of its signatures across a restart.

The secret appears in no log, no status and no error: only the name of its file does.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import stat
from pathlib import Path

from ekf_companion.config.config import Config
from ekf_companion.daemon.checkpoint_file import LARGEST, StateFile
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.signing import KEY_SIZE, Signing

_log = logging.getLogger(__name__)

INTERVAL_NS = 1_000_000_000
"""Time between two writes of the signatures' times; the next start adds a margin for a crash."""
COPY_PERIOD = 60.0
"""Seconds between two synced copies: a loss of power loses as much, and the first frame of a stream
may be that old in any case."""
SUFFIX = ".signing"
"""Appended to the checkpoint's name."""
BORROWED_LINK = 1
"""Link id of a program that signs beside or after the daemon, whose own is 0."""
CREDENTIALS = "CREDENTIALS_DIRECTORY"
"""The variable that names the folder of what LoadCredential= loads."""
_HEX = re.compile(rb"[0-9A-Fa-f]{%d}\n?" % (2 * KEY_SIZE))


class SigningState:
    """A secret in use, and the files that keep the times of its signatures across a restart."""

    def __init__(self, signing: Signing, name: str) -> None:
        """Continue from the later time of the file and of the copy for a loss of power.

        Without a name there is no file, and each start begins from the clock.
        """
        self.signing = signing
        self._next_ns = 0
        self._files: list[StateFile] = []
        if name:
            loss = "a restart would sign from the clock"
            copy = StateFile(Path(name + ".copy"), loss, period=COPY_PERIOD, is_synced=True)
            self._files = [copy, StateFile(Path(name), loss)]
            self._restore(*self._files)

    def _restore(self, copy: StateFile, file: StateFile) -> None:
        states = (copy.read(), file.read())
        is_restored = [self.signing.restore(found) for found in states if found]
        if states[1] and not is_restored[-1]:
            # Those of another secret are worth nothing, nor is a file that is not ours
            file.set_aside("record of this secret's times")
        elif (file.is_late or b"" in states) and not any(is_restored):
            _log.warning(
                "%s: is empty, as after a loss of power, or cannot be read: the times of the last "
                "run are lost, and until this board knows the time, signed frames that somebody "
                "has recorded and sends again are accepted; set its clock",
                file.path,
            )

    def write(self, now_ns: int) -> None:
        """Have the times written, if that is due; never waits."""
        if self._files and now_ns >= self._next_ns:
            self._next_ns = now_ns + INTERVAL_NS
            self._write()

    def finish(self) -> None:
        """Have the last times written; does not wait for it."""
        self._write()
        for file in self._files:
            file.finish()

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        for file in self._files:
            file.join(end_s)

    def _write(self) -> None:
        state = self.signing.state()
        for file in self._files:
            file.write(state)


def open_signing(config: Config) -> SigningState | None:
    """Read the secret and continue from the last run's times; return None if nothing is signed.

    Raises:
        ConfigError: The file holds no secret, or others may read it.
    """
    if not config.signing.key_file:
        return None
    signing, file = Signing(read_key(config.signing.key_file)), config.checkpoint.file
    return SigningState(signing, file + SUFFIX if file else "")


def borrow_signing(config: Config) -> Signing | None:
    """Read the secret and the times that the daemon keeps, and write nothing.

    Frames signed with it are a stream with another link id than the daemon's: neither makes the
    other's frames old. What the autopilot sends in the meantime is not recorded, as is what it
    sends while no daemon runs: its next frame is newer than all of that.

    Raises:
        ConfigError: The file holds no secret, or others may read it.
    """
    if not config.signing.key_file:
        return None
    signing = Signing(read_key(config.signing.key_file), link_id=BORROWED_LINK)
    if config.checkpoint.file:
        # Without the times, it begins from the clock
        with contextlib.suppress(OSError), Path(config.checkpoint.file + SUFFIX).open("rb") as file:
            signing.restore(file.read(LARGEST))
    return signing


def read_key(name: str) -> bytes:
    """Return the 32 bytes of a secret from a file.

    ``$CREDENTIALS_DIRECTORY`` in its name is systemd's folder of credentials.

    Raises:
        ConfigError: It cannot be read, is not a regular file of ours, others may read it, or it
            holds no secret; the message says which and the remedy, and nothing of the content.
    """
    path = os.path.expandvars(name)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise _refusal(
            path, f"{error.strerror}; name a file of mode 0600 that holds the secret"
        ) from None
    try:
        _check(path, os.fstat(descriptor))
        data = os.read(descriptor, 2 * KEY_SIZE + 2)
    except OSError as error:
        raise _refusal(path, f"{error.strerror}; name another file") from None
    finally:
        os.close(descriptor)
    if _HEX.fullmatch(data):
        return bytes.fromhex(data.decode("ascii").strip())
    if len(data) == KEY_SIZE:
        return data
    raise _refusal(
        path,
        f"holds no secret of {KEY_SIZE} bytes or {2 * KEY_SIZE} hexadecimal digits; make one with "
        f"openssl rand -hex {KEY_SIZE}",
    )


def _check(path: str, status: os.stat_result) -> None:
    """Refuse a file that anybody but us and root could read, change or replace."""
    if not stat.S_ISREG(status.st_mode):
        raise _refusal(path, "is not a regular file; name one")
    if status.st_uid not in (0, os.geteuid()):
        raise _refusal(path, f"belongs to another user; chown {os.geteuid()} {path}")
    allowed = stat.S_IRUSR | stat.S_IWUSR
    folder = os.environ.get(CREDENTIALS)
    if folder and Path(path).resolve().parent == Path(folder).resolve():
        # Its folder is ours alone; the group's bit is the mask of an access list with our user
        allowed |= stat.S_IRGRP
    if (mode := stat.S_IMODE(status.st_mode)) & ~allowed:
        raise _refusal(path, f"has mode {mode:04o}, so that others may use it; chmod 600 {path}")


def _refusal(path: str, words: str) -> ConfigError:
    return ConfigError(f"signing.key_file: {path}: {words}")
