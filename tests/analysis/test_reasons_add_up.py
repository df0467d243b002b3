"""Why an estimate is not ok: the same seconds and the same words wherever they are told."""

import csv
import json
import re

import numpy as np
import pyarrow.parquet as parquet
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from ekf_companion.analysis.flight_review import review
from ekf_companion.analysis.log_view import to_json
from ekf_companion.analysis.report_tables import band_words
from ekf_companion.cli import app
from ekf_companion.config.config import Config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.buffer import EventBuffer
from ekf_companion.nav.reason import LONGEST_STEP, WORDS, foremost, from_names, to_seconds
from ekf_companion.nav.state import COLUMNS, Reason, Status, Table
from ekf_companion.replay.read import read
from ekf_companion.review.report import Report, add_block
from ekf_companion.status.status_time import StatusTime
from tests.rows import CONFIG, Rows, write

FLIGHT = Rows.plan()
DOUBTFUL = (Status.DEGRADED, Status.DEAD_RECKONING, Status.INVALID)


def without_fixes(rows):
    rows.fix_type[(rows.fix_since > 15.0) & (rows.fix_since < 40.0)] = 0


def dragged(rows):
    since = np.clip(rows.fix_since - 20.0, 0.0, 20.0)
    rows.fix[:, 0] += np.degrees(3.0 * since / 6.37e6)


def leapt(rows):
    rows.fix[(rows.fix_since > 20.0) & (rows.fix_since < 35.0), 0] += np.degrees(60.0 / 6.37e6)


def with_a_drifting_barometer(rows):
    rows.baro += np.clip((rows.baro_ns - rows.baro_ns[0]) * 1e-9 - 15.0, 0.0, 30.0)


def without_samples_for_a_while(rows):
    rows.keep_samples((rows.since < 20.0) | (rows.since > 23.0))


def without_samples_for_long(rows):
    rows.keep_samples((rows.since < 20.0) | (rows.since > 27.0))


def with_a_compass_that_ends(rows):
    rows.mag[rows.mag_ns > rows.mag_ns[0] + 20_000_000_000] = 0.0


def with_slow_samples(rows):
    rows.keep_samples(np.arange(len(rows.imu_ns)) % 10 == 0)


def all_at_once(rows):
    for change in (leapt, with_a_drifting_barometer, without_samples_for_a_while):
        change(rows)


CHANGES = [
    lambda rows: None,
    without_fixes,
    dragged,
    leapt,
    with_a_drifting_barometer,
    without_samples_for_a_while,
    without_samples_for_long,
    with_a_compass_that_ends,
    with_slow_samples,
    all_at_once,
]


@pytest.fixture(scope="module", params=CHANGES, ids=lambda one: one.__name__.strip("<>"))
def log(request, tmp_path_factory):
    rows = FLIGHT.copy()
    request.param(rows)
    kind = ("bin", "ulg", "csv", "HIGHRES_IMU")[CHANGES.index(request.param) % 4]
    return write(rows, kind, tmp_path_factory.mktemp("logs"))


def convert(log, *outs):
    words = ["convert", str(log), *(word for out in outs for word in ("-o", str(out)))]
    return CliRunner().invoke(app, words).stdout, json.loads(
        CliRunner().invoke(app, [*words, "--json"]).stdout
    )


def clause(by_reason):
    """Return the clause that a list of seconds by reason makes, as words and seconds."""
    return {words: float(spent) for words, spent in re.findall(r"([^;:]+?) ([\d.]+) s", by_reason)}


def test_the_reasons_add_up_to_the_seconds_of_a_status_wherever_they_are_told(log, tmp_path):
    said, found = convert(log, tmp_path / "out.csv")
    seen = review(log, Config())
    whole = seen.to_dict()
    assert whole["seconds"] == pytest.approx(found["seconds"])
    assert sum(found["seconds"].values()) == pytest.approx(seen.duration)
    for status in DOUBTFUL:
        name, spent = status.name.lower(), found["seconds"].get(status.name.lower(), 0.0)
        by_reason = found["seconds_by_reason"].get(name, {})
        assert sum(by_reason.values()) == pytest.approx(spent)
        # Summary
        line = re.search(rf"^  {status.words}: (.*)$", said, re.MULTILINE)
        words = clause(line[1].replace("\n", " ")) if line else {}
        expected = {WORDS[Reason[one.upper()]]: s for one, s in by_reason.items()}
        assert {one.strip() for one in words} == {*expected}
        # Report
        bands = [one for one in seen.bands if one.status is status]
        assert [one.seconds for one in bands[:1]] == ([pytest.approx(spent)] if spent else [])
        shown = {one.name.partition(": ")[2]: one.seconds for one in bands[1:]}
        assert shown == pytest.approx(expected)
        for one in bands:
            assert f"{one.name}, {to_seconds(one.seconds)}" in band_words(seen.bands)
            drawn = sum(end - begin for begin, end in one.spans_ns) * 1e-9
            # What is drawn begins and ends at an estimate, and stops at a gap
            assert drawn == pytest.approx(one.seconds, abs=LONGEST_STEP + 0.2 * len(one.spans_ns))


def test_the_column_and_the_view_name_the_reasons_of_the_summary(log, tmp_path):
    outs = [tmp_path / f"out.{suffix}" for suffix in ("csv", "parquet", "mcap")]
    _, found = convert(log, *outs)
    with outs[0].open() as file:
        rows = [*csv.DictReader(file)]
    names = [one["reasons"] for one in rows]
    assert names == parquet.read_table(outs[1])["reasons"].to_pylist()
    with outs[2].open("rb") as file:
        told = [json.loads(m.data) for _, _, m in make_reader(file).iter_messages()]
    in_mcap = [one["reasons"] for one in told if "reasons" in one]
    assert {*in_mcap} == {*names}
    lines = " ".join(one["message"] for one in told if "message" in one)
    by_row: dict[tuple[str, str], float] = {}
    t_s = np.array([float(one["time_us"]) * 1e-6 for one in rows])
    for row, step in zip(rows[1:], np.diff(t_s), strict=True):
        key = row["status"], foremost(from_names(row["reasons"])).name
        by_row[key] = by_row.get(key, 0.0) + (step if 0.0 < step <= LONGEST_STEP else 0.0)
    for status, by_reason in found["seconds_by_reason"].items():
        for one, spent in by_reason.items():
            assert by_row[status, one.upper()] == pytest.approx(spent, abs=1e-3)
            assert WORDS[Reason[one.upper()]] in lines
    events = [one["text"] for one in json.loads(to_json(review(log, Config())))["events"]]
    for text in events:
        if (now := re.match(r"Estimate is (\w+), was \w+", text)) and Status[now[1]] in DOUBTFUL:
            assert text.rpartition(": ")[2] in WORDS.values()


def test_the_reasons_of_a_live_run_add_up_and_are_those_of_its_replay(log):
    recording = read(log, CONFIG)
    pipeline = Pipeline(CONFIG, recording.family, recording.gnss_delay)
    time, last_ns = StatusTime(), 0
    events = recording.events.take(np.arange(len(recording.events)))
    columns = events.t_ns.tolist(), events.kind.tolist(), map(tuple, events.values.tolist())
    for row in zip(*columns, strict=True):
        if pipeline.process_row(row) is not None and pipeline.stamp_ns - last_ns > 400_000_000:
            last_ns = pipeline.stamp_ns
            time.update(pipeline)
    for status, by_reason in time.by_name().items():
        if Status[status.upper()] in DOUBTFUL:
            assert "" not in by_reason
            assert {*by_reason} <= {one.name.lower() for one in WORDS}


def test_the_time_from_one_block_of_a_log_to_the_next_counts():
    values = np.zeros((1000, len(COLUMNS) - 1))
    values[:, COLUMNS.index("status") - 1] = Status.DEGRADED
    values[:, COLUMNS.index("reasons") - 1] = Reason.SLIDE
    t_ns, found = np.arange(1000) * 50_000_000, Report(log="x")
    for rows in np.split(np.arange(1000), [1, 2, 40, 700]):
        table = Table(stamp_ns=t_ns[rows], values=values[rows])
        add_block(found, EventBuffer(1).take(), table)
    assert found.seconds == {Status.DEGRADED: pytest.approx(999 * 0.05)}
    assert found.reasons[Status.DEGRADED] == {Reason.SLIDE: pytest.approx(999 * 0.05)}
