"""The bytes of our MCAP file against those of the library's writer."""

import io

import numpy as np
import orjson
import pytest
from mcap.writer import CompressionType, Writer

from ekf_companion.logs import mcap_file
from ekf_companion.logs.json_objects import HEAD, write_messages
from ekf_companion.logs.mcap_file import McapFile

TOPICS = ("/fast", "/slow")
NAMES = [b'{"x":', b',"y":']


def by_library(blocks):
    file = io.BytesIO()
    writer = Writer(file, chunk_size=mcap_file.CHUNK, compression=CompressionType.LZ4)
    writer.start(library="test")
    for topic in TOPICS:
        number = writer.register_schema(f"of {topic}", "jsonschema", b"{}")
        assert writer.register_channel(topic, "json", number) == number
    for channel, stamps, numbers in blocks:
        for t_ns, (x, y) in zip(stamps.tolist(), numbers.tolist(), strict=True):
            said = {"x": x, "y": y, "n": t_ns % 7}
            said = {name: value for name, value in said.items() if not np.isnan(value)}
            writer.add_message(channel, t_ns, orjson.dumps(said), t_ns)
    writer.finish()
    return file.getvalue()


def by_us(blocks):
    file = io.BytesIO()
    writer = McapFile(file, "test")
    for topic in TOPICS:
        writer.add_channel(topic, f"of {topic}", b"{}")
    for channel, stamps, numbers in blocks:
        ends = [b',"n":%d}' % (t_ns % 7) for t_ns in stamps.tolist()]
        text = orjson.dumps(numbers, option=orjson.OPT_SERIALIZE_NUMPY)
        out = bytearray(len(text) + len(ends) * (HEAD + sum(map(len, NAMES)) + 8))
        behind = np.empty(len(ends), dtype=np.int64)
        write_messages(text, NAMES, ends, channel, stamps, out, behind, True)
        writer.add(channel, stamps, memoryview(out), behind)
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize("sizes", [[], [(1, 1)], [(1, 400), (2, 30), (1, 0), (1, 700), (2, 900)]])
@pytest.mark.parametrize("chunk", [1, 4096, 1 << 20])
def test_the_bytes_are_those_of_the_library(sizes, chunk, monkeypatch):
    monkeypatch.setattr(mcap_file, "CHUNK", chunk)
    rng = np.random.default_rng(4)
    blocks = []
    for channel, count in sizes:
        numbers = rng.standard_normal((count, 2))
        numbers[::5, 0] = numbers[::3, 1] = np.nan
        blocks.append((channel, rng.integers(0, 1 << 62, count), numbers))
    assert by_us(blocks) == by_library(blocks)
