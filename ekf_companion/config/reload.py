"""What of a changed configuration a reload takes in flight: rates, gates and noise.

The rest decides what the state means, whom we speak to or where files are; it is refused by name,
and waits for a restart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ekf_companion.config.config import Config
from ekf_companion.config.keys import KEYS, value_of, with_value


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
        """Return a sentence for each part."""
        taken = ", ".join(f"{key}: {old} -> {new}" for key, (old, new) in self.taken.items())
        sentence = f"Taken: {taken}" if taken else "Nothing to take"
        if self.refused:
            sentence += f"; only at the next start: {', '.join(self.refused)}"
        return sentence


def reload(old: Config, new: Config) -> Reload:
    """Take from a new configuration what a flight can take."""
    config = old
    taken: dict[str, tuple[Any, Any]] = {}
    refused: dict[str, tuple[Any, Any]] = {}
    for name, key in KEYS.items():
        values = value_of(old, name), value_of(new, name)
        if values[0] == values[1]:
            continue
        if key.setting.reload:
            taken[name] = values
            config = with_value(config, name, values[1])
        else:
            refused[name] = values
    return Reload(config, taken, refused)
