"""What stamps make of time, message by message: wraps, wild fields, and those of sending."""

import random
from itertools import pairwise

import pytest

from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Decoder, DecoderOptions, Family
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.nav.measurements import GnssFix, HeadingSample, ImuSample, Restart

MS = 1_000_000
WRAP_MS = 1 << 32
WIDEST = {"time_usec": 2**64 - 1, "time_boot_ms": WRAP_MS - 1, "time_unix_usec": 2**64 - 1}
STAMPED = {
    "HIGHRES_IMU": "time_usec",
    "RAW_IMU": "time_usec",
    "SCALED_IMU2": "time_boot_ms",
    "SCALED_PRESSURE": "time_boot_ms",
    "GLOBAL_POSITION_INT": "time_boot_ms",
    "ATTITUDE": "time_boot_ms",
    "SYSTEM_TIME": "time_boot_ms",
    "GPS_RAW_INT": "time_usec",
}


class Peer:
    """A decoder, and the messages of an autopilot whose clock is said."""

    def __init__(self, family=Family.ARDUPILOT, **options):
        self.decoder = Decoder(family, DecoderOptions(**options))
        self._sender = Sender(1, 1)

    def say(self, name, **fields):
        (frame,) = Splitter().feed(self._sender.message(name, **fields))
        return self.decoder.decode(frame)

    def highres(self, t_us, **fields):
        return self.say(
            "HIGHRES_IMU", time_usec=t_us, zacc=-9.81, fields_updated=0x1FF, xmag=0.3, **fields
        )

    def everything(self, t_us):
        """Return what all of an autopilot's messages of one moment say."""
        t_ms, place = t_us // 1000 % WRAP_MS, {"lat": 473977635 + t_us % 97, "lon": 85455780}
        return [
            *self.highres(t_us, ymag=t_us % 97 * 1e-4),
            *self.say("RAW_IMU", time_usec=t_us, zacc=-1000),
            *self.say("SCALED_IMU2", time_boot_ms=t_ms, zacc=-1000),
            *self.say("SCALED_PRESSURE", time_boot_ms=t_ms, press_abs=950.0),
            *self.say("GLOBAL_POSITION_INT", time_boot_ms=t_ms, hdg=9000, **place),
            *self.say("ATTITUDE", time_boot_ms=t_ms, yaw=1.0),
            *self.say("SYSTEM_TIME", time_unix_usec=1_700_000_000_000_000, time_boot_ms=t_ms),
            *self.say("GPS_RAW_INT", time_usec=t_us, fix_type=3, **place),
        ]


def only(kind, measurements):
    return [one for one in measurements if type(one) is kind]


def test_a_vehicle_that_runs_across_the_wrap_goes_on_in_all_its_messages():
    """Rule 11: milliseconds go round after 49.7 days, microseconds do not."""
    peer = Peer()
    for t_us in range((WRAP_MS - 2000) * 1000, (WRAP_MS + 2000) * 1000, 100_000):
        said = peer.everything(t_us)
        assert not only(Restart, said)
        assert {one.t_ns // MS * 1000 for one in said} == {t_us}
        if t_us > (WRAP_MS - 1800) * 1000:
            assert {ImuSample, HeadingSample, GnssFix} <= set(map(type, said))


@pytest.mark.parametrize("seed", range(8))
def test_wild_stamps_in_any_message_neither_restart_nor_say_anything(seed):
    """Rule 12: whatever a field holds once, the clock goes on."""
    rng = random.Random(seed)
    peer = Peer()
    for n in range(300):
        t_us = 50_000_000 + 100_000 * n
        said = peer.everything(t_us)
        assert not only(Restart, said)
        assert len(only(ImuSample, said)) == 1
        name, field = rng.choice(list(STAMPED.items()))
        wild = rng.randrange(WIDEST[field] + 1) >> rng.randrange(32)
        near = abs(wild * (1 if field == "time_usec" else 1000) - t_us) < 20_000_000
        if near:
            continue
        fields = {"fix_type": 3, "lat": 1, "lon": 1} if name == "GPS_RAW_INT" else {}
        fields |= {"zacc": -1000} if name.endswith(("IMU", "IMU2")) else {}
        assert only(ImuSample, peer.say(name, **{field: wild}, **fields)) == []
    assert peer.decoder.clock.latest_us == t_us


def test_a_wild_system_time_moves_no_fix_and_no_heading():
    peer = Peer(Family.PX4)
    unix_us = 1_700_000_000_000_000
    peer.highres(unix_us)
    peer.say("SYSTEM_TIME", time_unix_usec=unix_us, time_boot_ms=60_000)
    peer.say("SYSTEM_TIME", time_unix_usec=unix_us + 10**12, time_boot_ms=60_000)
    (heading,) = peer.say("ATTITUDE", time_boot_ms=60_010, yaw=0.5)
    assert heading.t_ns == (unix_us + 10_000) * 1000


def test_a_single_attitude_that_is_five_seconds_ahead_costs_itself_only():
    """Rule 12: no sample behind it is refused, and nothing begins anew."""
    peer, taken = Peer(Family.PX4), 0
    for n in range(500):
        taken += len(only(ImuSample, peer.highres(1_000_000 + 4000 * n)))
        if n == 250:
            assert peer.say("ATTITUDE", time_boot_ms=7000, yaw=1.0) == []
    assert taken == 500
    assert peer.decoder.refused == {"ATTITUDE: stamp leaps": 1}


def test_an_old_packet_is_refused_and_counted():
    """Rule 10: what is more than two seconds old leaps back, and nothing confirms it."""
    peer = Peer()
    for t_us in range(50_000_000, 53_000_000, 4000):
        peer.highres(t_us)
    assert peer.highres(50_500_000) == []
    assert peer.decoder.refused == {"HIGHRES_IMU: stamp leaps": 1}


# Stamps of sending


def sent(seed=1, count=4000):
    """Return stamps of every second turn of a 400 Hz loop, sent up to 1.8 ms later, us."""
    rng = random.Random(seed)
    return [10**8 + 5000 * n + min(int(rng.expovariate(1 / 300.0)), 1800) for n in range(count)]


def samples(peer, stamps):
    """Return the stamps, us, of the samples of HIGHRES_IMU messages."""
    return [one.t_ns / 1000 for t in stamps for one in only(ImuSample, peer.highres(t))]


def test_stamps_of_sending_are_brought_back_to_the_loops_turns():
    """Rule 10: RAW and SCALED stamps are de-jittered, and ArduPilot's HIGHRES_IMU."""
    peer, stamps = Peer(), sent()
    found = samples(peer, stamps)
    assert peer.decoder.inertial.is_dejittered
    late = [t - (10**8 + 5000 * n) for n, t in enumerate(found)][2000:]
    assert max(late) - min(late) < 400.0
    assert max(stamps[n] - 10**8 - 5000 * n for n in range(2000, 4000)) == 1800


def test_what_comes_with_a_sample_is_stamped_as_the_sample():
    peer, stamps = Peer(), sent()
    samples(peer, stamps)
    imu, mag = peer.highres(stamps[-1] + 5900, ymag=0.1)
    assert imu.t_ns == mag.t_ns < (stamps[-1] + 5900) * 1000


@pytest.mark.parametrize("family", [Family.PX4, Family.UNKNOWN])
def test_stamps_of_sampling_are_left_alone(family):
    """Rule 10: PX4 stamps HIGHRES_IMU with the time of the sample."""
    peer, stamps = Peer(family), sent()
    assert samples(peer, stamps) == stamps
    assert not peer.decoder.inertial.is_dejittered


def test_nobody_need_have_stamps_moved():
    stamps = sent()
    assert samples(Peer(is_dejittered=False), stamps) == stamps


def test_the_same_frames_give_the_same_stamps_and_a_reboot_begins_anew():
    """Live is replay: no time of arrival enters."""
    stamps = sent()
    first = samples(Peer(), stamps)
    peer = Peer()
    assert samples(peer, stamps) == first
    again = [t - 99_000_000 for t in stamps]  # after a reboot
    after = samples(peer, again)
    refused = len(again) - len(after)
    assert 0 < refused <= 52  # a quarter of a second
    assert after == samples(Peer(), again[refused:])


def test_a_sample_that_comes_late_is_put_where_it_would_have_been_while_stamps_are_moved():
    """Rule 10: its cycle is known by the line below all stamps."""
    peer, stamps = Peer(), sent()
    in_time = samples(peer, stamps)
    assert samples(peer, [stamps[-3]]) == []  # it waits until it is known that it is late
    late, _ = samples(peer, [stamps[-1] + 4000])
    assert late == pytest.approx(in_time[-3], abs=100_000)  # ns


@pytest.mark.parametrize("first", ["ATTITUDE", "SCALED_PRESSURE", "SCALED_IMU2"])
def test_a_reboot_is_told_also_by_a_message_whose_own_time_is_not_known_any_more(first):
    """Rule 12: the inertial stamps are unix time, the first to confirm the leap is since boot."""
    peer, unix_us = Peer(Family.UNKNOWN), 1_800_000_000_000_000
    for k in range(100):
        peer.highres(unix_us + 10_000 * k)
        peer.say("SYSTEM_TIME", time_unix_usec=unix_us + 10_000 * k, time_boot_ms=600_000 + 10 * k)
    said = []
    for k in range(100):
        said += peer.say(first, time_boot_ms=2000 + 10 * k)
    assert [type(one) for one in said] == [Restart]
    assert peer.decoder.refused[f"{'SCALED_IMU' if 'IMU' in first else first}: time base unknown"]


# A clock that is set back

HALF_US = 500_000
PERIOD_US = 4000


def numbered(peer, stamps):
    """Return what HIGHRES_IMU of these stamps say, the rate counting them."""
    return [found for n, t in enumerate(stamps) for found in peer.highres(t, xgyro=n * 1e-3)]


@pytest.mark.parametrize("family", [Family.PX4, Family.ARDUPILOT])
def test_rule_12_a_clock_set_back_by_half_a_second_goes_on_without_a_sample_lost(family):
    peer = Peer(family)
    before = [1_000_000 + PERIOD_US * n for n in range(100)]
    after = [before[-1] - HALF_US + PERIOD_US * n for n in range(1, 100)]
    assert len(only(ImuSample, numbered(peer, before))) == len(before)
    found = numbered(peer, after)
    assert [type(one) for one in found].count(Restart) == 1
    assert isinstance(found[0], Restart)
    assert found[0].goes_on
    told = only(ImuSample, found)
    assert [one.gyro_x for one in told] == pytest.approx([n * 1e-3 for n in range(len(after))])
    assert [round(one.t_ns, -6) for one in told] == [round(t * 1000, -6) for t in after]
    assert peer.decoder.refused["clock set back"] == 1


def test_messages_that_nobody_reads_may_come_while_the_clock_is_being_set_back():
    peer = Peer(Family.PX4)
    numbered(peer, [1_000_000 + PERIOD_US * n for n in range(100)])
    found = []
    for n in range(100):
        found += peer.highres(1_000_000 + PERIOD_US * n)
        found += peer.say("PING", seq=n)
    assert len(only(Restart, found)) == 1
    assert len(only(ImuSample, found)) == 100


def test_a_late_sample_is_given_with_the_next_that_is_not():
    peer = Peer(Family.PX4)
    stamps = [1_000_000 + PERIOD_US * n for n in range(50)]
    stamps.insert(40, stamps.pop(20))
    found = numbered(peer, stamps)
    assert [one.t_ns // 1000 for one in only(ImuSample, found)] == stamps
    assert not only(Restart, found)


SHORT = 1 << 32
"""Microseconds of 32 bits go round, after 71.6 minutes."""


@pytest.mark.parametrize(
    "begin_us",
    [
        *(SHORT - 10_000_000, SHORT - 100_000, SHORT + 10_000_000, 2 * SHORT - 5_000_000),
        *(5 * SHORT + 77, WRAP_MS * 1000 - 10_000_000, WRAP_MS * 1000 + 5_000_000, 600_000_000),
    ],
)
def test_microseconds_of_32_bits_go_on_by_the_milliseconds_beside_them(begin_us):
    """RAW_IMU of ArduPilot before 2021; also where the milliseconds wrap meanwhile."""
    peer, found = Peer(), []
    for n in range(1500):
        t_us = begin_us + 20_000 * n
        found += peer.say("RAW_IMU", time_usec=t_us % SHORT, zacc=-1000, xgyro=n % 7)
        if n % 5 == 0:
            t_ms = t_us // 1000 % WRAP_MS
            found += peer.say("ATTITUDE", time_boot_ms=t_ms, yaw=1.0)
    stamps = [one.t_ns for one in only(ImuSample, found)]
    assert len(stamps) > 1300  # a better source is waited for first
    restarts = [n for n, one in enumerate(found) if type(one) is Restart]
    assert not restarts or max(restarts) < 200  # until the milliseconds are known
    late = stamps[200:]
    assert all(0 < b - a <= 21 * MS for a, b in pairwise(late))
    assert stamps[-1] % (WRAP_MS * MS) == pytest.approx(
        (begin_us + 20_000 * 1499) * 1000 % (WRAP_MS * MS), abs=3 * MS
    )
