"""What the kernel says of this process and of the board; may block, so never asked in the loop."""

from __future__ import annotations

import resource
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

_SYS = Path("/sys/class")
_STATM = Path("/proc/self/statm")
_PAGE = resource.getpagesize()
_MEBI = 1 << 20
SENSORS = 32
"""Temperatures that are told at most: some boards have one for each core."""
_COLDEST, _HOTTEST = -60.0, 200.0
"""Beyond, degC, a sensor is switched off or broken."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Memory and temperatures."""

    rss_mb: float = 0.0
    """Resident memory of this process, MiB."""
    temperatures: Mapping[str, float] = field(default_factory=dict)
    """degC, by the sensor's name."""


def read_board(sys: Path = _SYS) -> Board:
    """Read both; what the board does not tell is left out.

    Args:
        sys: Where ``thermal`` and ``hwmon`` are.

    Source: Linux, Documentation/ABI/testing/sysfs-class-thermal and sysfs-class-hwmon.
    """
    temperatures: dict[str, float] = {}
    for zone in sorted(sys.glob("thermal/thermal_zone*")):
        _note(temperatures, zone / "type", zone / "temp")
    for monitor in sorted(sys.glob("hwmon/hwmon*")):
        for reading in sorted(monitor.glob("temp*_input")):
            label = reading.with_name(reading.name.replace("_input", "_label"))
            _note(temperatures, label if label.exists() else monitor / "name", reading)
    return Board(rss_mb=_rss_mb(), temperatures=temperatures)


def _note(temperatures: dict[str, float], name: Path, reading: Path) -> None:
    """Add what one sensor says; of two with one name the second gets a number."""
    try:
        celsius = int(reading.read_text()) * 1e-3
        word = name.read_text(errors="replace").strip()
    except (OSError, ValueError):
        return
    if len(temperatures) >= SENSORS or not _COLDEST < celsius < _HOTTEST:
        return
    word, number = word or reading.parent.name, 2
    key = word
    while key in temperatures:
        key, number = f"{word} {number}", number + 1
    temperatures[key] = celsius


def _rss_mb() -> float:
    try:
        pages = int(_STATM.read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * _PAGE / _MEBI
