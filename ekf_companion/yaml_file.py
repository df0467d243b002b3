"""Read a YAML file that may be anything: bounded in size, whole, and without aliases.

The daemon reads its configuration again in flight, so that nothing in a file may cost it memory or
more than a moment.
"""

from __future__ import annotations

import os
import re
import stat
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from ekf_companion.errors import ConfigError

LARGEST = 1 << 17
"""Bytes of a file: four times those of config/reference.yaml."""


class YamlLoader(yaml.SafeLoader):
    """Read YAML as PyYAML does, but 1e-3 is a number, no key comes twice, no value is an alias."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Refuse an alias."""
        if self.check_event(yaml.events.AliasEvent):
            # Ten lines of aliases to aliases stand for more values than any memory holds
            event: Any = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(
                problem=f"*{event.anchor} is an alias; write the value itself",
                problem_mark=event.start_mark,
            )
        return super().compose_node(parent, index)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Put the mark of its place into every error."""
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
        """Refuse a key that comes twice."""
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        names = [key.value for key, _ in pairs if isinstance(key, yaml.ScalarNode)]
        for name, count in Counter(names).items():
            if count > 1:
                raise yaml.constructor.ConstructorError(
                    problem=f"{name:.40} stands {count} times; keep one",
                    problem_mark=node.start_mark,
                )
        return super().construct_mapping(node, deep)


YamlLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?\d+[eE][-+]?\d+\Z"), list("-+0123456789")
)


def read_yaml(path: Path, *, is_watched: bool = True) -> Any:
    """Return what a YAML file holds; never None.

    Args:
        path: The file.
        is_watched: Whether it may just be being written, so that its last line must have an end.

    Raises:
        ConfigError: It cannot be read, is empty, too large, cut off or no YAML.
    """
    try:
        # A FIFO opens once somebody writes, a terminal ends once somebody types
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ConfigError(f"{path}: is not a regular file; name a YAML file")
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name a YAML file") from error
    except ValueError as error:  # a NUL in the name
        raise ConfigError(f"{str(path)!r}: is no name of a file; name a YAML file") from error
    if len(data) > LARGEST:
        raise ConfigError(
            f"{path}: is larger than {LARGEST >> 10} KiB, too large for settings; name another"
        )
    try:
        text = data.decode("utf-8-sig")
        if is_watched and text and not text.endswith("\n"):
            last = text.count("\n") + 1
            raise ConfigError(
                f"{path}: line {last} has no end: the file may be cut off, half written; end its "
                "last line as all others"
            )
        found = yaml.load(text, YamlLoader)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split()).replace(' in "<unicode string>",', " in")
        raise ConfigError(f"{path}: is not YAML: {reason:.400}") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: a list stands too deep in lists") from error
    if found is None:
        raise ConfigError(
            f"{path}: is empty: nothing is set in it; name at least a section, as in link:, or use "
            "no file"
        )
    return found
