"""Read a YAML file into frozen dataclasses; every error names file, key, value and remedy.

``core/settings.py`` explains the settings of the estimator, ``service.py`` those of the service.
"""

from __future__ import annotations

import difflib
import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgspec
import yaml

from ekf_companion.config.service import (
    CheckpointConfig,
    HttpConfig,
    LinkConfig,
    OutputConfig,
    ParametersConfig,
    RecordConfig,
    SigningConfig,
    TimesyncConfig,
)
from ekf_companion.core.settings import FilterSettings
from ekf_companion.errors import ConfigError, LinkError
from ekf_companion.link.address import parse_monitor, parse_peer, parse_url


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(FilterSettings):
    """The whole configuration: the estimator's settings and the service's."""

    link: LinkConfig = field(default_factory=LinkConfig)
    signing: SigningConfig = field(default_factory=SigningConfig)
    timesync: TimesyncConfig = field(default_factory=TimesyncConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    parameters: ParametersConfig = field(default_factory=ParametersConfig)
    record: RecordConfig = field(default_factory=RecordConfig)
    checkpoint: CheckpointConfig = field(default_factory=CheckpointConfig)
    http: HttpConfig = field(default_factory=HttpConfig)


class _Loader(yaml.SafeLoader):
    """Read YAML as PyYAML does, but 1e-3 is a number, no key comes twice, and errors have marks."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError, AttributeError) as error:
            # It looks like a date or a number and is none, such as 2024-13-45 and 0x_
            kind = node.tag.rpartition(":")[2]
            raise yaml.constructor.ConstructorError(
                problem=f"{node.value!r:.40} is no {kind}; put text in quotes",
                problem_mark=node.start_mark,
            ) from error

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        names = [key.value for key, _ in pairs if isinstance(key, yaml.ScalarNode)]
        for name, count in Counter(names).items():
            if count > 1:
                raise yaml.constructor.ConstructorError(
                    problem=f"{name} stands {count} times; keep one", problem_mark=node.start_mark
                )
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?\d+[eE][-+]?\d+\Z"), list("-+0123456789")
)


def load_config(path: Path) -> Config:
    """Read a YAML file.

    Raises:
        ConfigError: The file cannot be read, or a key, a type or a value is wrong.
    """
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), _Loader)
        return parse_config({} if data is None else data, str(path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name a YAML file") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split()).replace(' in "<unicode string>",', " in")
        raise ConfigError(f"{path}: is not YAML: {reason}") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: a list stands too deep in lists, or in itself") from error


def parse_config(data: object, name: str) -> Config:
    """Turn parsed YAML into a configuration; errors begin with ``name``.

    Raises:
        ConfigError: As :func:`load_config`.
    """
    table = _check_keys(data, Config, name, ())
    try:
        config = msgspec.convert(table, Config)
    except msgspec.ValidationError as error:
        raise ConfigError(_explain(error, table, name)) from error
    key = "link.url"
    try:
        address = parse_url(config.link.url)
        key = "link.peer"
        address = replace(address, peer=parse_peer(config.link.peer, address))
        key = "output.monitors"
        for url in config.output.monitors:
            parse_monitor(url, address)
    except LinkError as error:
        raise ConfigError(f"{name}: {key}: {error}") from error
    return config


def _check_keys(data: object, kind: type, name: str, path: tuple[str, ...]) -> dict[str, Any]:
    """Return a section as a table; refuse unknown keys, NaN and infinities.

    A section whose keys are all commented out is empty.
    """
    if data is None:
        return {}
    if not isinstance(data, dict):
        where = ".".join(path) or "the file"
        raise ConfigError(
            f"{name}: {where}: {data!r} is not a table; write keys and values, as in key: value"
        )
    known = {entry.name for entry in fields(kind)}
    hints = get_type_hints(kind)
    table = {}
    for key, value in data.items():
        where = ".".join((*path, str(key)))
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            advice = f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(known))}"
            raise ConfigError(f"{name}: {where}: unknown key; {advice}")
        if is_dataclass(hints[key]):
            value = _check_keys(value, hints[key], name, (*path, key))
        elif not _is_finite(value):
            raise ConfigError(f"{name}: {where}: {value} is no number to work with; give another")
        table[key] = value
    return table


def _is_finite(value: object) -> bool:
    if isinstance(value, list):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def _explain(error: msgspec.ValidationError, data: object, name: str) -> str:
    """Return which key and value are wrong, and what would do."""
    message, _, place = str(error).partition(" - at ")
    keys = re.findall(r"[A-Za-z_]+|\d+", place.replace("`", "").lstrip("$"))
    value: Any = data
    for key in keys:
        if isinstance(value, (list, dict)):
            value = value[int(key)] if isinstance(value, list) else value[key]
    message = message.replace("`", "")
    if keys and not keys[-1].isdigit() and message.startswith(("Invalid", "Expected float | str")):
        message = f"expected {_choices(keys)}"
    return f"{name}: {'.'.join(keys)}: {value!r}: {message[0].lower() + message[1:]}"


def _choices(keys: list[str]) -> str:
    """Return the words that a key takes, and whether a number would do too."""
    hint: Any = Config
    for key in keys:
        hint = get_type_hints(hint)[key]
    types = [hint] if get_origin(hint) is Literal else get_args(hint)
    words = [word for one in types if get_origin(one) is Literal for word in get_args(one)]
    others = ["a number"] if any(get_origin(one) is not Literal for one in types) else []
    return " or ".join(words + others)


def describe_config(config: object) -> Mapping[str, Any]:
    """Return the effective configuration as plain tables, ready for YAML."""
    built: dict[str, Any] = msgspec.to_builtins(config)
    return built
