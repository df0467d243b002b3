"""One direction of a link."""

import pytest

from sim_autopilot.line import Line, Way

SECOND_NS = 1_000_000_000


def late(way, count=300, period=0.02, size=100):
    """Return how late each of some datagrams arrives, s; lost ones are left out."""
    line, found = Line(way, 1), []
    for k in range(count):
        line.push(round(k * period * SECOND_NS), k.to_bytes(2, "little") * (size // 2))
    while (item := line.pop(1 << 62)) is not None:
        found.append(item[0] / SECOND_NS - int.from_bytes(item[1][:2], "little") * period)
    return found


def test_a_constant_delay():
    assert late(Way(delay=0.2)) == pytest.approx([0.2] * 300)


def test_jitter_keeps_the_order():
    line = Line(Way(jitter=0.05), 1)
    for k in range(100):
        line.push(k * SECOND_NS // 50, bytes([k]))
    out = [line.pop(1 << 62) for _ in range(100)]
    assert [data[0] for _, data in out] == list(range(100))
    times = [at_ns for at_ns, _ in out]
    assert times == sorted(times)
    assert 0.03 < max(late(Way(jitter=0.05))) <= 0.1


def test_a_narrow_line_is_ever_later():
    behind = late(Way(rate=2500.0))
    assert behind[0] == pytest.approx(0.04)
    assert behind[-1] == pytest.approx(0.04 + 299 * 0.02)
    assert max(late(Way(rate=6000.0))) < 0.02


def test_a_stall_lets_all_pass_at_once_when_it_ends():
    behind = late(Way(stall_every=2.0, stall=0.5))
    assert max(behind) == pytest.approx(0.5)
    assert sum(one > 0.0 for one in behind) == 3 * 25


def test_a_share_is_lost():
    assert 240 < len(late(Way(loss=0.1))) < 290
    assert late(Way(loss=0.1)) == late(Way(loss=0.1))
