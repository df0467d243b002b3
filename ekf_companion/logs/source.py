"""Reading of a recorded file's bytes, unpacked from gzip or Zstandard where necessary."""

from __future__ import annotations

import io
import mmap
import os
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ekf_companion.errors import LogError, part_of

PACKED = (".gz", ".zst")
LARGEST = 1 << 33
"""Largest content of a packed file or a pipe, bytes."""
EXPANSION = 200
"""Largest size of the content by that of the packed file: rows of a vehicle at rest pack to a
fiftieth, a file made to fill the memory to a thousandth or less."""
LARGE = 1 << 26
"""Size, bytes, from which a file is mapped, and unpacked content is kept in a temporary file; a
small packed file may hold as much in any case."""
BLOCK = 1 << 20
"""Bytes that are read or unpacked at a time."""
PIECE = 1 << 12
"""Bytes of a gzip file that are unpacked at a time: as much is lost where it is damaged."""
HEADER = 18
"""Largest size of the header of a Zstandard file."""
MAGIC = {".gz": b"\x1f\x8b", ".zst": b"\x28\xb5\x2f\xfd"}
"""How packed files begin (RFC 1952, RFC 8878); Zstandard's may begin with a skippable frame."""
SKIPPABLE = b"\x2a\x4d\x18"
"""What follows the first byte of one."""
WINDOW = 1 << 27
"""Largest memory that a Zstandard file may ask for, the limit of its own program."""


def suffix_of(path: Path) -> str:
    """Return the suffix that names the format, in lower case: ``.csv`` of ``flight.CSV.gz``."""
    return unpacked_name(path).suffix.lower()


def unpacked_name(path: Path) -> Path:
    """Return the name of the file within a packed one."""
    return path.with_suffix("") if path.suffix.lower() in PACKED else path


def real_path(path: Path) -> Path:
    """Return the target of a name; of a circle of links, which has none, the name itself."""
    return Path(os.path.realpath(path))


def read_bytes(path: Path, kind: str) -> bytes:
    """Return all bytes of a file, unpacked; its kind (``DataFlash .bin log``) is for messages.

    Raises:
        LogError: As :class:`MappedFile`.
    """
    return bytes(MappedFile(path, kind).data)


def head_of(path: Path, size: int) -> bytes:
    """Return the first bytes of a file, unpacked; fewer if they cannot be read."""
    try:
        with path.open("rb") as file:
            packed = path.suffix.lower() in PACKED
            blocks = _unpack(path, file, []) if packed else _blocks(file, size)
            return next(blocks, b"")[:size]
    except (OSError, LogError):
        return b""  # its reader says why


def header_of(path: Path) -> list[str]:
    """Return the names in the first line of a table, packed or not; none if it cannot be read."""
    line = head_of(path, 1 << 16).partition(b"\n")[0].decode(errors="replace")
    return [name.strip() for name in line.split(",")] if line else []


class MappedFile:
    """All bytes of a file; a large one is mapped, and only in memory where it is being read.

    Truncating a mapped file while it is read ends the process, as with any mapped file.
    """

    def __init__(self, path: Path, kind: str) -> None:
        """Open a file; its kind is for messages.

        Raises:
            LogError: The file is missing, empty, a folder or a device, not readable, or packed and
                not to be unpacked.
        """
        self.notes: list[str] = []
        """What is to be said of the file, whatever is in it."""
        content: bytes | mmap.mmap
        with _opened(path, kind) as file:
            if path.suffix.lower() in PACKED:
                content = _gather(path, _unpack(path, file, self.notes), _most(path, file))
            elif not path.is_file():
                content = _gather(path, _blocks(file), LARGEST)
            elif os.fstat(file.fileno()).st_size >= LARGE:
                content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            else:
                content = file.read()
        if not content:
            raise LogError(f"{path}: an empty file, not a {kind}; record or download it again")
        self._map = content if isinstance(content, mmap.mmap) else None
        self.data = memoryview(content)
        """The bytes."""

    def release(self) -> None:
        """Release the memory of a mapped file until it is read again."""
        if self._map is not None:
            self._map.madvise(mmap.MADV_DONTNEED)


class Source:
    """The bytes of a file, read piece by piece; those of a packed file or a pipe are kept."""

    def __init__(self, path: Path, kind: str) -> None:
        """Open a file; its kind is for messages.

        Raises:
            LogError: As :class:`MappedFile`.
        """
        self._path, self._kind = path, kind
        self.notes: list[str] = []
        """What is to be said of the file, whatever is in it."""
        self._data: memoryview | None = None
        if path.suffix.lower() in PACKED or (path.exists() and not path.is_file()):
            file = MappedFile(path, kind)
            self._data, self.notes = file.data, file.notes
        with _opened(path, kind) as plain:
            self._size = plain.seek(0, os.SEEK_END) if self._data is None else len(self._data)
        if not self._size:
            raise LogError(f"{path}: an empty file, not a {kind}; record or download it again")

    def __len__(self) -> int:
        return self._size

    def read(self, start: int, end: int) -> bytes:
        """Return the bytes from ``start`` to before ``end``, or to the end at the time of opening.

        Raises:
            LogError: The file was cut short since, or cannot be read any more.
        """
        end = min(end, self._size)
        if self._data is not None:
            return bytes(self._data[start:end])
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
            if stat.S_ISCHR(os.fstat(file.fileno()).st_mode):
                raise LogError(f"{path}: a device, which has no end; name a {kind}")
            yield file
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; check the path of the {kind}") from None
    except IsADirectoryError:
        raise LogError(f"{path}: a folder; name the {kind} inside it") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); check its rights") from None


def _most(path: Path, file: BinaryIO) -> int:
    """Return the largest content of a packed file, bytes."""
    packed = os.fstat(file.fileno()).st_size if path.is_file() else LARGEST
    return min(max(EXPANSION * packed, LARGE), LARGEST)


def _gather(path: Path, blocks: Iterator[bytes], most: int) -> bytes | mmap.mmap:
    """Return the bytes of all blocks; large content lies in a temporary file that they own."""
    size = 0
    with tempfile.SpooledTemporaryFile(max_size=LARGE) as spool:
        try:
            for block in blocks:
                size += len(block)
                if size > most:
                    raise LogError(
                        f"{path}: holds more than {most >> 20} MiB, more than a log of its size "
                        "packs to; unpack it first"
                    )
                spool.write(block)
            spool.seek(0)
            if size < LARGE:
                return spool.read()
            spool.flush()
            return mmap.mmap(spool.fileno(), size, access=mmap.ACCESS_READ)
        except OSError as error:
            raise LogError(
                f"{path}: no room to unpack it in {tempfile.gettempdir()} ({error.strerror}); make "
                "some there, or set TMPDIR to a folder that has it"
            ) from None


def _blocks(file: BinaryIO, size: int = BLOCK) -> Iterator[bytes]:
    """Yield a file's bytes, so many at a time."""
    while block := file.read(size):
        yield block


def _unpack(path: Path, file: BinaryIO, notes: list[str]) -> Iterator[bytes]:
    """Yield the content of a packed file; if it is damaged, that before the damage, with a note."""
    size = 0
    head = file.peek(4)[:4] if isinstance(file, io.BufferedReader) else b""
    if head and not head.startswith(MAGIC[path.suffix.lower()]) and head[1:] != SKIPPABLE:
        raise LogError(
            f"{path}: is not packed, or by another program than its name says; name it by what it "
            "holds, or unpack it first"
        )
    try:
        for block in _gunzip(file) if path.suffix.lower() == ".gz" else _unzstd(path, file):
            size += len(block)
            yield block
    except EOFError as error:
        if not size:
            raise LogError(f"{path}: cannot be unpacked, it {error}; fetch it anew") from None
        notes.append(f"the packed file {error}: what comes before that was read")


def _gunzip(file: BinaryIO) -> Iterator[bytes]:
    """Yield the content of the members; EOFError: they are damaged."""
    member = zlib.decompressobj(wbits=31)
    for block in _blocks(file, PIECE):
        rest = block
        while rest:
            if member.eof:
                if not (rest := rest.lstrip(b"\0")):  # a tape fills its last block
                    break
                member = zlib.decompressobj(wbits=31)
            try:
                yield member.decompress(rest, BLOCK)
            except zlib.error:
                raise EOFError("is damaged") from None
            rest = member.unused_data if member.eof else member.unconsumed_tail
    if not member.eof:
        raise EOFError("is cut short")


def _unzstd(path: Path, file: BinaryIO) -> Iterator[bytes]:
    """Yield the content of the frames; EOFError: they are damaged."""
    with part_of("formats", f"{path}: unpack it (unzstd), or"):
        import zstandard
    unpacker = zstandard.ZstdDecompressor(max_window_size=WINDOW)
    size = stated = 0
    try:
        if file.seekable():
            stated = zstandard.get_frame_parameters(file.read(HEADER)).content_size
            file.seek(0)
        reader = unpacker.stream_reader(file, read_across_frames=True, closefd=False)
        while block := reader.read(BLOCK >> 4):  # what is damaged takes as much with it
            size += len(block)
            yield block
    except zstandard.ZstdError:
        raise EOFError("is damaged") from None
    if size < stated != zstandard.CONTENTSIZE_UNKNOWN:
        raise EOFError("is cut short")
