"""Every key of the configuration by its dotted name, with its field's metadata."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, is_dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ekf_companion.config.config import Config
from ekf_companion.core.settings.setting import Setting


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """One key of the configuration."""

    name: str
    """Dotted, as in ``output.odometry.rate``."""
    section: type
    """The dataclass that has the field."""
    hint: Any
    """The field's annotation."""
    setting: Setting

    @property
    def choices(self) -> tuple[object, ...]:
        """The words, or false and true, that it chooses from; empty: it takes a number."""
        kind = get_args(self.hint)[0] if hasattr(self.hint, "__metadata__") else self.hint
        if kind is bool:
            return (False, True)
        return get_args(kind) if get_origin(kind) is Literal else ()


def _walk(section: type, path: str = "") -> Iterator[Key]:
    for name, hint in get_type_hints(section, include_extras=True).items():
        if is_dataclass(hint):
            yield from _walk(hint, f"{path}{name}.")  # type: ignore[arg-type]
            continue
        carried = [one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Setting)]
        setting = carried[-1] if carried else Setting()
        yield Key(name=path + name, section=section, hint=hint, setting=setting)


KEYS = MappingProxyType({key.name: key for key in _walk(Config)})


def value_of(config: Config, name: str) -> Any:
    """Return the value of a dotted key."""
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return value


def with_value(config: Config, name: str, value: object) -> Config:
    """Return a configuration that differs in one dotted key."""
    section, _, last = name.rpartition(".")
    changed = replace(value_of(config, section) if section else config, **{last: value})
    return with_value(config, section, changed) if section else changed
