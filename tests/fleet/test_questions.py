"""What one asks of a fleet, on tables with a known answer; hostile ones."""

import csv
import json

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.fleet import dataset, page, questions, sql
from ekf_companion.fleet.dataset import Partition, write_log
from ekf_companion.fleet.load import load
from ekf_companion.fleet.row import COLUMNS
from ekf_companion.fleet.table import write

BUILDS = ("1.0-aaaaaaaa", "1.1-bbbbbbbb")


def row(number, rng, better=1.0, **more):
    known = {
        "log": f"logs/{number:03}.ulg",
        "outcome": "estimated",
        "grade": "good",
        "verdict": "good: no resets",
        "autopilot": "px4",
        "airframe": f"SYS_AUTOSTART {4001 + number % 2}",
        "degraded_s": 0.0,
        "resets": 0,
        "gyro_noise_rps": 0.002 * (1 + number % 2),
        "truth_horizontal_m": better * rng.uniform(0.5, 2.0),
        "truth_yaw_deg": rng.uniform(0.5, 2.0),
    }
    return {**dict.fromkeys(COLUMNS), **known, **more}


def fill(place, build, better=1.0, count=40):
    rng = np.random.default_rng(4)
    into = Partition(str(place), build, "0123456789abcdef")
    event = {**dict.fromkeys(dataset.EVENTS), "kind": "reset", "subject": "position", "count": 1}
    histogram = {
        **dict.fromkeys(dataset.HISTOGRAMS),
        **{"quantity": "gyro_noise", "low": -5.0, "high": 0.0, "counts": [1, 2], "mean": 0.1},
    }
    for number in range(count):
        one = row(number, rng, better)
        if number == 7:
            one |= {"grade": "poor", "verdict": "poor: <b>5 resets</b>", "resets": 5}
        write_log(into, one, number, f"{number:032}", [event] if number == 7 else (), [histogram])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    root = tmp_path_factory.mktemp("fleet")
    fill(root, BUILDS[0])
    fill(root, BUILDS[1], better=0.8)
    return root


def of(place, build, table="logs"):
    return load(str(place), table, BUILDS[build])


def ask(*words):
    result = CliRunner().invoke(app, ["fleet", *map(str, words)])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_worst_flight_comes_first(place):
    answer = questions.worst(of(place, 0), 3)
    assert [one[1] for one in answer.rows] == ["poor", "good", "good"]
    assert answer.rows[0][0] == "logs/007.ulg"
    assert answer.notes[0].startswith("40 flights: 39 good, ")
    assert (
        ask("worst", place, "--of", BUILDS[0], "--count", 1).splitlines()[1].startswith("logs/007")
    )


def test_noise_is_that_of_each_airframe(place):
    answer = questions.noise(of(place, 0), ["airframe"])
    assert [(one[0], one[1], one[2]) for one in answer.rows] == [
        ("SYS_AUTOSTART 4001", 20, 0.002),
        ("SYS_AUTOSTART 4002", 20, 0.004),
    ]
    with pytest.raises(ConfigError, match="is none of airframe"):
        questions.noise(of(place, 0), ["colour"])


def test_a_version_that_is_better_somewhere_is_found_and_nothing_else(place):
    answer = questions.compare(of(place, 0), of(place, 1))
    found = {one[0]: one for one in answer.rows}
    assert found["truth_horizontal_m"][1:5] == [40, 40, 0, 0]
    assert found["truth_horizontal_m"][-1] == "better"
    assert found["truth_horizontal_m"][-2] < 1e-6
    assert {one[-1] for name, one in found.items() if name != "truth_horizontal_m"} == {""}
    back = {one[0]: one[-1] for one in questions.compare(of(place, 1), of(place, 0)).rows}
    assert back["truth_horizontal_m"] == "worse"


def test_a_version_does_not_differ_from_itself(place):
    answer = questions.compare(of(place, 0), of(place, 0))
    assert all(one[1] == one[4] and one[-2:] == [1.0, ""] for one in answer.rows)


def test_chance_is_called_a_difference_in_no_more_than_one_of_twenty():
    rng, said = np.random.default_rng(1), 0
    for _ in range(200):
        two = [[row(n, rng, truth_yaw_deg=rng.normal(5, 1)) for n in range(30)] for _ in range(2)]
        before, after = (pa.Table.from_pylist([{**o, "content": ""} for o in one]) for one in two)
        said += any(one[-1] for one in questions.compare(before, after).rows)
    assert said <= 20  # 10 are expected; more than 20 come once in a thousand


def test_runs_without_a_log_in_common_are_not_compared(place):
    other = pa.Table.from_pylist([{**row(999, np.random.default_rng()), "content": "x"}])
    with pytest.raises(ConfigError, match="no log in common"):
        questions.compare(of(place, 0), other)


def test_the_command_compares_builds_and_tables_of_batch(place, tmp_path):
    text = ask("compare", place, BUILDS[0], BUILDS[1])
    assert "truth_horizontal_m" in text
    assert text.count("better") == 3  # the column's head, its word and the verdicts'
    old, out = tmp_path / "old.csv", tmp_path / "out.csv"
    write(old, of(place, 0).select(list(COLUMNS)).to_pylist())
    ask("compare", place, old, BUILDS[1], "-o", out)
    with out.open() as file:
        assert next(one["word"] for one in csv.DictReader(file)) == "better"


def test_sql_sees_the_tables_and_nothing_else(place, tmp_path):
    query = "SELECT airframe, count(*) AS n FROM logs GROUP BY 1 ORDER BY 1"
    found = json.loads(ask("sql", place, query, "--of", BUILDS[0], "--json"))["rows"]
    assert found == [{"airframe": f"SYS_AUTOSTART {n}", "n": 20} for n in (4001, 4002)]
    secret = tmp_path / "secret.csv"
    secret.write_text("a\n1\n")
    tables = {name: of(place, 0, name) for name in dataset.TABLES}
    for wrong in (
        f"SELECT * FROM '{secret}'",
        f"COPY logs TO '{tmp_path}/out.csv'",
        "INSTALL httpfs",
        "SET enable_external_access = true",
        "SELECT nothing FROM events",
        "x" * 10_000,
    ):
        with pytest.raises(ConfigError, match="sql: "):
            sql.run(wrong, tables.__getitem__)
    assert list(tmp_path.iterdir()) == [secret]


def test_the_page_shows_faults_and_escapes_what_logs_say(place, tmp_path):
    out = tmp_path / "fleet.html"
    (tmp_path / "007.ulg.html").write_text("its report")
    ask("report", place, "-o", out, "--of", BUILDS[0], "--reports", tmp_path)
    text = out.read_text()
    assert "&lt;b&gt;5 resets" in text
    assert "<b>" not in text
    assert "<script" not in text
    assert '<a href="007.ulg.html">logs/007.ulg</a>' in text
    assert "reset position<td>1" in text
    assert "gyro_noise: 1e-5 to 1e0, 120 values" in text


def test_an_export_has_the_same_bytes_each_time(place, tmp_path):
    for name in ("a.csv", "b.csv", "c.parquet"):
        ask("export", place, "-o", tmp_path / name, "--of", BUILDS[0])
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert load(str(tmp_path / "c.parquet")).equals(of(place, 0))
    assert load(str(tmp_path / "a.csv")).column("log").equals(of(place, 0).column("log"))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"", "is no table of batch"),
        ("a.csv", b"log,outcome\n", None),
        ("a.csv", b"x,y\n1,2\n", "it has no column log, outcome"),
        ("a.csv", b"log,outcome,resets\na,b,many\n", "is no table of batch"),
        ("a.csv", b"log,log,outcome\na,b,c\n", "columns come twice"),
        ("a.csv", b"\xff\xfe\x00log", "is no table of batch"),
        ("a.csv", b"log,outcome\na\n", "is no table of batch"),
        ("a.parquet", b"PAR1" + b"\x00" * 99 + b"PAR1", "is no table of batch"),
        ("a.parquet", b"", "is no table of batch"),
    ],
)
def test_a_hostile_table_is_a_sentence(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    if words is None:
        assert questions.worst(load(str(path))).rows == []
        return
    with pytest.raises(LogError, match=words):
        load(str(path))


def test_columns_of_other_types_are_a_sentence(tmp_path):
    path = tmp_path / "a.parquet"
    parquet.write_table(pa.table({"log": ["a"], "outcome": ["b"], "resets": [[1]]}), path)
    with pytest.raises(LogError, match="column resets is no int64"):
        load(str(path))


def test_texts_of_a_hostile_table_are_no_formulas(tmp_path):
    path, out = tmp_path / "a.parquet", tmp_path / "b.csv"
    parquet.write_table(pa.table({"log": ["=1+1"], "outcome": ["@x"]}), path)
    ask("export", path, "-o", out)
    with out.open() as file:
        (found,) = csv.DictReader(file)
    assert (found["log"], found["outcome"]) == ("./=1+1", "./@x")


def test_the_page_of_nothing_is_a_page(tmp_path):
    tables = {name: dataset.schema(name).empty_table() for name in dataset.TABLES}
    page.write(tmp_path / "a.html", "none", tables)
    assert "0 flights" in (tmp_path / "a.html").read_text()
