"""What may be turned in the field: parameters over MAVLink for keys of the configuration.

A change is kept beside the checkpoint, and the user's file stays as it is.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import msgspec

from ekf_companion.config.config import Config, describe_config, parse_config
from ekf_companion.config.reload import SAFE, Reload, reload, with_value
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.parameters import Parameter

_log = logging.getLogger(__name__)

AUTO = -1.0
"""Stands for ``auto`` where a number may be given instead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tunable:
    """One key of the configuration, as a number."""

    name: str
    """Of the parameter: at most 16 characters."""
    key: str
    lowest: float = 0.0
    highest: float = 1.0
    choices: tuple[object, ...] = ()
    """What 0, 1, 2 ... stand for, where it is no number."""
    encode: Callable[[Any], float] = float
    decode: Callable[[float], object] = float

    def number(self, value: object) -> float:
        """Give a value of the configuration as it is told over MAVLink."""
        return float(self.choices.index(value)) if self.choices else self.encode(value)

    def value(self, number: float) -> object:
        """Give what a number means in the configuration."""
        return self.choices[int(number)] if self.choices else self.decode(number)


def _choice(name: str, key: str, *choices: object) -> Tunable:
    return Tunable(name=name, key=key, highest=len(choices) - 1.0, choices=choices)


def _to_sigma(probability: float) -> float:
    return NormalDist().inv_cdf(0.5 + 0.5 * probability)


def _from_sigma(sigma: float) -> float:
    return math.erf(sigma / math.sqrt(2.0))


TABLE = (
    Tunable(name="EC_ODOM_RATE", key="output.odometry.rate", lowest=1.0, highest=200.0),
    _choice("EC_ODOM_MODE", "output.odometry.mode", "auto", "always", "never"),
    _choice("EC_TSYNC_RESP", "timesync.respond", False, True),
    Tunable(
        name="EC_GPS_DELAY",
        key="gnss.delay",
        lowest=AUTO,
        encode=lambda delay: AUTO if delay == "auto" else float(delay),
        decode=lambda number: "auto" if number == AUTO else number,
    ),
    _choice("EC_GPS_VEL_USE", "gnss.use_velocity", False, True),
    Tunable(name="EC_GPS_POS_NSE", key="gnss.position_std", highest=50.0),
    Tunable(name="EC_GPS_HGT_NSE", key="gnss.height_std", highest=50.0),
    Tunable(name="EC_GPS_VEL_NSE", key="gnss.velocity_std", highest=10.0),
    Tunable(name="EC_GYRO_NSE", key="imu.gyro_noise", lowest=1e-5, highest=0.1),
    Tunable(name="EC_ACC_NSE", key="imu.accel_noise", lowest=1e-4, highest=5.0),
    _choice("EC_HDG_SRC", "heading.source", "auto", "gnss", "magnetometer", "autopilot"),
    Tunable(name="EC_MAG_NSE", key="heading.magnetometer_std", lowest=1e-3, highest=1.0),
    _choice("EC_BARO_USE", "baro.use", False, True),
    Tunable(name="EC_BARO_NSE", key="baro.std", lowest=0.01, highest=50.0),
    Tunable(
        name="EC_GATE",
        key="gate.probability",
        lowest=1.0,
        highest=6.0,
        encode=_to_sigma,
        decode=_from_sigma,
    ),
)
"""The gate is told in sigmas of one axis; noises as in the configuration."""

_TRANSIENT = {"output.odometry.mode": "always"}
"""What counts in this run only: no stranger's PARAM_SET may lift the guard for good. The user's
file may."""

_BY_KEY = {tunable.key: tunable for tunable in TABLE}


def parameters(config: Config) -> tuple[Parameter, ...]:
    """Give the table that a ground station sees; empty where none is to be served."""
    if not config.parameters.serve:
        return ()
    return tuple(
        Parameter(
            name=tunable.name,
            key=tunable.key,
            value=tunable.number(_get(config, tunable.key)),
            lowest=tunable.lowest,
            highest=tunable.highest,
            is_whole=bool(tunable.choices),
            is_late=tunable.key not in SAFE,
        )
        for tunable in TABLE
    )


def apply(config: Config, key: str, number: float) -> Config:
    """Give the configuration with one key at what a parameter's number, in its range, means.

    Raises:
        ConfigError: No parameter has this key, or the number is out of its range.
    """
    tunable = _BY_KEY.get(key)
    if tunable is None:
        raise ConfigError(f"{key}: is no parameter; known are {', '.join(_BY_KEY)}")
    if not tunable.lowest <= number <= tunable.highest:
        raise ConfigError(f"{key}: {number} is not in {tunable.lowest} to {tunable.highest}")
    return with_value(config, key, tunable.value(number))


class Tuning:
    """The configuration as it was turned in the field, in this run or in an earlier one."""

    def __init__(
        self,
        config: Config,
        data: bytes | None = None,
        name: str = "",
        keep: Callable[[bytes], None] | None = None,
    ) -> None:
        """Take what an earlier run kept; what cannot be meant any more is left out and logged.

        Args:
            config: As the user's file says.
            data: What was handed to ``keep`` there; None: nothing was.
            name: Of the file that it was kept in, for the log.
            keep: Takes, after each change, what the next run should go on with: JSON of dotted
                keys and values, of those that differ from the user's file.
        """
        self.config = config
        """As it counts now."""
        self._file_config = config
        self._keep = keep
        if data is not None and config.parameters.serve:
            self._recall(data, name)

    def set(self, key: str, number: float) -> Config:
        """Turn one key to what a parameter's number means; give the configuration then.

        Raises:
            ConfigError: As :func:`apply`.
        """
        self.config = apply(self.config, key, number)
        if self._keep is not None:
            kept = {key: value for key, value in self.changed.items() if not _ends(key, value)}
            self._keep(msgspec.json.format(msgspec.json.encode(kept)) + b"\n")
        return self.config

    def reload(self, config: Config) -> Reload:
        """Take from the user's file, which has changed, what can be taken in flight.

        What was set over MAVLink goes before it still.
        """
        kept = self.changed
        found = reload(self._file_config, config)
        self._file_config = self.config = found.config
        for key, value in kept.items():
            self.config = with_value(self.config, key, value)
        return found

    @property
    def changed(self) -> dict[str, object]:
        """Give dotted key and value of what differs from the user's file."""
        return {
            tunable.key: value
            for tunable in TABLE
            if (value := _get(self.config, tunable.key)) != _get(self._file_config, tunable.key)
        }

    def _recall(self, data: bytes, name: str) -> None:
        try:
            kept = msgspec.json.decode(data, type=dict[str, object])
        except msgspec.DecodeError:
            _log.warning("%s: holds no parameters; those of the configuration count", name)
            return
        for key, value in kept.items():
            if key not in _BY_KEY:
                _log.warning("%s: %s: is no parameter any more; dropped", name, key)
                continue
            if _ends(key, value):
                _log.warning(
                    "%s: %s: %s counts in the run that it is set in; dropped", name, key, value
                )
                continue
            try:
                self.config = _set(self.config, key, value, name)
            except ConfigError as error:
                _log.warning("%s; dropped", error)
            else:
                _log.info("%s: %s is %s, as set over MAVLink", name, key, value)


def _ends(key: str, value: object) -> bool:
    """Whether a value ends with the run that it was set in."""
    return key in _TRANSIENT and _TRANSIENT[key] == value


def _get(config: Config, key: str) -> object:
    value: object = config
    for part in key.split("."):
        value = getattr(value, part)
    return value


def _set(config: Config, key: str, value: object, name: str) -> Config:
    """Give a copy with one key changed, checked as a file is."""
    table: dict[str, Any] = dict(describe_config(config))
    section, *parts = table, *key.split(".")
    for part in parts[:-1]:
        section = section[part]
    section[parts[-1]] = value
    return parse_config(table, name)
