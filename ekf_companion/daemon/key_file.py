"""The secret from its file, and what signatures must remember over a restart.

The secret stands in no log, no status and no complaint: only the name of its file does.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import stat
import time
from pathlib import Path

from ekf_companion.config.config import Config
from ekf_companion.daemon.checkpoint_file import LARGEST, PATIENCE, Slot
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.signing import KEY_SIZE, Signing

_log = logging.getLogger(__name__)

INTERVAL_NS = 1_000_000_000
"""Between two times kept; what a crash loses, the margin of the next start makes good."""
FORCE = 60.0
"""Seconds between two copies forced to the disk: what is lost with the power is so much, and as old
may the first frame of a stream be in any case."""
SUFFIX = ".signing"
"""Behind the checkpoint's name."""
BORROWED_LINK = 1
"""Link id of who signs beside or after the daemon, whose own is 0."""
CREDENTIALS = "CREDENTIALS_DIRECTORY"
"""Where systemd puts what LoadCredential= names."""
_HEX = re.compile(rb"[0-9A-Fa-f]{%d}\n?" % (2 * KEY_SIZE))


class Keyring:
    """A secret in use, and the file that outlives us."""

    def __init__(self, signing: Signing, slot: Slot | None) -> None:
        """Go on from what the last run left.

        Args:
            signing: With the secret.
            slot: Where its times are kept; None: nowhere, and a start begins from the clock.
        """
        self.signing = signing
        self._slot = slot
        self._next_ns = 0
        if slot is not None:
            self._restore(slot)

    def _restore(self, slot: Slot) -> None:
        """Go on from the times of the last run, and from the copy that outlives a loss of power."""
        copy, state = slot.read_copy(), slot.read()
        is_restored = [self.signing.restore(found) for found in (copy, state) if found]
        if state and not is_restored[-1]:
            # Another secret, whose times are worth nothing, or no file of ours
            slot.put_aside("record of this secret's times")
        elif (slot.is_late or b"" in (copy, state)) and not any(is_restored):
            _log.warning(
                "%s: is empty, as a loss of power leaves it, or not to be had: the times of the "
                "last run are lost, and until this board knows what time it is, it believes signed "
                "frames that somebody has recorded and sends again; set its clock",
                slot.path,
            )

    def keep(self, now_ns: int) -> None:
        """Hand the times over to be written, where that is due; never waits."""
        if self._slot is not None and now_ns >= self._next_ns:
            self._next_ns = now_ns + INTERVAL_NS
            self._slot.keep(self.signing.state())

    def close(self) -> None:
        """Write the last times, if the disk lets us."""
        self.finish()
        self.join(time.monotonic() + PATIENCE)

    def finish(self) -> None:
        """Have the last times written; does not wait."""
        if self._slot is not None:
            self._slot.keep(self.signing.state())
            self._slot.finish()

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        if self._slot is not None:
            self._slot.join(end_s)


def open_keyring(config: Config) -> Keyring | None:
    """Read the secret and go on from the last run's times; None: nothing is to be signed.

    Raises:
        ConfigError: The file holds no secret, or others may read it.
    """
    if not config.signing.key_file:
        return None
    signing = Signing(read_key(config.signing.key_file))
    file = config.checkpoint.file
    loss = "a restart would sign from the clock"
    slot = Slot(Path(file + SUFFIX), loss, force_s=FORCE) if file else None
    return Keyring(signing, slot)


def borrow_signing(config: Config) -> Signing | None:
    """Read the secret and the times that the daemon keeps, of which nothing is written.

    What is signed with it is a stream of its own, of another link id than the daemon's: neither
    makes the other's frames old. What the autopilot says meanwhile is forgotten, as is what it
    says while no daemon runs: its next frame is newer than all of that.

    Raises:
        ConfigError: The file holds no secret, or others may read it.
    """
    if not config.signing.key_file:
        return None
    signing = Signing(read_key(config.signing.key_file), link_id=BORROWED_LINK)
    if config.checkpoint.file:
        # Without them it begins from the clock
        with contextlib.suppress(OSError), Path(config.checkpoint.file + SUFFIX).open("rb") as file:
            signing.restore(file.read(LARGEST))
    return signing


def read_key(name: str) -> bytes:
    """Give the 32 bytes of a secret.

    Args:
        name: The file; ``$CREDENTIALS_DIRECTORY`` in it is systemd's folder of credentials.

    Raises:
        ConfigError: It cannot be read, is no plain file of ours, others may read it, or it holds
            no secret; the sentence says which, and what would do, and nothing of the content.
    """
    path = os.path.expandvars(name)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise _complaint(
            path, f"{error.strerror}; name a file of mode 0600 that holds the secret"
        ) from None
    try:
        _check(path, os.fstat(descriptor))
        data = os.read(descriptor, 2 * KEY_SIZE + 2)
    except OSError as error:
        raise _complaint(path, f"{error.strerror}; name another file") from None
    finally:
        os.close(descriptor)
    if _HEX.fullmatch(data):
        return bytes.fromhex(data.decode("ascii").strip())
    if len(data) == KEY_SIZE:
        return data
    raise _complaint(
        path,
        f"holds no secret of {KEY_SIZE} bytes or {2 * KEY_SIZE} hexadecimal digits; make one with "
        f"openssl rand -hex {KEY_SIZE}",
    )


def _check(path: str, status: os.stat_result) -> None:
    """Refuse what anybody but us and root could read, change or put there."""
    if not stat.S_ISREG(status.st_mode):
        raise _complaint(path, "is no plain file; name one")
    if status.st_uid not in (0, os.geteuid()):
        raise _complaint(path, f"belongs to another user; chown {os.geteuid()} {path}")
    allowed = stat.S_IRUSR | stat.S_IWUSR
    if _is_credential(path):
        # Its folder is ours alone; the group's bit is the mask of an access list that names us
        allowed |= stat.S_IRGRP
    if (mode := stat.S_IMODE(status.st_mode)) & ~allowed:
        raise _complaint(path, f"has mode {mode:04o}, so that others may use it; chmod 600 {path}")


def _is_credential(path: str) -> bool:
    folder = os.environ.get(CREDENTIALS)
    return bool(folder) and Path(path).resolve().parent == Path(folder or "").resolve()


def _complaint(path: str, words: str) -> ConfigError:
    return ConfigError(f"signing.key_file: {path}: {words}")
