"""The verdict before take-off: each thing that speaks against it, as a vehicle would show it."""

import inspect
import math
import re
from dataclasses import replace

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import PreflightConfig
from ekf_companion.core.settings import GnssSettings
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav.state import Status
from ekf_companion.status import preflight
from ekf_companion.status.preflight import check
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import HomeConfig, SimConfig, StreamConfig
from sim_autopilot.faults.fault import parse
from sim_autopilot.faults.sensors import SensorFaults
from sim_autopilot.flight import Flight
from tests.paths import ROOT
from tests.status.test_observer import MS, Watched

OPEN = object()
WHOLE = "duration=60"
NO_SATELLITES = f"gnss-outage:how=nofix,{WHOLE}"
NO_COMPASS_FIELD = f"mag-disturbance:{WHOLE},forward=0.5"


def stand(*faults, duration=12.5, config=None, scenario="static", silent=(), **options):
    """Return a companion beside an autopilot that stands, with what is wrong with it.

    ``silent`` are messages that the autopilot does not have.
    """
    watched = Watched(config=config)
    streams = StreamConfig(**dict.fromkeys(silent, 0.0))
    sim = SimConfig(streams=streams, **options)
    flight = Flight.plan(scenario, sim, duration=duration)
    autopilot = Autopilot(sim)
    wrong = SensorFaults([parse(one) for one in faults], flight.first_ns - flight.period_ns)
    for cycle in map(wrong.apply, flight.cycles()):
        autopilot.cycle(cycle)
        frames = [one for one in autopilot.data_to_send() if not is_of(one, silent)]
        said = watched._turn(cycle.t_ns, b"".join(frames))
        autopilot.receive(b"".join(said), cycle.t_ns)
    watched.link._port = OPEN
    return watched


def is_of(frame, names):
    return int.from_bytes(frame[7:10], "little") in {IDS[name] for name in names}


def wait(watched, seconds):
    """Let time pass in which nothing comes."""
    for _ in range(round(10 * seconds)):
        watched.now_ns += 100 * MS
        watched.observer.tick(watched.now_ns)
    return watched


def verdict(watched):
    return watched.snapshot().preflight


@pytest.fixture(scope="module")
def good():
    """The snapshot of a vehicle that stands and lacks nothing."""
    return stand(duration=18.0).snapshot()


def changed(snapshot, **vehicle):
    """Return the verdict on a snapshot with another estimate of the vehicle."""
    return check(replace(snapshot, vehicle=replace(snapshot.vehicle, **vehicle)))


def answered(snapshot, **autopilot):
    """Return the verdict on a snapshot in which the autopilot says something else."""
    return changed(snapshot, autopilot=replace(snapshot.vehicle.autopilot, **autopilot))


# As a vehicle shows it


def test_a_vehicle_that_stands_and_lacks_nothing_is_ready(good):
    assert good.preflight.sentence == "ready"
    assert good.preflight.ready
    assert good.preflight.reasons == good.preflight.notes == good.preflight.causes == ()


def test_a_board_that_is_mounted_upside_down_is_seen_though_the_autopilot_agrees():
    found = verdict(stand("mounting:roll=180"))
    assert not found.ready
    assert found.causes == ("mounting",)
    assert found.sentence.startswith("not ready: mounting looks upside down: roll is ")


def test_a_board_on_its_side_is_seen():
    found = verdict(stand("mounting:roll=70"))
    assert "mounting looks wrong, or the vehicle lies on a side: roll is 7" in found.sentence


def test_a_heading_that_differs_from_the_autopilot_s_is_told_with_its_size():
    found = verdict(stand("own-estimate:heading=34"))
    assert found.causes == ("heading differs",)
    assert found.reasons[0] in {
        f"heading differs from the autopilot's by {turned} deg" for turned in range(29, 40)
    }


def test_a_position_that_differs_from_the_autopilot_s_is_told():
    found = verdict(stand("own-estimate:heading=0,north=80"))
    assert found.causes == ("position differs",)
    assert found.reasons[0].startswith("position differs from the autopilot's by ")


def test_a_height_that_differs_from_the_autopilot_s_is_told():
    found = verdict(stand("own-estimate:heading=0,down=-30"))
    assert found.causes == ("height differs",)


def test_without_satellites_there_is_no_fix_and_the_receiver_says_why():
    found = verdict(stand(NO_SATELLITES, silent=("GLOBAL_POSITION_INT",)))
    assert found.sentence == "not ready: no fix: the receiver has no 3-D fix"
    assert found.causes == ("no fix",)


def test_a_receiver_that_is_not_there_is_told_as_such():
    silent = ("GPS_RAW_INT", "GLOBAL_POSITION_INT")
    found = verdict(stand(silent=silent))
    assert found.sentence == "not ready: no fix: no GPS_RAW_INT comes"


def test_the_autopilot_s_own_position_is_no_fix():
    found = verdict(stand(NO_SATELLITES))
    assert found.causes == ("no fix",)
    assert found.reasons[0].endswith("; the position is the autopilot's own estimate")


def test_the_autopilot_s_own_position_will_do_where_the_configuration_names_it():
    config = Config(gnss=GnssSettings(source="global"))
    found = verdict(stand(NO_SATELLITES, config=config))
    assert found.sentence == (
        "ready (position not compared: ours is the autopilot's own, no receiver's)"
    )


def test_a_vehicle_without_gnss_by_configuration_is_not_asked_for_a_fix():
    silent = ("GPS_RAW_INT", "GLOBAL_POSITION_INT")
    config = Config(preflight=PreflightConfig(needs_fix=False))
    found = verdict(stand(config=config, silent=silent))
    assert found.ready
    (note,) = found.notes
    assert re.fullmatch(
        r"heading is known to 1\d deg only: no position shows the declination", note
    )


def test_fixes_that_are_lost_are_told_with_since_when():
    found = verdict(stand(f"gnss-outage:start=6,how=nofix,{WHOLE}", duration=12.0))
    assert found.causes[0] == "no fix"
    assert found.reasons[0] == "no fix for 6 s: the receiver has no 3-D fix"


def test_fixes_that_are_refused_are_told():
    found = verdict(stand(f"gnss-jump:start=6,{WHOLE}", duration=11.0))
    assert found.reasons[0] == "fixes refused: outside its gate"


@pytest.mark.parametrize("start", [0, 6])
def test_a_compass_that_is_refused_is_told_though_another_heading_is_used(start):
    found = verdict(stand(f"{NO_COMPASS_FIELD},start={start}", duration=14.0))
    assert found.causes == ("compass refused",)
    assert found.sentence == (
        "not ready: compass refused: the magnetic field is not the Earth's; "
        "heading is from ATTITUDE, the autopilot's own"
    )


def test_a_compass_without_which_there_is_no_heading_is_told():
    # All that has a heading of the autopilot's
    silent = ("ATTITUDE", "GLOBAL_POSITION_INT")
    found = verdict(stand(NO_COMPASS_FIELD, silent=silent))
    assert found.causes == ("compass refused", "not compared")
    assert found.reasons[0] == "compass refused: the magnetic field is not the Earth's"


def test_levels_that_drift_at_rest_are_told():
    found = verdict(stand("accel-drift:start=4,forward=0.03", duration=20.0))
    assert found.causes == ("levels drift",)
    assert found.reasons[0].startswith("levels drift: pitch by ")


def test_a_barometer_that_is_refused_is_told():
    found = verdict(stand(f"baro-step:start=6,{WHOLE},height=40", duration=11.0))
    assert found.reasons == ("barometer refused: outside its gate",)


def test_an_autopilot_that_has_fallen_silent_is_all_that_is_told():
    found = verdict(wait(stand(duration=6.0), 6.0))
    assert found.causes == ("no input",)
    assert found.sentence.startswith("not ready: the link has been silent for 5.9 s: check ")


def test_a_link_that_is_closed_is_told():
    watched = stand(duration=4.0)
    watched.link._port = None
    assert verdict(watched).causes == ("no input",)


def test_an_estimate_that_has_stopped_is_not_compared():
    """Bytes and heartbeats come, and no sample: what is estimated is of before."""
    watched = stand(duration=6.0)
    snapshot = replace(watched.snapshot(), sample_age_s=1.5)
    assert check(snapshot).reasons == ("the estimate is 1.5 s old",)


def test_until_fixes_have_been_used_for_ten_seconds_it_is_settling():
    """The first fixes of a receiver are its worst."""
    early, late = (verdict(stand(duration=duration)) for duration in (9.0, 12.5))
    assert early.causes == ("settling",)
    assert re.fullmatch(r"settling: position is aided for [78] of 10 s", early.reasons[0])
    assert late.ready


def test_before_it_has_aligned_it_is_not_ready():
    found = verdict(stand(duration=0.5))
    assert found.reasons == ("still aligning: leave the vehicle at rest",)


def test_a_vehicle_that_is_armed_already_is_told():
    found = verdict(stand(duration=10.0, scenario="hover"))
    assert found.causes[0] == "armed"
    assert not found.ready


def test_in_flight_a_lean_is_no_mounting(good):
    leaning = replace(good.vehicle, roll_deg=100.0)
    armed = replace(good, vehicle=leaning, peer=replace(good.peer, is_armed=True))
    assert "mounting" not in check(armed).causes
    assert "mounting" in check(replace(armed, peer=good.peer)).causes


def test_a_stall_is_told(good):
    stalled = replace(good, process=replace(good.process, tick_age_s=3.0))
    assert check(stalled).causes == ("unhealthy",)


def test_before_the_first_sample_nothing_is_estimated(good):
    assert check(replace(good, estimator=None)).reasons == ("nothing is estimated yet",)


def test_every_cause_is_explained_with_what_to_do():
    source = inspect.getsource(preflight)
    causes = set(re.findall(r'Reason\(\s*"([^"]+)"', source))
    page = (ROOT / "docs" / "PREFLIGHT.md").read_text(encoding="utf-8")
    assert len(causes) > 20
    assert {cause for cause in causes if f"`{cause}`" not in page} == set()


# How far apart is too far


def heading_off(snapshot, turned, std):
    sigma = replace(snapshot.vehicle.sigma, heading_deg=std)
    ours = snapshot.vehicle.autopilot.heading_deg + turned
    return changed(snapshot, heading_deg=ours % 360.0, sigma=sigma, turn_rate_deg_s=0.0)


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_heading_counts_beyond_three_sigmas_of_both_sides(good, way):
    assert heading_off(good, way * 14.9, 0.0).ready
    assert not heading_off(good, way * 15.1, 0.0).ready
    limit = 3.0 * math.hypot(5.0, 8.0)
    assert heading_off(good, way * (limit - 0.1), 8.0).ready
    assert not heading_off(good, way * (limit + 0.1), 8.0).ready


def test_while_the_vehicle_turns_an_older_answer_may_differ_more(good):
    other = replace(good.vehicle.autopilot, attitude_age_s=0.5)
    ours = (other.heading_deg + 20.0) % 360.0
    sigma = replace(good.vehicle.sigma, heading_deg=0.0)
    still = {"autopilot": other, "heading_deg": ours, "sigma": sigma}
    assert not changed(good, **still, turn_rate_deg_s=0.0).ready
    assert changed(good, **still, turn_rate_deg_s=12.0).ready


def test_levels_that_differ_are_told_by_the_angle_between_both_downs(good):
    sigma = replace(good.vehicle.sigma, roll_deg=0.0, pitch_deg=0.0)
    own = good.vehicle.autopilot
    for moved, is_ready in ((3.5, True), (3.7, False)):
        off = {"roll_deg": own.roll_deg, "pitch_deg": own.pitch_deg + moved}
        found = changed(good, **off, sigma=sigma, turn_rate_deg_s=0.0)
        assert found.ready is is_ready
    assert found.causes == ("level differs",)
    assert found.reasons == ("roll and pitch differ from the autopilot's by 4 deg",)


def test_a_position_counts_beyond_three_sigmas_and_5_m(good):
    def off(metres, std, **autopilot):
        sigma = replace(good.vehicle.sigma, horizontal_m=std)
        other = replace(good.vehicle.autopilot, **autopilot)
        lat = other.lat_deg + math.degrees(metres / 6378137.0)
        place = {"lat_deg": lat, "lon_deg": other.lon_deg, "vel_ned_m_s": (0.0, 0.0, 0.0)}
        return changed(good, **place, sigma=sigma, autopilot=other)

    assert off(4.9, 0.1).ready
    assert off(5.1, 0.1).causes == ("position differs",)
    # One that states no sigma is as sure as we are
    assert off(12.0, 3.0).ready
    assert not off(13.0, 3.0).ready
    assert not off(12.0, 3.0, horizontal_std_m=1.0).ready


def test_east_is_shorter_near_the_poles(good):
    other = replace(good.vehicle.autopilot, lat_deg=80.0, lon_deg=179.9999)
    place = {"lat_deg": 80.0, "lon_deg": -179.9999, "autopilot": other}
    assert changed(good, **place).ready  # 4 m, across the date line
    assert not changed(good, **place | {"lon_deg": -179.999}).ready


def test_a_height_counts_beyond_10_m(good):
    own = good.vehicle.autopilot.alt_m
    assert changed(good, alt_m=own + 9.9).ready
    assert changed(good, alt_m=own + 10.3).causes == ("height differs",)


def test_a_velocity_that_differs_is_told(good):
    north, east, down = good.vehicle.autopilot.vel_ned_m_s
    found = changed(good, vel_ned_m_s=(north + 1.5, east, down))
    assert found.reasons == ("velocity differs from the autopilot's by 1.5 m/s",)


# What is not compared


def test_an_attitude_older_than_a_second_is_compared_with_nothing(good):
    """A heading that is far off is not told as such: who knows what it is now."""
    found = answered(good, heading_deg=good.vehicle.heading_deg + 90.0, attitude_age_s=1.1)
    assert found.causes == ("not compared",)
    assert found.reasons == (
        "attitude not compared with the autopilot's: its ATTITUDE is 1.1 s old",
    )


def test_a_position_older_than_a_second_is_compared_with_nothing(good):
    found = answered(good, lat_deg=0.0, position_age_s=3.0)
    assert found.sentence == (
        "ready (position not compared: the autopilot's GLOBAL_POSITION_INT is 3.0 s old)"
    )


def test_an_autopilot_that_says_no_attitude_is_told():
    found = verdict(stand(silent=("ATTITUDE",)))
    assert found.reasons == ("attitude not compared with the autopilot's: it says none",)


def test_an_autopilot_that_says_no_position_is_a_note():
    found = verdict(stand(silent=("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")))
    assert found.sentence == "ready (position not compared: the autopilot says none)"


def test_what_the_autopilot_makes_of_our_odometry_proves_nothing(good):
    found = answered(good, heading_deg=0.0, is_attitude_ours=True, is_position_ours=True)
    assert found.ready
    assert found.notes == (
        "heading not compared: the autopilot's is made of our ODOMETRY",
        "position not compared: the autopilot's is made of our ODOMETRY",
    )


def test_a_heading_that_is_the_autopilot_s_proves_nothing(good):
    own = replace(good.vehicle.aids["heading"], source="ATTITUDE, the autopilot's own")
    aids = {**good.vehicle.aids, "heading": own}
    assert changed(good, aids=aids).sentence == (
        "ready (heading not compared: ours is taken from the autopilot)"
    )


# What the estimate says of itself


@pytest.mark.parametrize(
    ("sigma", "cause"),
    [
        ({"horizontal_m": 5.1}, "position unsure"),
        ({"heading_deg": 10.1}, "heading unsure"),
        ({"pitch_deg": 5.1}, "level unsure"),
    ],
)
def test_an_estimate_that_is_unsure_is_told(good, sigma, cause):
    found = changed(good, sigma=replace(good.vehicle.sigma, **sigma))
    assert found.causes == (cause,)
    assert "known to" in found.sentence


@pytest.mark.parametrize(
    ("aid", "cause"),
    [
        ("heading", "compass refused"),
        ("height", "height refused"),
        ("position", "fix refused"),
        ("baro", "baro refused"),
    ],
)
def test_an_aid_that_is_refused_is_told(good, aid, cause):
    refused = replace(good.vehicle.aids[aid], state="refused", why="outside its gate")
    assert changed(good, aids={**good.vehicle.aids, aid: refused}).causes == (cause,)


def test_a_heading_that_has_been_lost_is_told(good):
    lost = replace(good.vehicle.aids["heading"], state="lost", used_s=7.0)
    found = changed(good, aids={**good.vehicle.aids, "heading": lost})
    assert found.reasons == ("no heading from HIGHRES_IMU, magnetometer for 7 s",)


def test_a_heading_that_nothing_shows_is_told(good):
    none = replace(good.vehicle.aids["heading"], source="", state="none")
    found = changed(good, aids={**good.vehicle.aids, "heading": none}, heading_deg=math.nan)
    assert found.causes == ("no heading",)


def test_a_heading_that_drifts_is_told(good):
    drift = replace(good.vehicle.drift, seconds=20.0, heading_deg=9.0)
    assert changed(good, drift=drift).reasons == ("heading drifts: by 9 deg in 20 s at rest",)
    assert changed(good, drift=replace(drift, heading_deg=4.9)).ready
    assert changed(good, drift=replace(drift, seconds=3.9)).ready


def test_a_declination_that_becomes_known_is_no_drift():
    """Before the first fix the heading is magnetic: 18 deg from true north at this place."""
    home = HomeConfig(lat=64.0, lon=-147.0)
    watched = stand("gnss-outage:how=silent,duration=16", duration=28.0, home=home)
    assert verdict(watched).ready
    assert watched.snapshot().vehicle.drift.seconds > 4.0


def test_a_compass_that_is_refused_at_times_is_told_as_such(good):
    aid = replace(good.vehicle.aids["heading"], refused_s=0.5, why="the magnetic field is not so")
    found = changed(good, aids={**good.vehicle.aids, "heading": aid})
    assert found.reasons == ("compass refused now and then: the magnetic field is not so",)


def test_a_drift_within_its_own_sigma_is_none(good):
    drift = replace(good.vehicle.drift, seconds=20.0, roll_deg=0.8)
    sure = replace(good.vehicle.sigma, roll_deg=0.3)
    assert changed(good, drift=drift, sigma=replace(sure, roll_deg=1.0)).ready
    assert changed(good, drift=drift, sigma=sure).causes == ("levels drift",)


def test_a_degraded_estimate_without_another_reason_is_not_ready(good):
    degraded = replace(good.estimator, status=Status.DEGRADED)
    assert check(replace(good, estimator=degraded)).causes == ("degraded",)


def test_dead_reckoning_is_told_before_the_fixes_are_missed_for_long(good):
    reckoning = replace(good.estimator, status=Status.DEAD_RECKONING)
    assert check(replace(good, estimator=reckoning)).reasons == ("no fix: dead reckoning",)


def test_an_autopilot_that_flies_on_odometry_and_gets_none_is_told(good):
    other = replace(good.vehicle.autopilot, is_position_ours=True)
    output = replace(good.output, is_streaming=False, silence="waiting for the first fix")
    silent = replace(good, vehicle=replace(good.vehicle, autopilot=other), output=output)
    assert check(silent).reasons == (
        "the autopilot flies on our ODOMETRY, and none is sent: waiting for the first fix",
    )


# What is good to know


def test_what_speaks_against_no_take_off_is_a_note(good):
    slow = replace(good.estimator, imu_rate=50.0)
    output = replace(good.output, is_allowed=False, reason="GNSS would count twice")
    process = replace(good.process, recording_trouble="/a.tlog: the disk is full")
    found = check(replace(good, estimator=slow, output=output, process=process))
    assert found.ready
    assert found.notes == (
        "inertial samples come at 50 Hz: fast motion is missed",
        "ODOMETRY is withheld: GNSS would count twice",
        "not all is recorded: /a.tlog: the disk is full",
    )
