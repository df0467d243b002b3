"""What a wheel holds."""

import re

from tests.paths import ROOT


def test_every_package_is_in_the_wheel():
    text = (ROOT / "pyproject.toml").read_text()
    listed = re.search(r"\[tool\.setuptools\]\npackages = \[(.*?)\]", text, re.DOTALL)[1]
    folders = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for top in ("ekf_companion", "sim_autopilot")
        for path in (ROOT / top).rglob("__init__.py")
    }
    assert set(re.findall(r'"([^"]+)"', listed)) == folders
