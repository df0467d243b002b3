"""Reading of a recorded file's bytes, packed by gzip or Zstandard or not."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import BinaryIO

from ekf_companion.errors import LogError

PACKED = (".gz", ".zst")
LARGEST = 1 << 33
"""Bytes that a packed file may hold."""


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
    try:
        with path.open("rb") as file:
            data = _unpack(path, file) if path.suffix.lower() in PACKED else file.read()
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; check the path of the {kind}") from None
    except IsADirectoryError:
        raise LogError(f"{path}: a folder; name the {kind} inside it") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); check its rights") from None
    if not data:
        raise LogError(f"{path}: an empty file, not a {kind}; record or download it again")
    return data


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
    try:
        import zstandard
    except ImportError:
        raise LogError(
            f"{path}: unpacking needs zstandard; install ekf-companion with the extra: formats, "
            "or unpack it (unzstd)"
        ) from None
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
