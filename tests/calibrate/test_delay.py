import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.delay import measured as measured_in
from ekf_companion.calibrate import delay
from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.errors import LogError
from ekf_companion.nav.measurements import Kind
from sim_autopilot.config import GnssConfig, ImuConfig
from tests.calibrate.recordings import fly, without

SETTINGS = FilterSettings()
IMU = ImuConfig(rate=25.0)
"""Few samples, as each of the 90 delays that are tried is a run of the filter over all of them."""


@cache
def measured() -> tuple[delay.Delay, list[tuple[int, int]]]:
    """Return the delay of a flight with the usual receiver, and the progress that was reported."""
    told: list[tuple[int, int]] = []
    flown = fly("figure-eight", 45.0, IMU)
    found = delay.measure(flown, SETTINGS, progress=lambda *pair: told.append(pair))
    return found, told


@pytest.mark.parametrize("late", [0.0, 0.1, 0.3])
def test_a_delay_is_found(late):
    found = delay.measure(fly("figure-eight", 45.0, IMU, GnssConfig(delay=late)), SETTINGS)
    assert found.best == pytest.approx(late, abs=0.01)
    assert found.low <= late <= found.high
    assert found.high - found.low < 0.02
    assert found.gain.max() == 0.0


@pytest.mark.campaign
def test_an_interval_covers_the_truth_where_the_inertial_sensors_are_noisy():
    noisy = ImuConfig(rate=25.0, gyro_noise=0.006, accel_noise=0.08)
    inside = 0
    for seed in range(1, 5):
        late = 0.05 * seed
        flown = fly("figure-eight", 45.0, noisy, GnssConfig(delay=late), seed=seed)
        found = delay.measure(flown, SETTINGS)
        assert found.best == pytest.approx(late, abs=0.015)
        inside += found.low <= late <= found.high
    assert inside >= 3


def test_a_peak_that_a_few_blocks_make_is_not_the_whole_interval():
    """Eighteen blocks show 0.19 s, in two a reset is avoided by chance at 0.23 s."""
    rng = np.random.default_rng(3)
    delays = np.arange(0.0, 0.4, 0.005)
    shown = 0.19 + 0.02 * rng.standard_normal(18)
    blocks = -0.5 * ((delays[:, None] - shown) / 0.02) ** 2
    blocks[np.abs(delays - 0.23) < 0.004, :2] += 40.0
    low, high = delay._redrawn(delays, blocks, 0.23)
    assert low < 0.185
    assert high >= 0.23


@pytest.mark.campaign
@pytest.mark.parametrize("motion", ["hover", "square-spiral"])
def test_intervals_cover_the_truth_in_a_small_campaign(motion):
    """``make delays`` flies 120; two by motion of 20 may miss."""
    results = [measured_in((motion, "", 7000 + seed)) for seed in range(3)]
    known = [one for one in results if one is not None]
    assert len(known) >= 2
    assert sum(low <= 0.0 <= high for _, low, high in known) >= len(known) - 1


def test_a_recorded_flight_with_clipped_samples_has_a_wide_interval(flight):
    from ekf_companion.replay.read import read

    name = "px4-ulg-tropic-aggressive/ekf_failure.ulg"
    # the velocities show 0.18 to 0.20 s
    try:
        found = delay.measure(read(flight(name), Config()), Config())
    except LogError as refusal:  # as wide as that it tells too little
        low, high = map(
            float, re.findall(r"from (-?0\.\d\d) to (-?0\.\d\d) s fits", str(refusal))[0]
        )
    else:
        low, high = found.low, found.high
        assert found.widening > 4.0
    assert low <= 0.18
    assert high >= 0.19


def test_what_is_configured_or_declared_is_not_asked():
    flown = fly("figure-eight", 45.0, IMU, GnssConfig(delay=0.1))
    told = FilterSettings(gnss=GnssSettings(delay=0.4, delay_std=0.0))
    found = delay.measure(replace(flown, gnss_delay=0.3), told)
    assert found.best == pytest.approx(0.1, abs=0.01)


def test_positions_alone_tell_a_delay_too():
    flown = fly("figure-eight", 90.0, IMU, GnssConfig(delay=0.2, noise_h=0.3))
    found = delay.measure(flown, FilterSettings(gnss=GnssSettings(use_velocity=False)))
    assert found.low <= 0.2 <= found.high
    assert found.best == pytest.approx(0.2, abs=0.03)


def test_progress_is_told():
    _, told = measured()
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert all(done <= total for done, total in told)


def test_a_vehicle_that_stands_does_not_show_a_delay():
    with pytest.raises(LogError, match=r"^x\.bin: its motion does not show the delay of fixes"):
        delay.measure(fly("static", 35.0, IMU), SETTINGS, "x.bin")


def test_a_log_that_cannot_serve_is_named_with_the_reason():
    flown = fly("figure-eight", 60.0)
    with pytest.raises(LogError, match="holds no GNSS fix"):
        delay.measure(without(flown, Kind.GNSS), SETTINGS)
    with pytest.raises(LogError, match="holds no inertial samples"):
        delay.measure(without(flown, Kind.IMU), SETTINGS)
    with pytest.raises(LogError, match="no position could be estimated"):
        delay.measure(without(fly("hover", 40.0), Kind.MAG), SETTINGS)
    with pytest.raises(LogError, match=r"only 1\d s with a position; the delay needs 20 s"):
        delay.measure(fly("figure-eight", 25.0), SETTINGS)
    events = flown.events
    imu = np.flatnonzero(events.kind == Kind.IMU)
    kept = np.ones(len(events), dtype=bool)
    kept[imu] = np.arange(len(imu)) % 10 == 0
    with pytest.raises(LogError, match=r"come at 5\.0 Hz, below the 20 Hz"):
        delay.measure(replace(flown, events=events.take(kept)), SETTINGS)


def test_the_keys_say_the_delay_and_how_sure_it_is():
    found, _ = measured()
    keys = {one.key: one for one in delay.result(found).settings}
    assert keys["gnss.delay"].value == pytest.approx(0.12, abs=0.005)
    assert keys["gnss.delay"].comment.startswith("s; 95 %: 0.1")
    assert 0.002 <= keys["gnss.delay_std"].value <= 0.005


@pytest.mark.parametrize(
    ("name", "late", "near", "part"),
    [
        ("sitl-arducopter-bin/flight.bin", 0.085, 0.005, (60.0, 130.0)),
        pytest.param(
            *("sitl-arducopter-square/flight.tlog", 0.085, 0.005, (0.0, 50.0)),
            marks=pytest.mark.campaign,
        ),
        # as the log declares it
        ("px4-ulg-x500-mission/x500_mission_2023.ulg", 0.110, 0.03, (0.0, 50.0)),
    ],
)
def test_a_recorded_flight_shows_its_delay(flight, name, late, near, part):
    from ekf_companion.replay.read import read

    recording = read(flight(name), Config())
    t = (recording.events.t_ns - recording.events.t_ns.min()) * 1e-9
    flown = recording.events.take((t >= part[0]) & (t < part[1]))
    found = delay.measure(replace(recording, events=flown), Config())
    assert found.best == pytest.approx(late, abs=near)
    assert found.low <= late <= found.high
