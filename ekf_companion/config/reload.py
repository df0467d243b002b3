"""What of a changed configuration can be taken in flight: rates, gates and noise.

The rest decides what the state means, whom we speak to or where files are; it is refused by name,
and waits for a restart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from ekf_companion.config.config import Config

SAFE = frozenset(
    {
        *(f"link.{name}_rate" for name in ("imu", "gnss", "heading", "baro")),
        *("timesync.request", "timesync.respond", "timesync.largest_rtt"),
        *("output.odometry.rate", "output.odometry.mode", "output.odometry.independent"),
        *("imu.gyro_noise", "imu.accel_noise", "imu.gyro_bias_walk", "imu.accel_bias_walk"),
        "imu.learn_noise",
        *(f"gnss.{name}" for name in ("source", "use_velocity", "white_share", "slow_time")),
        *(f"gnss.{name}_std" for name in ("timing", "position", "height", "velocity")),
        *("gnss.velocity_slow_std", "gnss.velocity_slow_time", "gnss.velocity_std_unknown"),
        *(f"heading.{name}" for name in ("source", "heading_std", "slow_time")),
        *(f"heading.magnetometer_{name}" for name in ("std", "noise")),
        *("heading.hard_iron_walk", "heading.field_strength", "heading.field_dip"),
        *("baro.use", "baro.std", "baro.walk"),
        *("align.use_rest", "align.rest_gyro", "align.rest_accel"),
        *("gate.probability", "gate.soft_probability", "gate.limit_position"),
        *(f"gate.timeout_{name}" for name in ("position", "velocity", "height", "heading")),
    }
)
"""Keys that are taken while flying."""


@dataclass(frozen=True, slots=True)
class Reload:
    """What became of a changed configuration."""

    config: Config
    """To go on with."""
    taken: dict[str, tuple[Any, Any]]
    """Old and new value by key."""
    refused: dict[str, tuple[Any, Any]]
    """Old value, which stays, and the one that a restart would take."""

    def __str__(self) -> str:
        """Say it in a sentence for each part."""
        taken = ", ".join(f"{key}: {old} -> {new}" for key, (old, new) in self.taken.items())
        words = f"Taken: {taken}" if taken else "Nothing to take"
        if self.refused:
            words += f"; only at the next start: {', '.join(self.refused)}"
        return words


def reload(old: Config, new: Config) -> Reload:
    """Take from a new configuration what is safe."""
    changes = {key: values for key, *values in _differences(old, new)}
    taken = {key: (values[0], values[1]) for key, values in changes.items() if key in SAFE}
    refused = {key: (values[0], values[1]) for key, values in changes.items() if key not in SAFE}
    config = old
    for key, (_, value) in taken.items():
        config = with_value(config, key, value)
    return Reload(config, taken, refused)


def with_value(config: Config, key: str, value: object) -> Config:
    """Give a configuration that differs in one dotted key."""
    changed: Config = _with(config, key.split("."), value)
    return changed


def _with(section: Any, path: list[str], value: object) -> Any:
    head, *rest = path
    if rest:
        value = _with(getattr(section, head), rest, value)
    return replace(section, **{head: value})


def _differences(old: Any, new: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    for entry in fields(old):
        before, after = getattr(old, entry.name), getattr(new, entry.name)
        if is_dataclass(before):
            yield from _differences(before, after, f"{path}{entry.name}.")
        elif before != after:
            yield path + entry.name, before, after
