"""What `make release` checks, and the notes that it writes."""

import pytest

from ekf_companion.version import __version__
from tests import release
from tests.paths import ROOT

CHANGELOG = """# Changelog

## [1.3.0] - unreleased

New.

## [1.2.10] - 2026-05-06

- Ten.

## [1.2.1] - 2026-01-02

- One.
"""


def texts(version):
    return {
        "pyproject.toml": f'[project]\nversion = "{version}"\n',
        "systemd/Containerfile": f"FROM a\nARG VERSION={version}\n",
        "systemd/share/man/man1/ekf-companion.1": (
            f'.TH EKF\\-COMPANION 1 "" "ekf\\-companion {version}"\n'
        ),
    }


def faults(version, tag="", changed=()):
    return list(release.faults(version, texts(version) | dict(changed), CHANGELOG, tag))


def test_this_checkout_names_one_version_and_has_notes():
    assert release.main(["check"]) == 0
    _, notes = release.section((ROOT / "CHANGELOG.md").read_text(), __version__)
    assert "Estimator" in notes
    assert "\n## " not in notes


def test_notes_are_those_of_one_version():
    assert release.section(CHANGELOG, "1.2.1") == ("2026-01-02", "- One.\n")
    assert release.section(CHANGELOG, "1.2.10") == ("2026-05-06", "- Ten.\n")


def test_a_dated_version_with_its_tag_is_right():
    assert faults("1.2.10", "v1.2.10") == []


@pytest.mark.parametrize("tag", ["1.2.10", "v1.2.1", "v1.2.10 ", "release-1.2.10", "V1.2.10"])
def test_another_tag_is_refused(tag):
    (found,) = faults("1.2.10", tag)
    assert "tag v1.2.10" in found


def test_an_unreleased_version_is_not_tagged():
    assert faults("1.3.0") == []
    (found,) = faults("1.3.0", "v1.3.0")
    assert "write its date" in found


def test_a_version_without_a_section_is_refused():
    (found,) = faults("1.4.0")
    assert "no section ## [1.4.0]" in found


@pytest.mark.parametrize("name", release.PLACES)
def test_a_place_with_another_version_is_named(name):
    (found,) = faults("1.2.10", changed={name: texts("1.2.1")[name]}.items())
    assert found == f"{name}: names 1.2.1, not 1.2.10"
    (found,) = faults("1.2.10", changed={name: "empty"}.items())
    assert found == f"{name}: names no version, not 1.2.10"


@pytest.mark.parametrize("version", ["1.2", "v1.2.10", "1.2.10-rc1", "1.2.10.dev0", "1.2.10 "])
def test_an_odd_version_is_refused(version):
    assert any("is no version" in found for found in faults(version))
