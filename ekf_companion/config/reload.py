"""Which parts of a changed configuration a reload applies in flight: rates, gates and noise.

All else changes the meaning of the state, the link or the files; it is listed as refused, and
applies at the next start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ekf_companion.config.config import Config
from ekf_companion.config.keys import KEYS, value_of, with_value


@dataclass(frozen=True, slots=True)
class Reload:
    """The result of a reload."""

    config: Config
    """The configuration now in force."""
    taken: dict[str, tuple[Any, Any]]
    """Old and new value of each key that was applied."""
    refused: dict[str, tuple[Any, Any]]
    """Old value, which stays in force, and new value of each key that needs a restart."""

    def __str__(self) -> str:
        """Return a sentence for each part."""
        taken = ", ".join(f"{key}: {old} -> {new}" for key, (old, new) in self.taken.items())
        sentence = f"Taken: {taken}" if taken else "Nothing to take"
        if self.refused:
            sentence += f"; only at the next start: {', '.join(self.refused)}"
        return sentence


def reload(old: Config, new: Config) -> Reload:
    """Apply those changes of a configuration that can be applied in flight."""
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
