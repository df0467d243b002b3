"""The logs that are named: files, folders, patterns, URLs, and lists of these.

A list is ``@FILE``: a name a line, or the JSON of Flight Review's public list of logs
(https://review.px4.io/dbinfo), an array of objects with a ``log_id`` each. It is read piece by
piece, and from a URL too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, NamedTuple

from ekf_companion.errors import ConfigError
from ekf_companion.fleet import remote
from ekf_companion.fleet.folder import SUFFIXES, each_log, printable
from ekf_companion.fleet.source import Source, of_path, printable_name

LIST = "@"
"""Begins the name of a list."""
DOWNLOAD = "https://review.px4.io/download?log="
"""Where a log of Flight Review's list is, if its entry names no ``url``."""
LONGEST = 1 << 20
"""Largest entry of a list, characters."""
PIECE = 1 << 16
DEEPEST = 4
"""Lists that name lists."""
_ABOUT = {
    "airframe": ("airframe_name", "airframe", "sys_autostart_id"),
    "hardware": ("sys_hw",),
    "firmware": ("ver_sw_release", "ver_sw"),
    "vehicle": ("vehicle_uuid", "vehicle"),
}
"""Columns, and the keys of a list's entry that they are taken from, the best first."""
SHORT = 80
"""Characters of a column that are taken from a list."""


class Total(NamedTuple):
    """The size of what is listed."""

    logs: int
    weight: int
    """As :attr:`Source.weight`."""


class Listing:
    """Logs by name, each once; it may be gone through again and again, and holds none."""

    def __init__(self, names: Sequence[str]) -> None:
        """List the logs of such names."""
        self._names = tuple(names)

    def __iter__(self) -> Iterator[Source]:
        """Yield each log.

        Raises:
            ConfigError: A name is nothing that is there, a list is damaged, or there is no log.
            LogError: A store does not answer.
        """
        known: set[int] = set()
        for name in self._names:
            for source in _sources(name, 0):
                if source.mark not in known:
                    known.add(source.mark)
                    yield source
        if not known:
            names = ", ".join(map(_shown, self._names))
            raise ConfigError(f"{names}: no log in there ({', '.join(SUFFIXES)})")

    def total(self) -> Total:
        """Return how many logs there are, and their size; errors as of iterating."""
        logs = weight = 0
        for source in self:
            logs += 1
            weight += source.weight
        return Total(logs, weight)


def _shown(name: str) -> str:
    return remote.shown(name) if remote.is_url(name.lstrip(LIST)) else printable(name)


def _sources(name: str, depth: int) -> Iterator[Source]:
    if name.startswith(LIST) and not os.path.exists(name):
        if depth >= DEEPEST:
            raise ConfigError(f"{_shown(name)}: a list in a list, {DEEPEST} times; name the logs")
        yield from _of_list(name[len(LIST) :], depth)
    elif remote.is_url(name):
        for place, shown, properties in remote.find(name):
            yield Source(place=place, name=printable_name(shown), **properties)
    else:
        yield from map(of_path, each_log(name))


def _of_list(name: str, depth: int) -> Iterator[Source]:
    """Yield the logs that a list names."""
    with _opened(name) as file:
        head = file.read(PIECE)
        if head.lstrip("\ufeff \t\r\n").startswith("["):
            for number, entry in enumerate(_objects(file, head, _shown(name)), 1):
                yield _of_entry(entry, f"{_shown(name)}, entry {number}")
            return
        for line in _lines(file, head, _shown(name)):
            if (text := line.strip()) and not text.startswith("#"):
                yield from _sources(text, depth + 1)


@contextmanager
def _opened(name: str) -> Iterator[IO[str]]:
    """Open a list, of a file or a URL."""
    if remote.is_url(name):
        system, path = remote.file_system(name)
        with remote.sentences(remote.shown(name)):
            file = system.open(path, "r", encoding="utf-8", errors="replace")
        with file:
            yield file
        return
    try:
        with open(name, encoding="utf-8", errors="replace") as plain:
            yield plain
    except (OSError, ValueError) as error:  # ValueError: no name of a file
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"{printable(name)}: the list cannot be read: {why}") from None


def _pieces(file: IO[str], name: str) -> Iterator[str]:
    while True:
        with remote.sentences(name):
            piece = file.read(PIECE)
        if not piece:
            return
        yield piece


def _lines(file: IO[str], head: str, name: str) -> Iterator[str]:
    rest = head
    for piece in _pieces(file, name):
        *lines, rest = (rest + piece).split("\n")
        yield from lines
        if len(rest) > LONGEST:
            raise ConfigError(f"{name}: a line of more than {LONGEST} characters; it is no list")
    yield from rest.split("\n")


def _objects(file: IO[str], head: str, name: str) -> Iterator[Mapping[str, Any]]:
    """Yield the objects of a JSON array; only one is in memory at a time."""
    decoder, rest = json.JSONDecoder(), head.lstrip("\ufeff \t\r\n")[1:]
    pieces, count = _pieces(file, name), 0
    while True:
        rest = rest.lstrip(" \t\r\n,")
        if rest.startswith("]"):
            return
        try:
            entry, end = decoder.raw_decode(rest)
        except (ValueError, RecursionError):
            more = next(pieces, "")
            if not more or len(rest) > LONGEST:
                raise ConfigError(
                    f"{name}: is damaged, or cut short, after {count} entries; fetch it again"
                ) from None
            rest += more
            continue
        if not isinstance(entry, dict):
            raise ConfigError(f"{name}: entry {count + 1} is no object with a log_id or a url")
        count += 1
        rest = rest[end:]
        yield entry


def _of_entry(entry: Mapping[str, Any], where: str) -> Source:
    url, identity = entry.get("url"), entry.get("log_id")
    if not isinstance(url, str) or "\0" in url:
        if not isinstance(identity, str) or not identity.replace("-", "").isalnum():
            raise ConfigError(
                f"{where}: names no log_id of letters, digits and hyphens, and no url"
            )
        url = f"{DOWNLOAD}{identity}"
    name = f"{identity}.ulg" if isinstance(identity, str) else remote.shown(url)
    about = tuple(
        (column, found) for column, keys in _ABOUT.items() if (found := _text_of(entry, keys))
    )
    if not remote.is_url(url):
        return replace(of_path(Path(url)), about=about)
    return Source(place=url, name=printable_name(name), about=about)


def _text_of(entry: Mapping[str, Any], keys: Sequence[str]) -> str:
    """Return the first of some values that is a text or a number, without odd characters."""
    for key in keys:
        value = entry.get(key)
        if isinstance(value, (str, int)) and not isinstance(value, bool) and str(value).strip():
            text = "".join(one if one.isprintable() else " " for one in str(value)[:SHORT])
            return printable_name(text.strip())
    return ""
