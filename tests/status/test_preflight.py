"""The verdict before take-off: each thing that speaks against it, as a vehicle would show it."""

import inspect
import re
from dataclasses import replace

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import PreflightConfig
from ekf_companion.core.settings.settings import GnssSettings
from ekf_companion.nav.state import Status
from ekf_companion.status import preflight
from ekf_companion.status.preflight import check
from sim_autopilot.config import HomeConfig, RangeFinderConfig
from tests.paths import ROOT
from tests.status.standing import NO_COMPASS_FIELD, NO_SATELLITES, WHOLE, stand, verdict, wait


@pytest.fixture(scope="module")
def good():
    """The snapshot of a vehicle that stands and lacks nothing."""
    return stand(duration=18.0).snapshot()


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
    # three seconds more: until then a receiver might still speak
    found = verdict(stand(NO_SATELLITES, config=config, duration=18.0))
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


OFF, ACT = (replace(Config(), weigh_faults=mode) for mode in ("off", "act"))
"""By the gates' own rules, and where the fault hypotheses decide."""


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (OFF, r"the estimate is degraded: GNSS is 5\d m off, refused"),
        (ACT, r"GNSS (50|49) m off, corrected"),
    ],
    ids=["off", "act"],
)
def test_fixes_that_are_refused_are_told(config, words):
    found = verdict(stand(f"gnss-jump:start=12,{WHOLE}", duration=14.5, config=config))
    assert re.match(words, found.reasons[0])


def test_while_a_source_is_only_suspected_it_is_told_and_its_aid_is_called_refused():
    """Three fixes come until it is beyond doubt: 12.4 s is before that, at 5 Hz and 0.12 s late."""
    snapshot = stand(f"gnss-jump:start=12,{WHOLE}", duration=12.6, config=ACT).snapshot()
    assert snapshot.preflight.causes == ("source wrong",)
    assert re.fullmatch(r"suspected: GNSS (50|49) m off", snapshot.preflight.reasons[0])
    assert re.fullmatch(r"suspected: GNSS (50|49) m off", snapshot.vehicle.aids["position"].why)
    assert snapshot.vehicle.aids["position"].refused_s < 1.0


def test_a_degraded_estimate_is_told_with_how_long_it_was_so_in_this_run():
    snapshot = stand(f"gnss-jump:start=12,{WHOLE}", duration=14.5, config=OFF).snapshot()
    spent = {"degraded": {"position_refused": 180.4, "compass_missing": 3.0}}
    found = check(replace(snapshot, seconds=spent))
    assert re.search(
        r"degraded: GNSS is 5\d m off, refused, 180 s of this run; wait", found.sentence
    )


def test_the_seconds_of_a_run_are_charged_to_status_and_reason():
    seconds = stand(f"gnss-outage:start=6,how=nofix,{WHOLE}", duration=14.0).snapshot().seconds
    assert seconds["dead_reckoning"]["position_missing"] == pytest.approx(5.5, abs=1.2)
    assert set(seconds["ok"]) == {""}
    assert "" not in seconds["dead_reckoning"]
    whole = sum(spent for by_reason in seconds.values() for spent in by_reason.values())
    assert whole == pytest.approx(14.0, abs=1.5)  # from the second look on, twice a second


@pytest.mark.parametrize(
    ("config", "cause"), [(OFF, "position differs"), (ACT, "source wrong")], ids=["off", "act"]
)
def test_a_receiver_that_has_settled_elsewhere_than_the_autopilot_is_told(config, cause):
    found = verdict(stand(f"gnss-jump:start=6,{WHOLE}", duration=12.0, config=config))
    assert found.causes == (cause,)


@pytest.mark.parametrize("start", [0, 6])
def test_a_compass_that_is_refused_is_told_though_another_heading_is_used(start):
    found = verdict(stand(f"{NO_COMPASS_FIELD},start={start}", duration=14.0))
    assert found.causes == ("compass refused",)
    assert found.sentence == (
        "not ready: compass refused: the magnetic field is not the Earth's; "
        "heading is from ATTITUDE, the autopilot's own"
    )


def test_where_a_compass_is_first_refused_the_log_says_so_once(caplog):
    caplog.set_level("INFO")
    watched = stand(f"{NO_COMPASS_FIELD},start=6", duration=14.0)
    assert watched.snapshot().vehicle.aids["heading"].refused_s < 1.0
    words = "Compass refused, always or at times: the magnetic field is not the Earth's"
    assert caplog.text.count(words) == 1
    caplog.clear()
    stand(duration=6.0)
    assert "Compass" not in caplog.text


def test_a_compass_without_which_there_is_no_heading_is_told():
    # All that has a heading of the autopilot's
    silent = ("ATTITUDE", "GLOBAL_POSITION_INT")
    found = verdict(stand(NO_COMPASS_FIELD, silent=silent))
    assert found.causes == ("compass refused", "not compared")
    assert found.reasons[0] == "compass refused: the magnetic field is not the Earth's"


@pytest.mark.parametrize("config", [OFF, ACT], ids=["off", "act"])
def test_levels_that_drift_at_rest_are_told(config):
    found = verdict(stand("accel-drift:start=4,forward=0.03", duration=20.0, config=config))
    assert found.causes[-1] == "levels drift"
    assert any(one.startswith("levels drift: pitch by ") for one in found.reasons)
    assert config is ACT or len(found.reasons) == 1


def test_a_declination_that_becomes_known_is_no_drift():
    """Before the first fix the heading is magnetic: 18 deg from true north at this place."""
    home = HomeConfig(lat=64.0, lon=-147.0)
    outage, silent = "gnss-outage:how=silent,duration=16", ("GLOBAL_POSITION_INT",)
    watched = stand(outage, duration=28.0, home=home, silent=silent)
    assert verdict(watched).ready
    assert watched.snapshot().vehicle.drift.seconds > 4.0


@pytest.mark.parametrize(
    ("config", "words"),
    [(OFF, "barometer refused: outside its gate"), (ACT, "barometer 40 m off, corrected")],
    ids=["off", "act"],
)
def test_a_barometer_that_is_refused_is_told(config, words):
    found = verdict(stand(f"baro-step:start=6,{WHOLE},height=40", duration=11.0, config=config))
    assert found.reasons == (words,)


def test_a_range_finder_that_bounces_is_told_and_harms_nothing_else():
    fitted = RangeFinderConfig(fitted=True)
    watched = stand(f"range-bounce:start=8,{WHOLE},lowest=5", duration=12.5, range_finder=fitted)
    found = verdict(watched)
    assert found.reasons == ("range finder refused: outside its gate",)
    assert watched.snapshot().estimator.status is Status.OK


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
    assert check(snapshot).reasons == ("no inertial sample has come for 1.5 s",)


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
    assert found.sentence.startswith("armed already: this is a check for before take-off")
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
