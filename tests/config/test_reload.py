"""A configuration changed in flight."""

import numpy as np
import pytest

from ekf_companion.config.config import Config, parse_config
from ekf_companion.config.keys import KEYS, with_value
from ekf_companion.config.reload import reload
from ekf_companion.core.settings.settings import FilterSettings, GateSettings, ImuSettings
from ekf_companion.engine.pipeline import Pipeline
from sim_autopilot.config import SimConfig
from sim_autopilot.events import events
from sim_autopilot.flight import Flight


def parsed(**sections):
    return parse_config(sections, "new.yaml")


def test_what_decides_on_the_state_the_link_or_files_waits_for_a_restart():
    waiting = {name for name, key in KEYS.items() if not key.setting.reload}
    assert {name.partition(".")[0] for name in waiting} == {
        *("link", "signing", "output", "parameters", "record", "checkpoint", "http", "live"),
        *("imu", "gnss", "heading", "align", "window", "weigh_faults", "airspeed", "wheel"),
        *("optical_flow", "anchor_range", "visual_odometry", "visual_velocity"),
    }
    assert {name for name in waiting if name.startswith(("output", "align"))} == {
        *(
            "output.odometry.message",
            "output.odometry.frame",
            "output.odometry.covariance",
            "output.odometry.climb_time",
            "output.odometry.estimator_type",
            "output.monitors",
            "output.monitor_system_id",
        ),
        "align.time",
    }
    assert not any(name.endswith(("_walk", "_noise", "_rate")) for name in waiting)


def test_rates_gates_and_noise_are_taken_and_the_rest_is_refused_by_name():
    new = parsed(
        link={"imu_rate": 100.0, "url": "udpin:0.0.0.0:1", "component_id": 191},
        output={"odometry": {"rate": 50.0, "frame": "LOCAL_NED"}},
        imu={"gyro_noise": 1e-3, "lag": 0.01},
        gate={"probability": 0.99},
    )
    found = reload(Config(), new)
    assert set(found.taken) == {
        *("link.imu_rate", "output.odometry.rate", "imu.gyro_noise", "gate.probability")
    }
    assert set(found.refused) == {
        *(
            "link.url",
            "link.component_id",
            "output.odometry.frame",
            "imu.lag",
        )
    }
    assert found.config.link.imu_rate == 100.0
    assert found.config.link.url == Config().link.url
    assert found.config.imu == ImuSettings(gyro_noise=1e-3)
    for key in ("gate.probability: 0.999999 -> 0.99", "only at the next start: imu.lag, link.url"):
        assert key in str(found)


def test_nothing_new_is_nothing_to_take():
    found = reload(Config(), Config())
    assert (found.taken, found.refused, found.config) == ({}, {}, Config())


def test_one_key_is_changed_and_the_rest_is_as_it_was():
    changed = with_value(Config(), "output.odometry.rate", 10.0)
    assert changed.output.odometry.rate == 10.0
    assert reload(changed, Config()).taken == {"output.odometry.rate": (10.0, 30.0)}


@pytest.fixture(scope="module")
def flown():
    flight = Flight.plan("figure-eight", SimConfig(), duration=30.0)
    table = events(flight)
    return list(zip(table.t_ns.tolist(), table.kind.tolist(), table.values.tolist(), strict=True))


def fly(rows, settings, change=None, at=0.5):
    """Return an estimate per inertial sample; in the middle, other settings."""
    pipeline, estimates = Pipeline(settings), []
    for count, row in enumerate(rows):
        if change is not None and count == round(at * len(rows)):
            pipeline.retune(change)
        if (estimate := pipeline.process_row(row)) is not None:
            estimates.append(estimate.values)
    return np.array(estimates), pipeline


def test_the_same_settings_again_change_no_bit(flown):
    plain, _ = fly(flown, FilterSettings())
    again, _ = fly(flown, FilterSettings(), FilterSettings())
    assert plain.tobytes() == again.tobytes()


def test_no_sample_is_lost_and_what_changes_changes_from_there_on(flown):
    other = FilterSettings(gate=GateSettings(probability=0.6, soft_probability=0.55))
    plain, before = fly(flown, FilterSettings())
    changed, after = fly(flown, FilterSettings(), other)
    half = len(plain) // 2
    assert changed.shape == plain.shape
    # What a late event made run again lies within the window
    assert plain[: half - 500].tobytes() == changed[: half - 500].tobytes()
    assert plain[half + 500 :].tobytes() != changed[half + 500 :].tobytes()
    refused = [sum(p.health().verdicts[aid][1] for aid in (0, 1, 2)) for p in (before, after)]
    assert refused[1] > refused[0]
    assert after.fingerprint != before.fingerprint
