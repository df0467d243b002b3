"""Every exception raised on purpose.

CompanionError
├── ConfigError   a key, a value or a file of the configuration
├── DataError     arrays that cannot be meant: units, axes, times (a ValueError too)
├── LinkError     a URL that names no link, or a link that cannot be opened at all
└── LogError      a recorded file that cannot be read, or holds nothing to estimate from
    └── FilterError  a filter whose mathematics end before the recording does

Each message says what, where, and what would do. Bad data is not an error: it is counted.
"""

from __future__ import annotations


class CompanionError(Exception):
    """Anything that this package raises on purpose."""


class ConfigError(CompanionError):
    """The configuration holds something that cannot be meant."""


class DataError(CompanionError, ValueError):
    """Arrays of measurements hold something that cannot be meant."""


class LinkError(CompanionError):
    """A link URL is malformed, or names what this machine does not have."""


class LogError(CompanionError):
    """A log cannot be read, or has nothing in it that could be estimated from."""


class FilterError(LogError):
    """A filter cannot go on: its mathematics end before the recording does."""
