"""The messages of a ULog (.ulg), as one table per topic and instance: stored while they are found.

Damage costs the messages that it touched, and what lies before the next synchronisation message.
A topic's rows are those of exactly the size that its format declares, with or without the padding
at its end.

Source: PX4 user guide, "ULog file format".
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from ekf_companion.errors import LogError
from ekf_companion.logs import ulog_search
from ekf_companion.logs.onboard import MOST, Message, Onboard, clean, level_of, onboard
from ekf_companion.logs.source import MappedFile
from ekf_companion.logs.stored_rows import StoredRows

Fields = list[tuple[str, str]]
"""Name and numpy type of each field, in the order in which they lie in a row."""
Formats = dict[str, list[tuple[str, int, str]]]
"""Type, array size (0: no array) and name of each field, by the name of the format."""

KIND = "ULog (.ulg) of PX4"
MAGIC = b"ULog\x01\x12\x35"
HEADER = 16
"""Bytes before the first message."""
LARGEST_ROW = 65_535
"""Largest size that a message's header can state, bytes."""
AT_ONCE = 1 << 16
"""Messages that are searched at a time."""
MOST_DEFINITIONS = 1 << 16
"""Most formats, parameters and subscriptions; more are damage."""
LATEST_US = 1 << 52
"""A later stamp, 140 years after the start, is damaged."""
DEEPEST = 16
"""Most levels of formats within formats."""
_TYPES = {
    f"{sign}int{8 * size}_t": f"<{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)
}
_TYPES |= {"float": "<f4", "double": "<f8", "bool": "i1", "char": "i1"}
"""Numpy's codes of the basic types."""
INFORMATION = ("sys_name", "ver_hw", "ver_sw", "ver_sw_release")
"""Keys that are kept of the autopilot's information: ver_sw is the hash of the firmware's
source."""
_ids = Struct("<BH").unpack_from
_text = Struct("<HxBQ").unpack_from
_offsets = Struct("<8x8B3Q").unpack_from
_VALUES = {"int32_t": Struct("<i"), "float": Struct("<f")}
"""Types of a parameter."""


@dataclass(slots=True, eq=False)
class Table:
    """The rows of one instance of a topic."""

    topic: str
    instance: int
    rows: StoredRows


@dataclass(slots=True, eq=False)
class Messages:
    """Content of a log."""

    tables: list[Table] = field(default_factory=list)
    """In the order of their subscriptions, without empty ones."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Values at the start of the log."""
    information: dict[str, bytes] = field(default_factory=dict)
    """Values by name: of the firmware, as ``INFORMATION`` names them."""
    texts: list[Message] = field(default_factory=list)
    """The first lines that were logged."""
    more_texts: int = 0
    """Number of further lines."""
    dropouts: tuple[float, ...] = ()
    """Lengths of the gaps in the writing of the log, s."""
    is_damaged: bool = False
    subscriptions: int = 0
    """To any topic."""
    rest: int = 0
    """Bytes at the end that are an incomplete message."""
    notes: tuple[str, ...] = ()
    """Notes on the file itself."""

    def onboard(self) -> Onboard:
        """Return firmware, parameters and messages of the autopilot."""
        known = self.information
        words = [clean(known.get(name, b"")) for name in ("sys_name", "ver_hw")]
        if len(release := known.get("ver_sw_release", b"")) == 4:
            # A byte each of major, minor, patch, and 255 for a release, less before it
            last, patch, minor, major = release
            words.insert(1, f"{major}.{minor}.{patch}{'' if last == 255 else ' (not a release)'}")
        words.append(clean(known.get("ver_sw", b""))[:10])
        return onboard(self.texts, self.parameters, " ".join(filter(None, words)), self.more_texts)


class _Layout(NamedTuple):
    """Layout of a topic's rows in its messages."""

    dtype: np.dtype[np.void]
    """Without the padding at the end."""
    most: int
    """Size with the padding, bytes."""
    kept: np.dtype[np.void]
    """The fields that are kept of it."""


class _Subscription(NamedTuple):
    """Topic of the messages of an id, from some position in the file on."""

    topic: str
    instance: int
    layout: _Layout


def read(path: Path, topics: Collection[str], unused: Collection[str] = ()) -> Messages:
    """Read the topics of some names, without the fields that are unused.

    Raises:
        LogError: The file is missing, empty, or no ULog; or of a version with features that
            change what its bytes mean; or there is no room for a temporary file.
    """
    file = MappedFile(path, KIND)
    if file.data[: len(MAGIC)] != MAGIC:
        raise LogError(f"{path}: does not begin as a {KIND}; check the file or its name")
    return _Reader(path, file, topics, unused).read()


class _Reader:
    def __init__(
        self, path: Path, file: MappedFile, topics: Collection[str], unused: Collection[str]
    ) -> None:
        self._path, self._file, self._topics, self._unused = path, file, topics, unused
        self._data = file.data
        self._formats: Formats = {}
        self._layouts: dict[str, _Layout | None] = {}
        self._found = Messages(notes=tuple(file.notes))
        self._definitions = 0
        self._ends: list[int] = []  # of the parts of the data: more was appended later
        self._state = array("q", [0, 0])
        self._subscriptions: list[_Subscription] = []
        self._sizes = np.zeros((1 << 16, 2), dtype=np.int32)
        self._owner = np.zeros(1 << 16, dtype=np.int64)  # subscription by message id
        self._raw = np.frombuffer(self._data, dtype=np.uint8)
        self._rows: list[StoredRows] = []  # by subscription
        self._dropouts: list[int] = []  # ms

    def read(self) -> Messages:
        """Read all."""
        place = self._read_definitions()
        for end in [*self._ends, len(self._data)]:
            self._found.rest = max(end - self._read_data(place, end), 0)
            place = max(place, end)
        self._found.tables = [
            Table(one.topic, one.instance, rows)
            for one, rows in zip(self._subscriptions, self._rows, strict=True)
            if len(rows)
        ]
        self._found.dropouts = tuple(ms * 1e-3 for ms in self._dropouts)
        self._found.is_damaged |= bool(self._state[1])
        return self._found

    def _read_definitions(self) -> int:
        """Read the formats and parameters; return where the data begin."""
        place = HEADER
        while True:
            kind, place = ulog_search.find_definition(self._data, place, self._state)
            if kind not in b"FPBI" or kind == 0:
                return place
            content, place = self._message(place)
            take = {
                **{70: self._take_format, 80: self._take_parameter, 66: self._take_flags},
                73: self._take_information,
            }[kind]
            try:
                take(content)
            except (LookupError, ValueError):
                self._found.is_damaged = True

    def _message(self, place: int) -> tuple[bytes, int]:
        """Return the content of a message that defines something, and where it ends.

        Raises:
            LogError: There are too many of them.
        """
        self._definitions += 1
        if self._definitions > MOST_DEFINITIONS:
            raise LogError(
                f"{self._path}: more than {MOST_DEFINITIONS} formats, parameters and "
                f"subscriptions: too damaged to be read as a {KIND}"
            )
        end = place + 3 + int.from_bytes(self._data[place : place + 2], "little")
        return bytes(self._data[place + 3 : end]), end

    def _take_format(self, content: bytes) -> None:
        """Store ``NAME:TYPE FIELD;TYPE[SIZE] FIELD;``."""
        name, colon, text = content.decode("utf-8", "ignore").partition(":")
        fields = []
        for part in text.split(";"):
            if part:
                kind, space, label = part.partition(" ")
                kind, bracket, size = kind.partition("[")
                if not space:
                    raise ValueError(part)
                fields.append((kind, int(size.rstrip("]")) if bracket else 0, label.split(" ")[0]))
        if not colon:
            raise ValueError(name)
        self._formats[name] = fields

    def _take_parameter(self, content: bytes) -> None:
        """Store the value of ``TYPE NAME``."""
        after = 1 + content[0]
        kind, _, name = content[1:after].decode("utf-8", "ignore").partition(" ")
        if len(content) == after + 4:
            self._found.parameters[name] = _VALUES[kind].unpack(content[after:])[0]
        else:
            self._found.is_damaged = True

    def _take_information(self, content: bytes) -> None:
        """Store the value of ``TYPE NAME``, as bytes, if it is used."""
        after = 1 + (content[0] if content else 0)
        name = content[1:after].partition(b" ")[2].decode("utf-8", "ignore")
        if name in INFORMATION:
            self._found.information[name] = content[after:]

    def _take_text(self, place: int) -> None:
        """Store a line: its level is a digit, as that of syslog."""
        size, level, stamp_us = _text(self._data, place)
        text = clean(bytes(self._data[place + 12 : place + 3 + size]))
        t_ns = stamp_us * 1000 if stamp_us < LATEST_US else None
        self._found.texts.append(Message(t_ns, level_of(level - ord("0")), text))

    def _take_flags(self, content: bytes) -> None:
        """Check the flags that change how the file is read.

        Raises:
            LogError: A flag that is not known.
        """
        if len(content) < 40:
            raise ValueError(content)
        *flags, first, second, third = _offsets(content)
        if flags[0] & ~1 or any(flags[1:]):
            raise LogError(
                f"{self._path}: a {KIND} with a feature that is not known here (incompatible "
                f"flags {bytes(flags).hex()}), so its messages cannot be read"
            )
        if flags[0]:
            known = [place for place in (first, second, third) if 0 < place < len(self._data)]
            self._ends = sorted(known)

    def _read_data(self, place: int, end: int) -> int:
        """Find the rows and dropouts of a part; return the end of its complete messages."""
        found = np.empty((AT_ONCE, 2), dtype=np.int64)
        kind = -1
        while kind:
            n, kind, place = ulog_search.find_data(
                self._data, place, end, self._sizes, self._state, found
            )
            if n:
                self._take_rows(found[:n])
                self._file.release()
            if kind == ord("A"):
                content, place = self._message(place)
                try:
                    self._subscribe(content)
                except (LookupError, ValueError):
                    self._found.is_damaged = True
        return place

    def _take_rows(self, found: npt.NDArray[np.int64]) -> None:
        """Store rows under the topics that their ids stand for, and dropouts' lengths."""
        is_row = found[:, 1] >= 0
        places, owner = found[is_row, 0], self._owner[found[is_row, 1]]
        for number in np.unique(owner).tolist():
            layout = self._subscriptions[number].layout
            windows = sliding_window_view(self._raw, layout.dtype.itemsize)
            whole = windows[places[owner == number]].view(layout.dtype)[:, 0]
            rows = np.empty(len(whole), dtype=layout.kept)
            for name in layout.kept.names or ():
                rows[name] = whole[name]
            self._rows[number].append(rows)
        is_text = found[:, 1] == -2
        room = max(MOST - len(self._found.texts), 0)
        texts = found[is_text, 0]
        self._found.more_texts += max(len(texts) - room, 0)
        for place in texts[:room].tolist():
            self._take_text(place)
        for place in found[~is_row & ~is_text, 0].tolist():
            self._dropouts.append(int.from_bytes(self._data[place : place + 2], "little"))

    def _subscribe(self, content: bytes) -> None:
        """Note that messages of an id belong to a topic from now on."""
        if len(content) < 3:
            raise ValueError(content)
        self._found.subscriptions += 1
        instance, number = _ids(content)
        topic = content[3:].decode("utf-8", "ignore")
        if topic not in self._topics:
            self._sizes[number] = -1 if topic in self._formats else 0
            return
        if topic not in self._layouts:
            self._layouts[topic] = _layout(self._formats, topic, self._unused)
        layout = self._layouts[topic]
        if layout is None:
            raise ValueError(topic)
        self._sizes[number] = layout.dtype.itemsize, layout.most
        self._owner[number] = len(self._subscriptions)
        self._subscriptions.append(_Subscription(topic, instance, layout))
        self._rows.append(StoredRows(layout.kept))


def _layout(formats: Formats, topic: str, unused: Collection[str]) -> _Layout | None:
    """Return the layout of a topic's rows; None if its format is damaged."""
    fields: Fields = []
    size = 0
    try:
        for label, code in _flatten(formats, topic, "", DEEPEST):
            fields.append((label, code))
            size += int(code[-1])
            if size > LARGEST_ROW:
                return None
        while fields and fields[-1][0].startswith("_padding"):
            fields.pop()
        dtype = np.dtype(fields)
        kept = np.dtype([(label, code) for label, code in fields if label not in unused])
    except (LookupError, ValueError):
        return None
    return _Layout(dtype, size, kept) if fields else None


def _flatten(formats: Formats, name: str, before: str, depth: int) -> Iterator[tuple[str, str]]:
    """Yield name and type of each field of a format, and of the formats within it.

    Raises:
        KeyError: A format is missing.
        ValueError: A format has no fields, or formats are nested too deeply.
    """
    if not formats[name] or not depth:
        raise ValueError(name)
    for kind, count, label in formats[name]:
        for suffix in [f"[{index}]" for index in range(min(count, LARGEST_ROW))] or [""]:
            if kind in _TYPES:
                yield before + label + suffix, _TYPES[kind]
            else:
                yield from _flatten(formats, kind, f"{before}{label}{suffix}.", depth - 1)
