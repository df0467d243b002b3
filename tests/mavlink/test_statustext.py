"""Words for the pilot."""

from itertools import pairwise

import hypothesis.strategies as st
from hypothesis import given

from ekf_companion.mavlink.statustext import LARGEST, Severity, chunks
from tests.mavlink.conversation import MS, SECOND, met, sent


def hear(session, autopilot, duration, say=None):
    """Tick for so many seconds, saying something each time; give stamp and text of all heard."""
    heard = []
    for now_ns in range(0, round(duration * SECOND), 100 * MS):
        if now_ns % SECOND == 0:
            session.receive(autopilot.heartbeat(), now_ns)
        if say is not None:
            say(now_ns)
        session.tick(now_ns)
        heard += [(now_ns, m) for m in sent(session, "STATUSTEXT")]
    return heard


def test_rule_29_the_same_text_is_said_once_a_second_at_most():
    """Rule 29."""
    session, autopilot = met()
    texts = session.statustext
    heard = hear(session, autopilot, 5.0, lambda now: texts.send(Severity.WARNING, "GNSS lost"))
    assert {(m.severity, m.text, m.id) for _, m in heard} == {(4, b"GNSS lost", 0)}
    assert len(heard) == 5
    assert all(after - before >= SECOND for (before, _), (after, _) in pairwise(heard))


def test_rule_29_what_flaps_ends_with_what_is_true():
    """Rule 29."""
    session, autopilot = met()
    for text in ("lost", "found", "lost"):
        session.statustext.send(Severity.INFO, text)
        session.tick(0)
    session.statustext.send(Severity.INFO, "found")
    heard = [m.text for _, m in hear(session, autopilot, 3.0)]
    assert heard[-1] == b"found"


def test_rule_29_a_flood_is_bounded_and_the_newest_is_said():
    """Rule 29."""
    session, autopilot = met()
    for number in range(1000):
        session.statustext.send(Severity.INFO, f"number {number}")
    heard = [m.text for _, m in hear(session, autopilot, 20.0)]
    assert len(heard) == 16
    assert heard[-1] == b"number 999"
    assert session.statustext.dropped == 1000 - 16


def test_rule_29_a_flood_drops_the_least_severe_first():
    """Rule 29."""
    session, autopilot = met()
    session.statustext.send(Severity.CRITICAL, "estimate invalid, not sent")
    for number in range(20):
        session.statustext.send(Severity.WARNING, f"warning {number}")
        session.statustext.send(Severity.INFO, f"number {number}")
    heard = [m.text for _, m in hear(session, autopilot, 20.0)]
    assert heard == [
        b"estimate invalid, not sent",
        *(f"warning {number}".encode() for number in range(5, 20)),
    ]


def test_rule_29_nothing_is_said_while_nobody_is_heard():
    """Rule 29."""
    session, autopilot = met()
    session.tick(6 * SECOND)
    session.statustext.send(Severity.INFO, "nobody hears")
    session.receive(autopilot.heartbeat(), 7 * SECOND)
    session.tick(7 * SECOND)
    assert sent(session, "STATUSTEXT") == []


def test_rule_29_a_long_text_comes_in_numbered_pieces_of_one_number():
    """Rule 29."""
    session, _ = met()
    texts = ["a" * 60, "b" * 120]
    for text in texts:
        session.statustext.send(Severity.ERROR, text)
    session.tick(0)
    session.tick(SECOND)
    pieces = sent(session, "STATUSTEXT")
    assert [(m.id, m.chunk_seq) for m in pieces] == [(1, 0), (1, 1), (2, 0), (2, 1), (2, 2)]
    assert b"".join(m.text for m in pieces).decode() == "".join(texts)


def test_a_long_text_is_cut_between_words():
    """Whoever shows pieces by themselves shows no half of a word."""
    text = "Companion: reset 126 m 7.7 m/s 13 deg, heading against the motion"
    first = b"Companion: reset 126 m 7.7 m/s 13 deg, heading"
    assert chunks(text) == [first.ljust(50), b"against the motion"]
    words = " ".join(["seven77"] * 40)
    pieces = chunks(words)
    assert {word for piece in pieces for word in piece.split()} == {b"seven77", b"seven77..."}


@given(st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=300))
def test_rule_29_no_piece_ends_inside_a_character_or_before_its_end(text):
    """Rule 29."""
    pieces = chunks(text)
    assert all(len(piece) == 50 for piece in pieces[:-1])
    assert len(pieces[-1]) < 50 or len(pieces) == 1
    # Each can be read alone, and together they are the text, spaces at the seams aside
    read, kept = "".join(piece.decode() for piece in pieces), text.replace("\0", "")
    assert b"\0" not in b"".join(pieces)
    if len(kept.encode()) > LARGEST:
        assert read.endswith("...")
        assert kept.replace(" ", "").startswith(read[:-3].replace(" ", ""))
        assert len(read.encode()) > LARGEST // 2
    else:
        assert read.replace(" ", "") == kept.replace(" ", "")
        assert read == kept or " " in kept or not kept.isascii()
