"""Frames that were heard before, late ones, and a clock that was really set back."""

import random

import pytest

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.decode import aids
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.past_frames import KEPT, PastFrames
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.timebase import TimeBase
from ekf_companion.nav.measurements import ImuSample, Restart

MS = 1_000_000
SECOND = 1_000_000_000
BEGIN_US = 60_000_000
STEP_US = 4000
KINDS = {"HIGHRES_IMU": "time_usec", "RAW_IMU": "time_usec", "SCALED_IMU": "time_boot_ms"}
"""The inertial messages, and their stamps."""
OLD = {"age": [0.2, 0.5, 1.0, 1.5, 2.5, 8.0], "kind": list(KINDS)}


def flight(kind, count, seed=1):
    """Return arrival, ns, and frames of an autopilot: samples, and what comes between them."""
    rng, sender, heard = random.Random(seed), Sender(1, 1), []
    for n in range(count):
        t_us = BEGIN_US + STEP_US * n
        stamp = t_us if KINDS[kind] == "time_usec" else t_us // 1000
        numbers = {name: rng.randrange(-900, 900) for name in ("xacc", "xgyro", "ygyro")}
        extra = {"fields_updated": 0x3F} if kind == "HIGHRES_IMU" else {}
        made = [sender.message(kind, **{KINDS[kind]: stamp}, zacc=-1000, **numbers, **extra)]
        if n % 25 == 0:
            made.append(sender.message("ATTITUDE", time_boot_ms=t_us // 1000, yaw=rng.random()))
            made.append(sender.message("VFR_HUD", heading=n // 25 % 360))
        if n % 50 == 0:
            place = {"lat": 473977635 + rng.randrange(999), "lon": 85455780, "fix_type": 3}
            made.append(sender.message("GPS_RAW_INT", time_usec=t_us - 120_000, **place))
        if n % 250 == 0:
            made.append(sender.message("HEARTBEAT", type=2, autopilot=3))
        heard += [(t_us * 1000, frame) for frame in made]
    return heard


def hear(session, heard):
    """Return what a session measured of frames, each at its time."""
    return [one for at, frame in heard for one in session.receive(frame, at)]


def samples(measurements):
    return [one for one in measurements if type(one) is ImuSample]


def restarts(measurements):
    return [one for one in measurements if type(one) is Restart]


@pytest.mark.parametrize("age", OLD["age"])
@pytest.mark.parametrize("kind", OLD["kind"])
def test_a_burst_of_frames_that_were_heard_before_changes_nothing(kind, age):
    heard = flight(kind, 4000)
    at = 3000
    first = next(i for i, one in enumerate(heard) if one[0] >= heard[at][0] - age * SECOND)
    again = [(heard[at][0] + i, frame) for i, (_, frame) in enumerate(heard[first:at])]
    clean, burst = Session(), Session()
    expected = hear(clean, heard)
    found = hear(burst, [*heard[:at], *again, *heard[at:]])
    assert samples(found) == samples(expected)
    assert not restarts(found)
    assert burst.sequence.lost == clean.sequence.lost == 0
    assert burst.past.again > 0.9 * (at - first)


@pytest.mark.parametrize("apart", [0.05, 0.4, 1.0, 2.5])
@pytest.mark.parametrize("kind", KINDS)
def test_a_second_path_counts_once_and_is_named_once(kind, apart):
    heard = flight(kind, 3000)
    second = [(at + round(apart * SECOND), frame) for at, frame in heard[500:]]
    both = sorted([*heard, *second], key=lambda one: one[0])
    clean, session = Session(), Session()
    expected = samples(hear(clean, heard))
    found = hear(session, both)
    assert samples(found) == expected
    assert not restarts(found)
    assert session.sequence.lost == 0
    notes = [event.text for event in session.events() if hasattr(event, "text")]
    assert sum("two paths" in str(note) for note in notes) <= 1
    assert session.past.is_second_path


@pytest.mark.parametrize("apart", [0.05, 0.4, 1.0, 2.5])
@pytest.mark.parametrize("kind", KINDS)
def test_a_change_to_a_slower_path_is_no_other_clock(kind, apart):
    heard = flight(kind, 3000)
    begin = heard[1500][0]
    slower = [(at + round(apart * SECOND), frame) for at, frame in heard]
    change = [one for one in heard if one[0] < begin] + [one for one in slower if one[0] >= begin]
    session = Session()
    found = hear(session, change)
    assert not restarts(found)
    assert samples(found) == samples(hear(Session(), heard))[: len(samples(found))]
    assert session.sequence.lost == 0


@pytest.mark.parametrize("kind", KINDS)
def test_late_frames_of_a_stall_fill_their_places_and_are_not_lost(kind):
    """What comes after newer frames is no clock that was set back."""
    heard, rng = flight(kind, 3000), random.Random(3)
    begin, end = heard[1500][0], heard[1500][0] + SECOND
    stalled = [one for one in heard if begin <= one[0] < end]
    late = [one for one in stalled if rng.random() < 0.3]
    after = [one for one in heard if one[0] >= end]
    given = [one for one in heard if one[0] < begin] + after[:30]
    given += [(after[30][0] + i, frame) for i, (_, frame) in enumerate(late)] + after[30:]
    session = Session()
    found = hear(session, given)
    assert not restarts(found)
    missing = len(samples(hear(Session(), heard))) - len(samples(found))
    assert missing <= len(stalled) - len(late) + 5
    assert session.sequence.lost <= len(stalled) + 5


@pytest.mark.parametrize(
    ("share", "late"), [(0.1, 0.5), (0.5, 0.5), (0.5, 1.5), (0.9, 0.6), (0.1, 2.5), (0.02, 1.9)]
)
@pytest.mark.parametrize("kind", KINDS)
def test_a_stream_whose_last_frames_are_all_late_has_no_other_clock(kind, share, late):
    """Behind the newest they go on for as long as they are late, and nothing newer comes."""
    heard, rng = flight(kind, 2500), random.Random(5)
    moved = [(at + round(late * SECOND * (rng.random() < share)), frame) for at, frame in heard]
    session = Session()
    found = hear(session, sorted(moved, key=lambda one: one[0]))
    assert not restarts(found)
    assert "clock set back" not in session.decoder.context.refused


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("back", [0.41, 1.002, 1.8])
def test_a_clock_that_was_set_back_on_a_link_that_loses_frames_is_found(back, missing):
    """Places are empty then, but the numbers of the frames go on."""
    rng, heard = random.Random(5), flight("HIGHRES_IMU", 4000)
    sender, given = Sender(1, 1), []
    for n, (at, frame) in enumerate(heard):
        set_us = round(back * 1e6) if n >= 2000 else 0
        said = unpack(Splitter().feed(frame)[0])._asdict()
        for name in {"time_usec", "time_boot_ms"} & said.keys():
            said[name] -= set_us if name == "time_usec" else set_us // 1000
        again = sender.message(LAYOUTS[Splitter().feed(frame)[0].message_id].name, **said)
        if rng.random() >= missing:
            given.append((at, again))
    assert [one.goes_on for one in restarts(hear(Session(), given))] == [True]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("back", [0.4, 1.0, 1.8])
def test_a_clock_that_was_really_set_back_is_found(kind, back):
    """Its samples are others, and they come as time goes on."""
    heard, other = flight(kind, 2000), flight(kind, 2000, seed=2)
    moved = heard[1500][0] - round(back * SECOND)
    goes_on = [(at + heard[1500][0] - moved, frame) for at, frame in other if at >= moved]
    session = Session()
    found = hear(session, [*heard[:1500], *goes_on])
    assert [one.goes_on for one in restarts(found)] == [True]


@pytest.mark.parametrize("share", [0.03, 0.3, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_clock_that_began_anew_is_found_as_soon_where_frames_come_twice(kind, share):
    rng = random.Random(7)
    before, after = flight(kind, 3000), flight(kind, 3000, seed=2)
    after = [(at + 13 * SECOND, frame) for at, frame in after]
    twice = []
    for at, frame in after:
        twice += [(at, frame)] * (2 if rng.random() < share else 1)
    once, doubled = Session(), Session()
    expected = hear(once, [*before, *after])
    found = hear(doubled, [*before, *twice])
    assert len(restarts(found)) == len(restarts(expected)) == 1
    assert len(samples(found)) == pytest.approx(len(samples(expected)), abs=20)
    assert not doubled.past.is_named


def test_a_stamp_of_zero_is_no_time_and_proves_nothing():
    session, sender = Session(), Sender(1, 1)
    hear(session, flight("HIGHRES_IMU", 600))
    origin = sender.message("GPS_GLOBAL_ORIGIN", latitude=473977635, longitude=85455780)
    for n in range(3):
        session.receive(origin, (70 + n) * SECOND)
    assert session.past.again == 0


def test_the_frames_that_are_kept_are_bounded():
    past, clock = PastFrames(), TimeBase()
    session, kept = Session(), []
    session.on_frame = kept.append
    hear(session, flight("HIGHRES_IMU", 3 * KEPT))
    for frame in kept:
        past.keep(frame)
    assert len(past._waiting) <= KEPT
    clock.advance(BEGIN_US + 3 * KEPT * STEP_US)
    assert not past.holds(kept[5], clock, 0)  # too long ago to be known
    assert past.holds(kept[-200], clock, 0)


def stamp(layout, ms):
    """Return the field that holds a time since boot: ArduPilot's OPTICAL_FLOW says ms as well."""
    if "time_boot_ms" in layout.names:
        return {"time_boot_ms": ms}
    return {"time_usec": ms if layout.name == "OPTICAL_FLOW" else 1000 * ms}


def test_messages_of_the_aids_are_recognised_too():
    for reader in aids.READERS:
        layout = LAYOUTS[IDS[reader.message]]
        past, clock = PastFrames(aids.RATES), TimeBase()
        units = {"time_boot_ms": 1, "time_usec": 1000}
        stamps = [name for name in layout.names if name in units]
        if reader.message == "AIRSPEED":  # it counts at the newest stamp of the others
            assert not stamps
            continue
        first, later = (
            Splitter().feed(Sender(1, 1).message(reader.message, **stamp(layout, ms)))[0]
            for ms in (1000, 3000)
        )
        clock.advance(1_000_000)
        assert not past.holds(first, clock, 0)
        for t_us in range(1_100_000, 3_100_000, 100_000):
            clock.advance(t_us)
        assert not past.holds(later, clock, 0)
        assert past.holds(first, clock, 0)


def test_every_aid_has_a_message_of_its_own():
    assert len({reader.message for reader in aids.READERS}) == len(aids.READERS)
