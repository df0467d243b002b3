"""Reading of a recorded file's bytes, packed by gzip or Zstandard or not."""

from __future__ import annotations

import gzip
import mmap
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ekf_companion.errors import LogError, part_of

PACKED = (".gz", ".zst")
LARGEST = 1 << 33
"""Bytes that a packed file may hold."""
LARGE = 1 << 26
"""Bytes from which on a file is mapped."""


def suffix_of(path: Path) -> str:
    """Return the suffix that tells the format, in lower case: ``.csv`` of ``flight.CSV.gz``."""
    return unpacked_name(path).suffix.lower()


def unpacked_name(path: Path) -> Path:
    """Return the name of the file within a packed one."""
    return path.with_suffix("") if path.suffix.lower() in PACKED else path


def read_bytes(path: Path, kind: str) -> bytes:
    """Return all bytes of a file, unpacked; its kind (``DataFlash .bin log``) is for messages.

    Raises:
        LogError: The file is missing, empty, a folder or not readable.
    """
    with _opened(path, kind) as file:
        data = _unpack(path, file) if path.suffix.lower() in PACKED else file.read()
    if not data:
        raise LogError(f"{path}: an empty file, not a {kind}; record or download it again")
    return data


class MappedFile:
    """All bytes of a file: a large one is mapped, and is in memory as far as it is being read.

    Who cuts a mapped file short while it is read ends the process, as with any mapped file.
    """

    def __init__(self, path: Path, kind: str) -> None:
        """Open a file; its kind is for messages.

        Raises:
            LogError: As :func:`read_bytes`.
        """
        self._map: mmap.mmap | None = None
        is_plain = path.is_file() and path.suffix.lower() not in PACKED
        if is_plain and path.stat().st_size >= LARGE:
            with _opened(path, kind) as file:
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self.data = memoryview(read_bytes(path, kind) if self._map is None else self._map)
        """The bytes."""

    def release(self) -> None:
        """Keep nothing of a mapped file in memory until it is read again."""
        if self._map is not None:
            self._map.madvise(mmap.MADV_DONTNEED)


class Source:
    """The bytes of a file, read piece by piece; a packed one, or a pipe, is held in memory."""

    def __init__(self, path: Path, kind: str) -> None:
        """Look at a file; its kind is for messages.

        Raises:
            LogError: As :func:`read_bytes`.
        """
        self._path, self._kind = path, kind
        self._data: bytes | None = None
        if path.suffix.lower() in PACKED or (path.exists() and not path.is_file()):
            self._data = read_bytes(path, kind)
        with _opened(path, kind) as file:
            self._size = file.seek(0, os.SEEK_END) if self._data is None else len(self._data)
        if not self._size:
            raise LogError(f"{path}: an empty file, not a {kind}; record or download it again")

    def __len__(self) -> int:
        return self._size

    def read(self, start: int, end: int) -> bytes:
        """Return the bytes from ``start`` to before ``end``, or to the end that was there at first.

        Raises:
            LogError: The file was cut short since, or cannot be read any more.
        """
        end = min(end, self._size)
        if self._data is not None:
            return self._data[start:end]
        with _opened(self._path, self._kind) as file:
            file.seek(start)
            data = file.read(end - start)
        if len(data) < end - start:
            raise LogError(f"{self._path}: was cut short while it was read; read it again")
        return data


@contextmanager
def _opened(path: Path, kind: str) -> Iterator[BinaryIO]:
    """Open a file, and turn an error of the file system into one that names the remedy."""
    try:
        with path.open("rb") as file:
            yield file
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; check the path of the {kind}") from None
    except IsADirectoryError:
        raise LogError(f"{path}: a folder; name the {kind} inside it") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); check its rights") from None


def _unpack(path: Path, file: BinaryIO) -> bytes:
    try:
        data = _gunzip(file) if path.suffix.lower() == ".gz" else _unzstd(path, file)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise LogError(f"{path}: cannot be unpacked ({error}); fetch it anew") from None
    if len(data) > LARGEST:
        raise LogError(f"{path}: holds more than {LARGEST >> 30} GiB; unpack it first")
    return data


def _gunzip(file: BinaryIO) -> bytes:
    with gzip.GzipFile(fileobj=file) as unpacked:
        return unpacked.read(LARGEST + 1)


def _unzstd(path: Path, file: BinaryIO) -> bytes:
    with part_of("formats", f"{path}: unpack it (unzstd), or"):
        import zstandard
    unpacked, frame = bytearray(), zstandard.ZstdDecompressor().decompressobj()
    try:
        while (block := file.read(1 << 20)) and len(unpacked) <= LARGEST:
            unpacked += frame.decompress(block)
            while frame.unused_data:
                rest, frame = frame.unused_data, zstandard.ZstdDecompressor().decompressobj()
                unpacked += frame.decompress(rest)
    except zstandard.ZstdError as error:
        raise EOFError(error) from None
    if not frame.eof and len(unpacked) <= LARGEST:
        raise EOFError("it is cut short")
    return bytes(unpacked)
