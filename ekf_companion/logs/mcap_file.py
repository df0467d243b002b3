"""MCAP files from many messages at a time: compressed chunks, and their indexes.

The bytes are those of the library's own writer, which takes one message at a time and needs longer
for it than the estimator for the estimate.

Source: MCAP specification, mcap.dev.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from typing import BinaryIO

import lz4.frame
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)

from ekf_companion.nav.arrays import Stamps

MAGIC = b"\x89MCAP0\r\n"
CHUNK = 1 << 20
"""Bytes beyond which a chunk is complete."""
_FOOTER = struct.Struct("<BQQQ")
_INDEX = struct.Struct("<BQHI")


class McapFile:
    """Writes messages in chunks, and the indexes that a reader needs after them."""

    def __init__(self, file: BinaryIO, library: str) -> None:
        """Write the header; ``library`` is the program that writes."""
        self._file = file
        self._place = 0
        self._schemas: list[McapRecord] = []
        self._channels: list[McapRecord] = []
        self._chunks: list[McapRecord] = []
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._span: tuple[int, int] | None = None
        self._begin_chunk()
        self._write(MAGIC + _bytes_of(Header("", library)))

    def add_channel(self, topic: str, name: str, schema: bytes) -> int:
        """Add a channel of JSON messages of a schema; return its number."""
        number = len(self._channels) + 1
        self._schemas.append(Schema(id=number, data=schema, encoding="jsonschema", name=name))
        self._chunk += _bytes_of(self._schemas[-1])
        channel = Channel(
            id=number, topic=topic, message_encoding="json", schema_id=number, metadata={}
        )
        self._channels.append(channel)
        self._chunk += _bytes_of(channel)
        return number

    def add(self, channel: int, stamp_ns: Stamps, records: memoryview, ends: Stamps) -> None:
        """Append messages of a channel.

        Args:
            channel: Its number.
            stamp_ns: Time of logging and publishing of each, shape (n,).
            records: The messages as records of the file, concatenated.
            ends: End of each in ``records``, shape (n,).
        """
        first = begin = 0
        self._counts[channel] += len(ends)
        while first < len(ends):
            room = CHUNK - len(self._chunk)
            # The one that makes a chunk larger is its last
            last = int(np.searchsorted(ends, begin + room, side="right"))
            some = slice(first, min(last + 1, len(ends)))
            end = int(ends[some][-1])
            starts = np.append(begin, ends[some][:-1]) + (len(self._chunk) - begin)
            self._index[channel].append(np.stack([stamp_ns[some], starts], axis=1))
            self._chunk += records[begin:end]
            first, begin = some.stop, end
            if len(self._chunk) > CHUNK:
                self._finish_chunk()

    def finish(self) -> None:
        """Write the indexes and the footer."""
        self._finish_chunk()
        self._write(_bytes_of(DataEnd(0)))
        start = self._place
        earliest, latest = self._span or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=0,
            message_start_time=earliest,
            message_end_time=latest,
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, []),
            (Opcode.METADATA_INDEX, []),
        ]
        summary, offsets = b"", b""
        for opcode, group in groups:
            data = _bytes_of(*group)
            offsets += _bytes_of(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        at = start + len(summary)
        summary += offsets
        footer = _FOOTER.pack(Opcode.FOOTER, 20, start, at)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        self._write(summary + _bytes_of(Footer(start, at, crc)) + MAGIC)

    def _begin_chunk(self) -> None:
        self._chunk = bytearray()
        self._index: defaultdict[int, list[Stamps]] = defaultdict(list)
        """Stamp and place of each message, by its channel."""

    def _finish_chunk(self) -> None:
        """Write the chunk and its index."""
        if not self._index:
            return
        indexes = {channel: np.concatenate(parts) for channel, parts in self._index.items()}
        earliest = min(int(index[:, 0].min()) for index in indexes.values())
        latest = max(int(index[:, 0].max()) for index in indexes.values())
        before = self._span or (earliest, latest)
        self._span = min(before[0], earliest), max(before[1], latest)
        data = lz4.frame.compress(self._chunk)
        chunk = Chunk(
            compression="lz4",
            data=data,
            message_start_time=earliest,
            message_end_time=latest,
            uncompressed_crc=zlib.crc32(self._chunk),
            uncompressed_size=len(self._chunk),
        )
        start = self._place
        self._write(_bytes_of(chunk))
        behind = self._place
        offsets = {}
        for channel, index in indexes.items():
            offsets[channel] = self._place
            size = 16 * len(index)
            self._write(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            self._write(index.astype("<i8").tobytes())
        self._chunks.append(
            ChunkIndex(
                message_start_time=earliest,
                message_end_time=latest,
                chunk_start_offset=start,
                chunk_length=behind - start,
                message_index_offsets=offsets,
                message_index_length=self._place - behind,
                compression=chunk.compression,
                compressed_size=len(data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._begin_chunk()

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._place += len(data)


def _bytes_of(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
