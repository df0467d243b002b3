"""What may be set in the field: parameters over MAVLink for keys of the configuration.

A change is kept beside the checkpoint, and the user's file stays as it is.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from statistics import NormalDist
from typing import Any

import msgspec

from ekf_companion.config.config import Config, describe_config, parse_config
from ekf_companion.config.keys import KEYS, Key, value_of, with_value
from ekf_companion.config.reload import Reload, reload
from ekf_companion.core.settings.setting import Param
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.parameters import Parameter

_log = logging.getLogger(__name__)

ROUNDING = 1e-6
"""Of a float32 and of a probability, as a share."""
AUTO = -1.0
"""Stands for ``auto`` where a number may be given instead."""

_TRANSIENT = {"output.odometry.mode": "always"}
"""What counts in this run only: no stranger's PARAM_SET may lift the guard for good. The user's
file may."""


def _tunable() -> dict[str, tuple[Key, Param]]:
    """Return the keys that have a MAVLink parameter, in the order of its index."""
    found = [(key, key.setting.param) for key in KEYS.values() if key.setting.param is not None]
    return {key.name: (key, param) for key, param in sorted(found, key=lambda one: one[1].index)}


_TUNABLE = _tunable()


def _number(key: Key, param: Param, value: Any) -> float:
    """Return a value of the configuration as the parameter has it."""
    if key.choices:
        return float(key.choices.index(value))
    if value == "auto":
        return AUTO
    return NormalDist().inv_cdf(0.5 + 0.5 * value) if param.is_sigma else float(value)


def _value(key: Key, param: Param, number: float) -> object:
    """Return what a parameter's number means in the configuration."""
    if key.choices:
        return key.choices[int(number)]
    if key.setting.auto and number == AUTO:
        return "auto"
    return math.erf(number / math.sqrt(2.0)) if param.is_sigma else number


def _highest(key: Key, param: Param) -> float:
    return len(key.choices) - 1.0 if key.choices else param.highest


def parameters(config: Config) -> tuple[Parameter, ...]:
    """Return the table that a ground station sees; empty where none is to be served."""
    if not config.parameters.serve:
        return ()
    return tuple(
        Parameter(
            name=param.name,
            key=name,
            value=_number(key, param, value_of(config, name)),
            lowest=param.lowest,
            highest=_highest(key, param),
            is_whole=bool(key.choices),
            is_late=not key.setting.reload,
        )
        for name, (key, param) in _TUNABLE.items()
    )


def apply(config: Config, name: str, number: float) -> Config:
    """Return the configuration with one key at what a parameter's number, in its range, means.

    Raises:
        ConfigError: No parameter has this key, or the number is out of its range.
    """
    if name not in _TUNABLE:
        raise ConfigError(f"{name}: is no parameter; known are {', '.join(_TUNABLE)}")
    key, param = _TUNABLE[name]
    _check(key, param, number)
    return with_value(config, name, _value(key, param, number))


def _check(key: Key, param: Param, number: float) -> None:
    """Refuse a number that is out of a parameter's range; beside it rounding is allowed for."""
    lowest, highest = param.lowest, _highest(key, param)
    if not lowest - ROUNDING * abs(lowest) <= number <= highest + ROUNDING * abs(highest):
        raise ConfigError(f"{key.name}: {number} is not in {lowest} to {highest}")


class Tuning:
    """The configuration as it was set in the field, in this run or in an earlier one."""

    def __init__(
        self,
        config: Config,
        data: bytes | None = None,
        name: str = "",
        keep: Callable[[bytes], None] | None = None,
    ) -> None:
        """Take over what an earlier run kept; leave out, and log, what is no longer valid.

        Args:
            config: As in the user's file.
            data: What that run handed to ``keep``; None if nothing.
            name: Of the file that it was kept in, for the log.
            keep: Stores, after each change, what the next run should go on with: JSON of dotted
                keys and values, of those that differ from the user's file.
        """
        self.config = config
        """The configuration in force."""
        self._file_config = config
        self._keep = keep
        if data is not None and config.parameters.serve:
            self._recall(data, name)

    def set(self, key: str, number: float) -> Config:
        """Set one key to what a parameter's number means, and return the new configuration.

        Raises:
            ConfigError: As :func:`apply`.
        """
        self.config = apply(self.config, key, number)
        if self._keep is not None:
            kept = {key: value for key, value in self.changed.items() if not _ends(key, value)}
            self._keep(msgspec.json.format(msgspec.json.encode(kept)) + b"\n")
        return self.config

    def reload(self, config: Config) -> Reload:
        """Take from the user's changed file what a flight can take.

        What was set over MAVLink still takes precedence over it.
        """
        kept = self.changed
        reloaded = reload(self._file_config, config)
        self._file_config = self.config = reloaded.config
        for key, value in kept.items():
            self.config = with_value(self.config, key, value)
        return reloaded

    @property
    def changed(self) -> dict[str, object]:
        """Return dotted key and value of what differs from the user's file."""
        return {
            name: value
            for name in _TUNABLE
            if (value := value_of(self.config, name)) != value_of(self._file_config, name)
        }

    def _recall(self, data: bytes, name: str) -> None:
        try:
            kept = msgspec.json.decode(data, type=dict[str, object])
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            _log.warning("%s: holds no parameters; those of the configuration count", name)
            return
        if gone := sorted(kept.keys() - _TUNABLE.keys()):
            others = f" and {len(gone) - 1} more" if len(gone) > 1 else ""
            words = "%s: %.60r%s: is no parameter any more; dropped"
            _log.warning(words, name, gone[0], others)
        for key in sorted(kept.keys() & _TUNABLE.keys()):
            value = kept[key]
            if _ends(key, value):
                _log.warning(
                    "%s: %s: %s counts in the run that it is set in; dropped", name, key, value
                )
                continue
            try:
                # Checked as a file is
                config = parse_config(describe_config(with_value(self.config, key, value)), name)
                _check(*_TUNABLE[key], _number(*_TUNABLE[key], value_of(config, key)))
            except ConfigError as error:
                _log.warning("%s; dropped", error)
            else:
                self.config = config
                _log.info("%s: %s is %s, as set over MAVLink", name, key, value)


def _ends(key: str, value: object) -> bool:
    """Whether a value ends with the run that it was set in."""
    return key in _TRANSIENT and _TRANSIENT[key] == value
