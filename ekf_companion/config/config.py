"""Read a YAML file into frozen dataclasses; every error names file, key, value and remedy.

``core/settings/settings.py`` explains the settings of the estimator, ``service.py`` those of the
service.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from ekf_companion.config.expected import expected, found
from ekf_companion.config.service import (
    CheckpointConfig,
    HttpConfig,
    LinkConfig,
    LiveConfig,
    OutputConfig,
    ParametersConfig,
    PreflightConfig,
    RecordConfig,
    SigningConfig,
    TimesyncConfig,
)
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.errors import ConfigError, LinkError
from ekf_companion.link.address import parse_aid, parse_monitor, parse_peer, parse_url


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
    live: LiveConfig = field(default_factory=LiveConfig)
    preflight: PreflightConfig = field(default_factory=PreflightConfig)


class ConfigFile:
    """A configuration in a file that is read at the start, and again at each reload."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._last: tuple[Config, frozenset[str]] | None = None
        """What the last good reading gave, and which keys stood in the file."""

    def read(self) -> Config:
        """Read the file.

        A key that stood in it before, and no longer does, is refused where its value would change:
        the file may be half written, and no setting may go back to its default in flight unseen.

        Raises:
            ConfigError: The file cannot be read, or a key, a type or a value is wrong.
        """
        # A log is converted without a file: then PyYAML, a thirtieth of the start, is not needed
        from ekf_companion.yaml_file import read_yaml

        data = read_yaml(self.path)
        config, keys = parse_config(data, str(self.path)), frozenset(_leaves(data))
        if self._last is not None:
            before, earlier = self._last
            for key in sorted(earlier - keys):
                old, new = _value_of(before, key), _value_of(config, key)
                if old != new:
                    raise ConfigError(
                        f"{self.path}: {key} is no longer in it, and was {old!r}: the file may be "
                        f"half written; to go back to the default, write {key} as {new!r}"
                    )
        self._last = config, keys
        return config


def load_config(path: Path) -> Config:
    """Read a YAML file.

    Raises:
        ConfigError: The file cannot be read, or a key, a type or a value is wrong.
    """
    return ConfigFile(path).read()


def _leaves(data: Any, path: str = "", kind: Any = Config) -> Iterator[str]:
    """Return the dotted names of the keys that a valid file sets."""
    for key, value in (data or {}).items():
        hint = get_type_hints(kind)[key]
        if is_dataclass(hint):
            yield from _leaves(value, f"{path}{key}.", hint)
        else:
            yield path + key


def _value_of(config: Config, name: str) -> Any:
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return value


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
    if not config.http.host.isprintable() or not config.http.host.strip():
        raise ConfigError(
            f"{name}: http.host: {config.http.host!r:.60} is no address; 127.0.0.1 is this board "
            "only, and http.port: 0 serves nothing"
        )
    if not re.fullmatch(r"([A-Za-z0-9._~-]{8,128})?", config.http.token):
        raise ConfigError(
            f"{name}: http.token: is no token: use 8 to 128 letters, digits or . _ ~ - (openssl "
            "rand -hex 16 makes one), or leave it empty"
        )
    tiles = config.http.tiles
    is_tile = re.fullmatch(
        r"https?://[A-Za-z0-9.-]+(:[0-9]{1,5})?/[A-Za-z0-9._~/?&=%@:{}-]*", tiles
    )
    if tiles and not (is_tile and all(one in tiles for one in ("{z}", "{x}", "{y}"))):
        raise ConfigError(
            f"{name}: http.tiles: {tiles!r:.80} is no address of map tiles: write it as "
            "https://HOST/{z}/{x}/{y}.png, or leave it empty for no map"
        )
    if config.live.udp_json and not re.fullmatch(r".+:[0-9]{1,5}", config.live.udp_json):
        raise ConfigError(
            f"{name}: live.udp_json: {config.live.udp_json!r:.60}: write it as HOST:PORT"
        )
    key = "link.url"
    try:
        address = parse_url(config.link.url)
        key = "link.peer"
        address = replace(address, peer=parse_peer(config.link.peer, address))
        key = "link.aid_url"
        if config.link.aid_url:
            parse_aid(config.link.aid_url, config.link.aid_peers, address)
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
            f"{name}: {where}: {data!r:.60} is not a table; write keys and values, as in key: value"
        )
    known = {entry.name for entry in fields(kind)}
    hints = get_type_hints(kind)
    table = {}
    for key, value in data.items():
        where = ".".join((*path, str(key)))
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            advice = f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(known))}"
            raise ConfigError(f"{name}: {where:.60}: unknown key; {advice}")
        if is_dataclass(hints[key]):
            value = _check_keys(value, hints[key], name, (*path, key))
        elif not _is_finite(value):
            raise ConfigError(
                f"{name}: {where}: {value!s:.60} is no number to work with; give another"
            )
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
    value, hint = data, Any
    kind: Any = Config
    for key in keys:
        if isinstance(value, list):
            value = value[int(key)]
        elif isinstance(value, dict):
            value, hint = value[key], get_type_hints(kind, include_extras=True)[key]
            kind = hint
    names = [key for key in keys if not key.isdigit()]
    takes = "write" if keys == names else f"{'.'.join(names)} takes"
    return f"{name}: {'.'.join(keys)}: {_wrong(value, message)}; {takes} {expected(hint)}"


def _wrong(value: object, message: str) -> str:
    """Return what is wrong with a value, by msgspec's message on it."""
    if isinstance(value, list) and "of length" in message:
        return f"{value!r:.60} has {len(value)} values"
    if isinstance(value, str) and message.startswith("Invalid"):
        return f"{value!r:.60} is no such word"
    is_beyond = any(sign in message for sign in "<>")
    return f"{value!r:.60} is out of range" if is_beyond else found(value)


def describe_config(config: object) -> Mapping[str, Any]:
    """Return the effective configuration as plain tables, ready for YAML."""
    built: dict[str, Any] = msgspec.to_builtins(config)
    return built
