"""Objects of stores (``s3://``, ``gs://``, ``https://`` and what else fsspec knows), as files.

Keys are taken from where each store's own tools look for them: the environment, its configuration
file, the machine's role. No message shows them, nor the signature or the user in a URL: an error of
a store's package, whose text may hold them, is replaced by a sentence.
"""

from __future__ import annotations

import errno
import logging
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from ekf_companion.errors import (
    CompanionError,
    ConfigError,
    LogError,
    MissingPackageError,
    UnreachableError,
    part_of,
    remedy,
)
from ekf_companion.fleet.folder import SUFFIXES, printable
from ekf_companion.logs.source import BLOCK, LARGEST, suffix_of

ATTEMPTS = 3
"""How often an object is fetched that is cut off, or that changes meanwhile."""
PAUSE_S = 0.5
"""Pause before the second attempt; before each further one, twice as long."""
CHANGES = "it changes while it is read; the next run reads it"
_TALKATIVE = ("aiobotocore", "botocore", "s3fs", "gcsfs", "fsspec", "aiohttp", "asyncio")
"""Loggers of the stores' packages, whose lines and tracebacks hold signed URLs."""
_URL = re.compile(r"""[\s'"<]*([a-z][a-z0-9+.:-]+://|(https?|s3|gs):/)""", re.IGNORECASE)
"""With what is easily typed before it, and with a slash too few: it may hold a key all the same."""
_WEB = ("http", "https")
_PASSWORD = re.compile(r"[^\[]*:(?!\d*$)")
"""A host that is none: a user, and a password up to its first slash."""


def is_url(place: str) -> bool:
    """Return whether a place is a URL, not a path."""
    return _URL.match(place) is not None


def shown(url: str) -> str:
    """Return a URL without user, password and query; of a web server's, decoded.

    In the key of a store ``#``, ``%`` and a ``?`` without parameters are letters as others.
    """
    *begin, rest = re.split("(:/{1,2})", url, maxsplit=1)
    host = re.split("[/?#]", rest, maxsplit=1)[0]
    if "@" in host:
        rest = rest[host.rindex("@") + 1 :]
    elif _PASSWORD.match(host):
        rest = rest.rpartition("@")[2]
    if begin and begin[0].lower() in _WEB:
        rest = unquote(re.split("[?#]", rest, maxsplit=1)[0])
    return printable("".join([*begin, _without_query(rest)]))


def _without_query(key: str) -> str:
    return re.split(r"\?(?=[^/]*=)", key, maxsplit=1)[0]


def hidden(text: str) -> str:
    """Return a text in which each URL is as it is shown."""
    return re.sub(r"[a-z][a-z0-9+.-]*://\S+", lambda found: shown(found[0]), text)


@contextmanager
def sentences(name: str) -> Iterator[None]:
    """Turn the errors of a store's package into sentences that begin with a name.

    Raises:
        UnreachableError: It may be there the next time.
        LogError: It is not there.
        MissingPackageError: The store's package is not installed.
    """
    try:
        yield
    except CompanionError:
        raise
    except FileNotFoundError:
        raise LogError(f"{name}: no such object; check its address") from None
    except PermissionError:
        raise UnreachableError(
            f"{name}: access is refused; check the key of whoever reads it, and its rights"
        ) from None
    except ImportError as error:
        package = _package(error)
        how = remedy("fleet").replace("'ekf-companion[fleet]'", package)  # no extra has them all
        raise MissingPackageError(
            f"{name}: needs {package}, which is not installed: {how}"
        ) from None
    except Exception as error:  # noqa: BLE001  every store has its own, and their texts hold keys
        raise UnreachableError(f"{name}: {_why(error)}") from None


def _package(error: ImportError) -> str:
    """Return the package that fsspec asks for: ``Install s3fs to access S3``."""
    found = re.search(r"[Ii]nstall (?:the )?([\w-]+)", str(error))
    return found[1] if found else error.name or "a package of its store"


def _why(error: Exception) -> str:
    kind = type(error).__name__
    if kind in ("FileExpired", "PreconditionFailed"):  # the store compares ETags itself
        return CHANGES
    if getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT):
        folder = tempfile.gettempdir()
        return f"no space for a copy of it is left in {folder}; make some, or set TMPDIR"
    if "Credential" in kind or "Token" in kind:
        return "there is no key for it, or an expired one; give one as the store's own tools want"
    status = getattr(error, "status", None)
    if status in (401, 403):
        return "access is refused; check the key of whoever reads it, and its rights"
    return f"the connection was lost ({kind}); it is read again by the next run"


def file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it."""
    with part_of("fleet", shown(url)):
        import fsspec
    for name in _TALKATIVE:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        with sentences(shown(url)):
            fsspec.get_filesystem_class(url.partition("://")[0].lower())
    except UnreachableError:
        raise ConfigError(
            f"{shown(url)}: no store is known by this name; known are s3://, gs://, https://"
        ) from None
    with sentences(shown(url)):
        system, path = fsspec.core.url_to_fs(url)
        return system, str(path)


def find(url: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield URL, name and properties of each log of an object, a folder or a pattern.

    Only one folder's properties are in memory at a time.

    Raises:
        LogError: There is nothing of that name, or the store does not answer.
    """
    system, path = file_system(url)
    scheme, name = url.partition("://")[0], shown(url)
    is_web = scheme.lower() in _WEB
    key = re.split("[?#]", path, maxsplit=1)[0] if is_web else _without_query(path)
    with sentences(name):
        # What follows a ? in the URL of a web server is no pattern, nor is the key of an object
        is_pattern = any(letter in key for letter in "*?[") and (is_web or not system.exists(path))
        if not is_pattern:
            # A signature belongs to this one object
            if suffix_of(Path(PurePosixPath(key).name)) in SUFFIXES:
                yield url, name, _properties(system.info(path))
                return
            folders: Iterator[Any] = system.walk(path, detail=True, on_error="raise")
            found = (one for _, _, files in folders for one in files.values())
        else:
            found = iter(system.glob(path, detail=True).values())
        count = 0
        for one in found:
            inner = str(one["name"])
            if one.get("type") == "file" and suffix_of(Path(inner)) in SUFFIXES:
                count += 1
                place = inner if is_url(inner) else f"{scheme}://{inner}"
                yield place, shown(place), _properties(one)
        system.invalidate_cache()  # of a hundred thousand objects it is large
    if not count:
        raise LogError(f"{name}: no log there ({', '.join(SUFFIXES)})")


def _properties(info: dict[str, Any]) -> dict[str, Any]:
    """Return size and stamp of an object, as far as its store says them."""
    stamp = next(
        (info[name] for name in ("ETag", "etag", "LastModified", "mtime") if info.get(name)), ""
    )
    size = info.get("size")
    return {"size": size if isinstance(size, int) else None, "stamp": str(stamp).strip('"')}


@contextmanager
def fetched(url: str, name: str) -> Iterator[Path]:
    """Yield the path of a copy of an object, which is read ``BLOCK`` bytes at a time.

    Raises:
        UnreachableError: It is cut off, changes or is refused each time that it is fetched.
        LogError: It is not there, or is larger than any log.
    """
    with sentences(name):
        made = tempfile.TemporaryDirectory(prefix="ekf-companion-")
    with made as folder:
        path = Path(folder) / f"log{''.join(_suffixes(name))}"
        for attempt in range(1, ATTEMPTS + 1):
            try:
                _fetch(url, name, path)
                break
            except UnreachableError:
                if attempt == ATTEMPTS:
                    raise
                time.sleep(PAUSE_S * 2.0 ** (attempt - 1))
        yield path


def _suffixes(name: str) -> list[str]:
    return [one for one in PurePosixPath(name).suffixes[-2:] if len(one) < 8 and one[1:].isalnum()]


def _fetch(url: str, name: str, path: Path) -> None:
    system, inner = file_system(url)
    with sentences(name):
        system.invalidate_cache()
        before = _properties(system.info(inner))
        size = 0
        with system.open(inner, "rb", block_size=BLOCK) as source, path.open("wb") as target:
            while block := source.read(BLOCK):
                size += len(block)
                if size > LARGEST:
                    raise LogError(f"{name}: is larger than any log ({LARGEST >> 30} GiB)")
                target.write(block)
        system.invalidate_cache()
        after = _properties(system.info(inner))
        if before != after or (after["size"] is not None and size != after["size"]):
            raise UnreachableError(f"{name}: {CHANGES}")
