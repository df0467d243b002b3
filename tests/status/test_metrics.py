"""The Snapshot as Prometheus reads it."""

import math
import re
from dataclasses import is_dataclass, replace
from typing import get_type_hints

import pytest
from prometheus_client import generate_latest
from prometheus_client.openmetrics.exposition import generate_latest as generate_open
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_open
from prometheus_client.parser import text_string_to_metric_families as parse

from ekf_companion.engine.health import Aid, Arrival, Verdict
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status
from ekf_companion.status.metrics import PREFIX, declared, families, registry_of, types_in
from ekf_companion.status.snapshot import Snapshot
from tests.paths import ROOT
from tests.reference import texts_of
from tests.status.test_observer import Watched

MANUAL = (ROOT / "docs" / "OBSERVABILITY.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def snapshot():
    return Watched().fly(8.0).snapshot()


@pytest.fixture(scope="module")
def samples(snapshot):
    text = generate_latest(registry_of(snapshot)).decode()
    return read(text)


def read(text):
    """Return value by name, without the prefix, and labels."""
    return {
        (sample.name.removeprefix(PREFIX), *sorted(sample.labels.items())): sample.value
        for family in parse(text)
        for sample in family.samples
    }


def test_every_name_keeps_to_the_conventions(snapshot):
    """Rule 40: /metrics."""
    names = [family.name for family in families(snapshot)]
    assert len(names) == len(set(names)) > 40
    for family in families(snapshot):
        assert re.fullmatch(r"ekf_companion_[a-z]+(_[a-z]+)*", family.name)
        assert family.documentation.endswith(".")
        for sample in family.samples:
            assert sample.name.endswith("_total") == (family.type == "counter")


def test_it_is_open_metrics_too(snapshot):
    text = generate_open(registry_of(snapshot)).decode()
    told = {family.name for family in parse_open(text)}
    assert told == {family.name for family in families(snapshot) if family.samples}


def test_every_stage_is_told_as_the_snapshot_has_it(snapshot, samples):
    assert samples["link_received_bytes_total",] == snapshot.link.bytes_in
    assert samples["frames_total",] == snapshot.frames.frames
    count = snapshot.messages["HIGHRES_IMU"].count
    assert samples["messages_received_total", ("message", "HIGHRES_IMU")] == count
    rate = samples["message_rate_hertz", ("message", "HIGHRES_IMU")]
    assert rate == pytest.approx(250.0, rel=0.02)
    health = snapshot.estimator
    fused = samples["corrections_total", ("aid", "position"), ("verdict", "fused")]
    assert fused == health.verdicts[Aid.POSITION][Verdict.FUSED] > 0
    arrived = sum(value for key, value in samples.items() if ("sensor", "imu") in key)
    assert arrived == sum(health.arrivals[Kind.IMU].values())
    assert samples["nis", ("aid", "position")] == health.nis[Aid.POSITION]
    assert samples["odometry_streaming",] == 1.0
    assert samples["messages_sent_total", ("message", "ODOMETRY")] > 100


def test_what_the_services_learnt_is_told(snapshot, samples):
    assert samples["odometry_allowed",] == 1.0
    assert samples["odometry_rate_hertz",] == snapshot.output.rate == pytest.approx(30.0, rel=0.05)
    assert samples["guard_parameter", ("parameter", "EKF2_GPS_CTRL")] == 7.0
    assert samples["timesync_residual_seconds",] == snapshot.time.residual_us * 1e-6
    source = ("inertial_source_info", ("instance", "0"), ("message", "HIGHRES_IMU"))
    assert samples[source] == 1.0
    assert samples["reloads_total",] == 0.0
    message = replace(snapshot.messages["HIGHRES_IMU"], cause="the link is full")
    told = replace(snapshot, messages={"HIGHRES_IMU": message}, tuned={"baro.use": False})
    changed = read(generate_latest(registry_of(told)).decode())
    assert changed["message_in_vain", ("message", "HIGHRES_IMU")] == 1.0
    assert changed["tuned", ("key", "baro.use"), ("value", "False")] == 1.0


def test_one_status_holds(samples):
    held = {key[1][1]: value for key, value in samples.items() if key[0] == "status"}
    assert held.pop("ok") == 1.0
    assert set(held.values()) == {0.0}
    assert len(held) == 6


def test_the_latency_is_a_histogram_in_seconds(snapshot, samples):
    process = snapshot.process
    buckets = {
        float(key[1][1]): value
        for key, value in samples.items()
        if key[0] == "odometry_latency_seconds_bucket"
    }
    bounds = sorted(buckets)
    assert bounds[:3] == [0.0001, 0.0002, 0.0003]
    assert math.isinf(bounds[-1])
    counts = [buckets[bound] for bound in bounds]
    assert counts == sorted(counts)
    assert buckets[math.inf] == samples["odometry_latency_seconds_count",] == process.latency_count
    assert buckets[0.0003] == process.latency[0.3]
    total = samples["odometry_latency_seconds_sum",]
    assert total == pytest.approx(process.latency_sum_ms * 1e-3)


def test_what_is_not_known_has_no_row(snapshot, samples):
    unheard = Watched().snapshot()
    assert math.isnan(unheard.time.offset_s)
    assert ("clock_offset_seconds",) not in read(generate_latest(registry_of(unheard)).decode())
    assert samples["clock_offset_seconds",] == snapshot.time.offset_s
    assert not any(math.isnan(value) for value in samples.values())


def test_words_from_the_air_are_quoted(snapshot):
    odd = 'a"b\\c\nd 1.0'
    told = replace(snapshot, refused={f"HIGHRES_IMU: {odd}": 3})
    samples = read(generate_latest(registry_of(told)).decode())
    key = ("messages_refused_total", ("message", "HIGHRES_IMU"), ("reason", odd))
    assert samples[key] == 3.0


def test_before_anything_is_heard_there_are_metrics_too():
    samples = read(generate_latest(registry_of(Watched().snapshot())).decode())
    assert samples["status", ("status", "init")] == 1.0
    assert samples["autopilot_heard",] == 0.0
    assert ("inertial_samples_total",) not in samples


def test_others_may_go_first_between_two_families(snapshot):
    breaths = []
    generate_latest(registry_of(snapshot, lambda: breaths.append(1)))
    assert len(breaths) > 40


def test_every_field_of_the_status_is_explained_in_the_source():
    """Rule 40: /metrics."""
    with_help = {path for _, path in declared()}
    assert not set(unexplained(Snapshot)) - with_help


def unexplained(kind, path=()):
    """Yield the path of each field that has no text below it and is no stage of its own."""
    texts = texts_of(kind)
    for name, hint in get_type_hints(kind).items():
        stages = [inner for inner in types_in(hint) if is_dataclass(inner)]
        if not (stages or texts.get(name)):
            yield (*path, name)
        for stage in stages:
            yield from unexplained(stage, (*path, name))


def test_the_manual_names_every_value_of_a_label():
    for word in (*Status, *Arrival, *Verdict):
        assert f"`{word.name.lower()}`" in MANUAL


def test_the_manual_s_alerts_use_metrics_that_there_are(snapshot):
    names = {family.name.removesuffix("_total") for family in families(snapshot)}
    used = set(re.findall(rf"{PREFIX}[a-z]\w*", MANUAL))
    assert len(used) > 10
    assert {name.removesuffix("_total").removesuffix("_bucket") for name in used} <= names
