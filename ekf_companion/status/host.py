"""Read memory and temperatures from the kernel; it may block, so it is never called in the loop."""

from __future__ import annotations

import resource
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

_SYS = Path("/sys/class")
_STATM = Path("/proc/self/statm")
_PAGE = resource.getpagesize()
_MEBI = 1 << 20
MOST_TEMPERATURES = 32
"""Reported at most: some boards have one sensor for each core."""
_COLDEST, _HOTTEST = -60.0, 200.0
"""Beyond these, degC, a sensor is switched off or broken."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """Memory of this process, and temperatures of the computer that it runs on."""

    rss_mb: float = 0.0
    """Resident memory of this process, MiB."""
    temperatures: Mapping[str, float] = field(default_factory=dict)
    """degC, by the sensor's name."""


def read_host(sys: Path = _SYS) -> Host:
    """Read memory and temperatures; leave out what the computer does not report.

    ``sys`` is the folder that holds ``thermal`` and ``hwmon``.

    Source: Linux, Documentation/ABI/testing/sysfs-class-thermal and sysfs-class-hwmon.
    """
    temperatures: dict[str, float] = {}
    for zone in sorted(sys.glob("thermal/thermal_zone*")):
        _add(temperatures, zone / "type", zone / "temp")
    for monitor in sorted(sys.glob("hwmon/hwmon*")):
        for reading in sorted(monitor.glob("temp*_input")):
            label = reading.with_name(reading.name.replace("_input", "_label"))
            _add(temperatures, label if label.exists() else monitor / "name", reading)
    return Host(rss_mb=_rss_mb(), temperatures=temperatures)


def _add(temperatures: dict[str, float], name: Path, reading: Path) -> None:
    """Add the temperature of one sensor; of two with one name the second gets a number."""
    try:
        celsius = int(reading.read_text()) * 1e-3
        label = name.read_text(errors="replace").strip()
    except (OSError, ValueError):
        return
    if len(temperatures) >= MOST_TEMPERATURES or not _COLDEST < celsius < _HOTTEST:
        return
    label, number = label or reading.parent.name, 2
    key = label
    while key in temperatures:
        key, number = f"{label} {number}", number + 1
    temperatures[key] = celsius


def _rss_mb() -> float:
    try:
        pages = int(_STATM.read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * _PAGE / _MEBI
