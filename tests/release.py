"""What a release says of itself: ``python -m tests.release check [TAG]``, ``... notes``.

``check`` ends with exit code 1 where the places that name the version differ from each other, from
the tag, or where a tagged version is not dated in CHANGELOG.md. ``notes`` prints its section.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator

from ekf_companion.version import __version__
from tests.paths import ROOT

PLACES = {
    "pyproject.toml": r'^version = "(.+)"$',
    "systemd/Containerfile": r"^ARG VERSION=(.+)$",
    "systemd/share/man/man1/ekf-companion.1": r'^\.TH .* "ekf\\-companion (.+)"$',
}
"""Files that name the version beside ekf_companion/version.py, and how."""
SCHEME = r"\d+\.\d+\.\d+(?:(?:a|b|rc)\d+)?"
"""Of a version: semantic; of one before a release, as PEP 440 spells it."""
_HEADING = r"^## \[{version}\] - (unreleased|\d{{4}}-\d\d-\d\d)$"


def section(changelog: str, version: str) -> tuple[str, str]:
    """Return the date of a version in a changelog, and its text.

    Raises:
        ValueError: It has none.
    """
    heading = re.search(_HEADING.format(version=re.escape(version)), changelog, re.MULTILINE)
    if heading is None:
        raise ValueError(f"CHANGELOG.md: has no section ## [{version}] - DATE; write one")
    rest = changelog[heading.end() :]
    end = re.search(r"^## ", rest, re.MULTILINE)
    return heading[1], rest[: end.start() if end else None].strip() + "\n"


def faults(version: str, texts: dict[str, str], changelog: str, tag: str) -> Iterator[str]:
    """Yield what is wrong with a release, a sentence each.

    Args:
        version: That of the package.
        texts: Contents of the files of ``PLACES``.
        changelog: Content of CHANGELOG.md.
        tag: The tag that is released; empty: none.
    """
    if not re.fullmatch(SCHEME, version):
        yield f"ekf_companion/version.py: {version}: is no version; write 1.2.3, or 1.2.3rc1"
    for name, pattern in PLACES.items():
        found = re.search(pattern, texts[name], re.MULTILINE)
        if found is None or found[1] != version:
            yield f"{name}: names {found[1] if found else 'no version'}, not {version}"
    try:
        date, _ = section(changelog, version)
    except ValueError as error:
        yield str(error)
        return
    if tag and tag != f"v{version}":
        yield f"the tag is {tag}, and the version {version}; tag v{version}"
    if tag and date == "unreleased":
        yield f"CHANGELOG.md: {version} is unreleased; write its date before it is tagged"


def main(arguments: list[str]) -> int:
    """Do what the command line asks for; return the exit code."""
    changelog = (ROOT / "CHANGELOG.md").read_text()
    if arguments[:1] == ["notes"]:
        sys.stdout.write(section(changelog, __version__)[1])
        return 0
    texts = {name: (ROOT / name).read_text() for name in PLACES}
    tag = arguments[1] if len(arguments) > 1 else ""
    found = list(faults(__version__, texts, changelog, tag))
    sys.stderr.writelines(f"{fault}\n" for fault in found)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
