"""Which estimates are sent as ODOMETRY, and what of a correction an autopilot is told.

The recorded flights are of PX4's and ArduPilot's simulators, flown on what was sent then: jumps of
46 and 12 m that nobody was told, 20 s of dead reckoning, a restart that sent 17 m of sigma.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig
from ekf_companion.core.output.follower import NUMBERS, Follower
from ekf_companion.engine.checkpoint import Clocks
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.engine.stream import OdometryStream
from ekf_companion.engine.warm_start import WarmStart
from ekf_companion.logs import tlog
from ekf_companion.mavlink.decode import Family
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import COLUMNS
from ekf_companion.review.convert import convert
from tests.core.flights import between, changed
from tests.core.flights import flight as simulated
from tests.core.test_follower import about_down
from tests.engine.conversation import SECOND_NS, as_messages, converse, cycles, named
from tests.engine.estimation import KNOWN
from tests.engine.recorded import OURS, Sent, configured, frames, odometry, sent
from tests.paths import DATA

PX4, PASSIVE = "sitl-px4-flown-on-odometry", "sitl-px4-live-outage"
ARDUPILOT, RESTARTED = "sitl-arducopter-flown-on-odometry", "sitl-px4-warm-restart"
ARDUPILOTMEGA = 3
FOR_EVER = {"dead_reckoning_time": 3600.0, "dead_reckoning_std": 1e4}
BACK = {PX4: 85.0, PASSIVE: 100.0, ARDUPILOT: 450.0}
"""When what an outage leaves is over, s since boot: half a minute or a quarter after it."""
RETURNED = FOR_EVER | {"until": BACK[PX4]}
OFFSET = "LOCAL_POSITION_NED_SYSTEM_GLOBAL_OFFSET"
TOLD = {ARDUPILOT: 384.25}
"""When that autopilot told its origin, s; today it is asked for it from the start."""
OUTAGES = {PX4: (34.43, 54.4), PASSIVE: (60.2, 80.2), ARDUPILOT: (415.49, 435.6)}
"""When fixes ended and came again, s since boot, by the folders' README."""


# A jump is told


@pytest.mark.campaign
@pytest.mark.parametrize("flight", OUTAGES)
def test_no_step_over_a_metre_comes_without_a_moved_counter(flight):
    """Even where dead reckoning is sent for as long as the outage lasts."""
    for limits in ({}, FOR_EVER | {"until": BACK[flight]}):
        given = odometry(flight, **limits)
        steps, is_told = given.steps(), np.diff(given.count) != 0
        steady = np.diff(given.t) < 0.1
        assert steps[~is_told & steady].max() < 1.0
        returned = np.searchsorted(given.t, OUTAGES[flight][1])
        told = np.flatnonzero(is_told) + 1
        assert np.abs(given.t[told] - given.t[returned]).min() < 0.3


@pytest.mark.parametrize("flight", OUTAGES)
def test_what_is_usual_is_not_told(flight):
    """Neither in a hover, nor in squares at 5 m/s, nor at take-off and landing."""
    given, (lost, returned) = odometry(flight), OUTAGES[flight]
    told = given.t[1:][np.diff(given.count) != 0]
    quiet = (told < lost - 1.0) | (told > returned + 1.0)
    quiet &= np.abs(told - TOLD.get(flight, np.inf)) > 0.1
    gaps = given.t[1:][np.diff(given.t) > 1.0]
    assert not [t for t in told[quiet] if np.abs(gaps - t).min() > 2.0]


MODES = {"off": 0.5, "act": 1.0}
"""By ``weigh_faults``, how far an estimate may step untold, m: what a mixture adds may change by
more than a correction, and is bounded by what is promised."""


@pytest.mark.parametrize("weigh", MODES)
def test_a_spread_jump_of_46_m_is_no_step_for_any_follower(weigh):
    given = odometry(PX4, jumps="spread", weigh=weigh, **RETURNED)
    assert set(given.count) == {1}
    assert given.steps().max() < MODES[weigh]
    speed = np.linalg.norm(np.diff(given.vel_n, axis=0), axis=1) / np.diff(given.t)
    assert speed.max() < 15.0  # what this vehicle does itself, at most
    # and the sigma that is sent says how far it is from the estimate
    told = odometry(PX4, weigh=weigh, **RETURNED)
    left = np.linalg.norm((given.pos_n - told.pos_n)[:, :2], axis=1)
    late = given.t > 54.5
    assert (left[late] <= given.sd[late] + 0.01).all()
    assert left[late][0] > 44.0
    assert left[-1] == pytest.approx(left[late][0] - 0.5 * (given.t[-1] - 54.5), abs=1.0)


def test_to_ardupilot_the_position_is_told_and_the_velocity_is_spread():
    """Its filter takes the position of a moved counter, and goes on with its own velocity."""
    told = odometry(PX4, jumps="tell", autopilot=ARDUPILOTMEGA, **RETURNED)
    best = odometry(PX4, autopilot=ARDUPILOTMEGA, **RETURNED)
    at = np.searchsorted(best.t, 54.5)
    change = [
        np.linalg.norm(np.diff(one.vel_n[at - 8 : at + 8], axis=0), axis=1) for one in (told, best)
    ]
    assert change[0].max() > 1.0
    assert change[1].max() < 0.2
    assert best.count[at + 8] == best.count[at - 8] + 1
    assert np.linalg.norm(best.pos_n[at + 8] - told.pos_n[at + 8]) < 1e-5
    later = slice(*np.searchsorted(best.t, [60.0, 80.0]))
    assert best.vel_n[later] == pytest.approx(told.vel_n[later], abs=1e-4)


def test_after_a_silence_nothing_is_spread():
    """Whoever has ended its fusion meanwhile goes on from nothing."""
    limits = RETURNED | {"autopilot": ARDUPILOTMEGA, "dead_reckoning_time": 15.0}
    told, best = odometry(PX4, jumps="tell", **limits), odometry(PX4, **limits)
    first = int(np.argmax(np.diff(best.t))) + 1
    assert best.t[first] - best.t[first - 1] > 2.0
    assert best.vel_n[first] == pytest.approx(told.vel_n[first], abs=1e-4)
    assert best.count[first] > best.count[first - 1]


@pytest.mark.parametrize("weigh", MODES)
def test_in_a_continuous_frame_nothing_steps_and_the_offset_leads_to_the_other(weigh):
    messages = sent(PX4, "ODOMETRY", OFFSET, frame="continuous", weigh=weigh, **RETURNED)
    given = Sent([m for m in messages if hasattr(m, "quality")])
    assert set(given.count) == {1}
    assert given.steps().max() < MODES[weigh]
    told = odometry(PX4, weigh=weigh, **RETURNED)
    offset, checked = None, 0
    for m in messages:
        if not hasattr(m, "quality"):
            offset = m
            continue
        k = np.searchsorted(told.t, m.time_usec * 1e-6 - 1e-7)
        back = about_down(offset.yaw) @ [m.x, m.y, m.z] + [offset.x, offset.y, offset.z]
        # the other is in metres of PX4's sphere, 0.3 % off WGS-84
        assert back == pytest.approx(told.pos_n[k], abs=1e-3, rel=4e-3)
        yaw = so3.to_euler(np.array(m.q))[2] + offset.yaw
        assert so3.wrap(yaw - told.yaw[k]) == pytest.approx(0.0, abs=1e-4)
        checked += 1
    assert checked == len(told.t)
    assert np.hypot(offset.x, offset.y) > 44.0
    # once a second, and at once where it changes
    assert len(messages) - checked == pytest.approx(given.t[-1] - given.t[0], abs=4.0)


# Dead reckoning


@pytest.mark.parametrize("flight", OUTAGES)
def test_dead_reckoning_ends_in_silence_in_time_for_the_failsafe(flight):
    """Silence 2 s after the last fix: EKF2 gives up 5 s later, EKF3 7 s, checked for 1 s."""
    given, (lost, returned) = odometry(flight), OUTAGES[flight]
    away = (given.t > lost + 0.2) & (given.t < returned)
    last = given.t[away][-1]
    assert last - lost < 2.2
    assert given.quality[away][-1] == -1
    assert (given.quality[away] == -1).sum() == 1
    first = np.searchsorted(given.t, last + 0.01)
    assert given.t[first] - returned < 0.3
    assert given.quality[first] == 100
    assert given.sd[first] < 1.5


def test_the_vehicle_drifts_no_further_than_ten_metres_until_then():
    frames(PX4)
    truth = np.genfromtxt(DATA / PX4 / "truth.csv", delimiter=",", names=True)
    t = truth["time_us"] * 1e-6
    given = odometry(PX4)
    last = given.t[given.quality == 20][-1]
    begin, end = np.searchsorted(t, [34.43, last + 5.0])
    moved = np.hypot(*(truth[name][begin:end] - truth[name][begin] for name in ("n_m", "e_m")))
    assert moved.max() < 10.0


def test_the_limits_are_the_users_in_seconds_and_in_metres():
    lost = OUTAGES[PX4][0]
    for limits, longest in (
        ({"dead_reckoning_time": 6.0, "dead_reckoning_std": 1e4}, 6.0),
        ({"dead_reckoning_time": 60.0, "dead_reckoning_std": 5.0}, 7.0),
    ):
        given = odometry(PX4, until=55.0, **limits)
        last = given.t[(given.t > lost) & (given.t < 54.0)][-1]
        assert last - lost == pytest.approx(longest, abs=0.5)


@pytest.mark.parametrize("weigh", MODES)
def test_many_messages_of_dead_reckoning_say_no_more_than_one(weigh):
    """A follower that takes them for independent has the information of all of them together."""
    given, plain = odometry(PX4, weigh=weigh), odometry(PX4, weigh=weigh, **RETURNED)
    away = (given.t > 34.43) & (given.quality == 20)
    information = (1.0 / given.sd[away] ** 2).sum()
    sigma = given.sd[away][0]
    assert away.sum() > 20
    assert information < 5.0 / sigma**2  # 1 + 1/2 + 1/3 + ..., where equal ones would give 25
    outage = plain.sd[(plain.t > 36.0) & (plain.t < 54.0)]
    if weigh == "off":
        assert (np.diff(outage) > 0.0).all()
    else:  # the odds of a fault may fall meanwhile, and what they add with them
        assert (outage > 0.95 * np.maximum.accumulate(outage)).all()


# The first message of a run


CLOCKS = Clocks(1_800_000_000 * SECOND_NS, 7 * SECOND_NS, bytes(range(16)))


def part(begin_s: float, end_s: float) -> list[tuple[int, bytes]]:
    """Return the frames of some seconds since the recording's first."""
    given = frames(RESTARTED)
    return [one for one in given if begin_s <= (one[0] - given[0][0]) * 1e-9 < end_s]


def run(begin_s: float, end_s: float, found: bytes | None = None) -> tuple[list, bytes, Companion]:
    """Return the ODOMETRY of a run from what another left, what it leaves, and its companion."""
    given = part(begin_s, end_s)
    warm_start = WarmStart(found, CLOCKS.later(given[0][0]), given[0][0])
    companion = Companion(configured(), warm_start=warm_start)
    said = odometry_of(companion, given)
    left = companion.checkpoint(CLOCKS.later(given[-1][0]))
    assert left is not None
    return said, left, companion


def odometry_of(companion: Companion, given: list) -> list:
    return named("ODOMETRY", as_messages(data for one in given for data in _feed(companion, *one)))


def _feed(companion: Companion, now_ns: int, frame: bytes) -> list[bytes]:
    companion.receive(frame, now_ns)
    companion.tick(now_ns)
    return companion.data_to_send()


def test_after_a_restart_the_first_message_waits_for_its_fix():
    """The recorded restart sent eight with sigmas of 17.5 m and 11.9 m/s, and PX4 reset to them."""
    stamps = np.array([now_ns for now_ns, _ in frames(RESTARTED)])
    begin = float((stamps[np.argmax(np.diff(stamps)) + 1] - stamps[0]) * 1e-9)
    first, left, _ = run(0.0, begin - 0.1)
    second, _, companion = run(begin, begin + 4.0, left)
    before, after = Sent(first), Sent(second)
    assert after.quality[0] >= 50
    assert after.sd[0] < 1.5
    assert after.t[0] - before.t[-1] < 3.7
    assert after.count[0] == before.count[-1] + 2  # the restart, and the reset by the fix
    assert np.linalg.norm(after.pos_n[0] - before.pos_n[-1]) < 2.5
    assert companion.pipeline.health().start.startswith("warm: ")


def test_ten_restarts_in_a_row_keep_the_place():
    """Killed and begun again 1.5 s later every 6 s, in a hover and a figure of eight."""
    frames(RESTARTED)
    truth = np.genfromtxt(DATA / RESTARTED / "truth.csv", delimiter=",", names=True)
    place = np.stack([truth[name] for name in ("n_m", "e_m", "d_m")])
    said, left, _ = run(41.0, 49.0)
    runs = [Sent(said)]
    for begin in np.arange(50.5, 110.0, 6.0):
        said, left, companion = run(begin, begin + 4.5, left)
        assert companion.pipeline.health().start.startswith("warm: ")
        runs.append(Sent(said))
    assert len(runs) == 11
    reference = None
    for before, after in zip([runs[0], *runs], runs, strict=False):
        error = after.pos_n - np.stack(
            [np.interp(after.t, truth["time_us"] * 1e-6, x) for x in place], 1
        )
        reference = np.median(error, axis=0) if reference is None else reference
        assert np.linalg.norm(error - reference, axis=1).max() < 1.0
        assert after.quality[0] >= 50
        assert after is before or after.count[0] > before.count[-1]


def test_a_restart_without_fixes_waits_as_long_as_the_autopilot_holds_out():
    """PX4 for five seconds, of which the restart has taken 1.5, and half a one is kept."""
    config = configured(**FOR_EVER)
    turns = list(cycles(14.0, "hover"))
    first_ns = turns[0][0]
    before, after = (
        [one for one in turns if is_part((one[0] - first_ns) * 1e-9)]
        for is_part in (lambda t: t < 8.0, lambda t: t >= 9.5)
    )
    companion = Companion(config)
    converse(companion, before)
    data = companion.checkpoint(CLOCKS.later(before[-1][0]))
    found = WarmStart(data, CLOCKS.later(after[0][0]), after[0][0])
    companion = Companion(config, warm_start=found)
    silent = cycles(14.0, "hover", without=("GPS_RAW_INT", "GLOBAL_POSITION_INT"))
    said = converse(companion, (one for one in silent if one[0] >= after[0][0]))
    given = Sent(named("ODOMETRY", said))
    assert given.t[0] - after[0][0] * 1e-9 == pytest.approx(3.0, abs=0.1)
    assert set(given.quality) == {20}


def test_a_replay_sends_the_same(tmp_path):
    """Of what the daemon would have recorded: what came in, with ODOMETRY decided anew."""
    path, out = tmp_path / "flight.tlog", tmp_path / "again.tlog"
    given = [one for one in frames(PX4) if one[0] < frames(PX4)[0][0] + 70 * SECOND_NS]
    path.write_bytes(b"".join((t // 1000).to_bytes(8, "big") + frame for t, frame in given))
    companion = Companion(configured())
    live = odometry_of(companion, given)
    convert(path, out, replace(Config(), output=configured().output))
    again = [frame for _, frame in tlog.read(out).frames() if frame[6] == OURS]
    assert {m.quality for m in live} == {100, 20, -1}
    # A replay also has what waited for the origin
    stamps = {m.time_usec for m in live}
    assert len(live) > 1000
    assert [m for m in named("ODOMETRY", as_messages(again)) if m.time_usec in stamps] == live


@pytest.mark.parametrize("cut", [1.5, 12.0])
def test_after_a_cut_of_the_link_no_attitude_is_sent_until_it_is_known(cut):
    """Of 12 s without a sample it came back 119 deg off in yaw and 41 deg in pitch."""
    turns = list(cycles(60.0, "figure-eight"))
    first_ns = turns[0][0]
    heard = [one for one in turns if not 30.0 < (one[0] - first_ns) * 1e-9 - 1e-3 < 30.0 + cut]
    said = named("ODOMETRY", converse(Companion(configured()), heard))
    t = np.array([one.time_usec * 1e-6 for one in said]) - said[0].time_usec * 1e-6
    usable = np.array([one.quality > 0 for one in said])
    angles = np.array([[one.pose_covariance[k] for k in (15, 18, 20)] for one in said])
    assert np.degrees(np.sqrt(angles[usable].max())) < 21.0
    gaps = np.diff(t[usable])
    assert cut < gaps.max() < cut + 4.0
    assert t[usable][-1] > 50.0


# Where it is sent from


def test_nothing_is_sent_from_where_a_float32_has_no_centimetres():
    """A position 200 km off is reset to once it is proven, by the gates' own rules."""
    events, _ = simulated("hover", duration=80.0)
    fixes = (events.kind == Kind.GNSS) & between(events, 30.0, 99.0)
    pipeline = Pipeline(replace(KNOWN, weigh_faults="off"))
    follower, sent_n = Follower(), []
    stream = OdometryStream(OdometryConfig(), Family.PX4, follower)
    moved = changed(events, fixes, 0, 200e3 / 6.367e6)
    for t_ns, kind, values in zip(
        moved.t_ns.tolist(), moved.kind.tolist(), moved.values.tolist(), strict=True
    ):
        row = (t_ns, kind, tuple(values))
        if (estimate := pipeline.process_row(row)) is None:
            continue
        follower.samples.append(estimate.sample)
        if (message := stream.send(estimate)) is not None:
            sent_n.append(NUMBERS.unpack(message.numbers)[0])
    assert pipeline.values()[COLUMNS.index("pos_n") - 1] > 190e3
    assert np.abs(sent_n).max() < 10.0
    assert "too far from the origin" in stream.silence


def test_a_daemon_that_runs_before_the_first_fix_counts_from_where_the_vehicle_is():
    """The autopilot's own position is 17059 km off until then."""
    name = "sitl-ap-plane-calm-no-fix-at-start"
    origins = sent(name, "GPS_GLOBAL_ORIGIN")
    truth = np.genfromtxt(DATA / name / "truth.csv", delimiter=",", names=True)[0]
    places = np.array([(one.latitude, one.longitude) for one in origins]) * 1e-7
    away = (places - [truth["lat_deg"], truth["lon_deg"]]) * 111e3
    assert len(places) > 100
    assert np.hypot(*away.T).max() < 10.0
    odometry = sent(name, "ODOMETRY")
    assert {one.reset_counter for one in odometry} == {odometry[0].reset_counter}
