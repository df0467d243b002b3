"""Damage to the bytes of a file: bits, lengths, blocks, heads, and traps for readers of text."""

from __future__ import annotations

import re

import numpy as np

LARGEST = 4_000_000
"""Bytes of a damaged file: enough to see how the time grows."""


def damaged(whole: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with one to three kinds of damage; ``other`` is of another format."""
    data = whole
    for _ in range(int(rng.integers(1, 4))):
        data = DAMAGES[int(rng.integers(len(DAMAGES)))](data or b"\0", other, rng)
    return data[:LARGEST]


def _place(data: bytes, rng: np.random.Generator) -> int:
    """Return a place in the data: in half of all cases near the beginning, where formats are."""
    if rng.random() < 0.5:
        return int(rng.integers(len(data)))
    return int(len(data) ** rng.random()) - 1


def _span(data: bytes, rng: np.random.Generator, longest: int = 1 << 16) -> tuple[int, int]:
    """Return where a piece of the data begins and ends; small ones are as likely as large ones."""
    start = _place(data, rng)
    return start, min(start + int(longest ** rng.random()), len(data))


def flip(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with bits flipped."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 40))):
        place = _place(data, rng)
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def cut(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return the beginning of a file."""
    return data[: int(rng.integers(len(data)))]


def lose(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file that lacks a piece."""
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def repeat(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file in which a piece comes again and again."""
    start, end = _span(data, rng)
    times = int((LARGEST / (end - start)) ** rng.random())
    return data[:start] + data[start:end] * times + data[end:]


def swap(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file in which two pieces have changed places."""
    one, two = sorted((_span(data, rng), _span(data, rng)))
    first, last = data[one[0] : one[1]], data[max(two[0], one[1]) : two[1]]
    between, end = data[one[1] : max(two[0], one[1])], max(one[1], two[1])
    return data[: one[0]] + last + between + first + data[end:]


def enlarge(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Put the largest numbers where lengths and counts may stand."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 20))):
        place = _place(data, rng)
        number = NUMBERS[int(rng.integers(len(NUMBERS)))]
        changed[place : place + len(number)] = number
    return bytes(changed)


def zero(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with a run of one byte in it."""
    start, end = _span(data, rng)
    byte = bytes([int(rng.choice([0, 0, 0, 255, 32]))])
    return data[:start] + byte * (end - start) + data[end:]


def insert(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with noise put in."""
    start, end = _span(data, rng)
    return data[:start] + rng.bytes(end - start) + data[start:]


def cross(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return the head of one format and the body of another."""
    start, _ = _span(data, rng, 1 << 10)
    place, _ = _span(other, rng)
    return data[:start] + other[place:]


def nest(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Insert text that a reader must not take literally."""
    start, _ = _span(data, rng)
    words = WORDS[int(rng.integers(len(WORDS)))]
    return data[:start] + words * int(200_000 ** rng.random()) + data[start:]


def retype(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a log in which columns are declared to be of other types."""
    changed = bytearray(data)
    places = [one.start() + 9 for one in re.finditer(b"\xa3\x95\x80", data[:-40])]
    for place in rng.choice(places, 4) if places else ():
        changed[place + int(rng.integers(10))] = int(rng.choice([*b"abBhHiIfdnNZcCeELMqQ"]))
    if not places and (found := [*TYPES.finditer(data)]):
        for number in rng.integers(len(found), size=4):
            one = found[number]
            same = [word for word in ULOG_TYPES if len(word) == len(one[0])]
            changed[one.start() : one.end()] = same[int(rng.integers(len(same)))]
    return bytes(changed)


ULOG_TYPES = (
    *(b"bool", b"char", b"float", b"double", b"int8_t", b"uint8_t", b"int16_t", b"uint16_t"),
    *(b"int32_t", b"uint32_t", b"int64_t", b"uint64_t"),
)
TYPES = re.compile(rb"(?<![a-z])(" + b"|".join(ULOG_TYPES) + rb")(?= |\[)")
NUMBERS = (
    *(b"\xff" * size for size in (1, 2, 4, 8)),
    *(b"\xff" * (size - 1) + b"\x7f" for size in (2, 4, 8)),
    *(b"9" * 30, b"1e308", b"-1e-400", b"nan", b"inf"),
)
WORDS = tuple(
    word.encode()
    for word in ("[", "{", '"', ",", "\n", "\r", "- ", "? ", "&a [*a]", "0.", "é", "\0")
)
DAMAGES = (flip, cut, lose, repeat, swap, enlarge, zero, insert, cross, nest, retype)
