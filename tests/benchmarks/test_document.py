"""Tables between the marks of a document."""

import pytest

from benchmarks import campaign
from benchmarks.accuracy import __main__ as accuracy
from benchmarks.accuracy import compassless
from benchmarks.document import main
from benchmarks.truth.__main__ import MARKS
from tests.paths import ROOT


def test_each_table_has_its_place_in_one_page():
    pages = [page.read_text("utf-8") for page in (ROOT / "docs" / "accuracy").glob("*.md")]
    for name in (*accuracy.PARTS, *MARKS):
        assert sum(f"<!-- {name} -->\n" in page for page in pages) == 1, name


def test_a_campaign_goes_between_its_marks_in_a_folder(monkeypatch, tmp_path):
    document = tmp_path / "doc.md"
    document.write_text("a\n<!-- compassless -->\nold\n<!-- end -->\nb\n", encoding="utf-8")
    command = ["accuracy", "--data", str(tmp_path), "--only", "compassless", "--runs", "1"]
    monkeypatch.setattr("sys.argv", [*command, "--write", str(tmp_path)])
    monkeypatch.setattr(campaign, "PROCESSES", 1)
    monkeypatch.setattr(compassless, "DURATION", 40.0)
    main("Make tables.", accuracy.PARTS)
    text = document.read_text(encoding="utf-8")
    assert text.count("| no compass at all | ") == 4
    assert "old" not in text
    assert text.startswith("a\n<!-- compassless -->\n| compass | flight |")
    assert text.endswith("<!-- end -->\nb\n")


def test_what_needs_absent_logs_is_named_and_leaves_the_document_alone(
    monkeypatch, tmp_path, capsys
):
    document = tmp_path / "doc.md"
    before = "<!-- truth -->\nold\n<!-- end -->\n"
    document.write_text(before, encoding="utf-8")
    command = ["accuracy", "--data", str(tmp_path / "none"), "--only", "truth"]
    monkeypatch.setattr("sys.argv", [*command, "--write", str(document)])
    main("Make tables.", accuracy.PARTS)
    assert document.read_text(encoding="utf-8") == before
    assert "name their folder with --data" in capsys.readouterr().out


def test_an_unknown_part_is_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["accuracy", "--only", "compasless"])
    with pytest.raises(SystemExit):
        main("Make tables.", accuracy.PARTS)
    assert "compasless" in capsys.readouterr().err
