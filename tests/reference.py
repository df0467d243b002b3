"""Write ``config/reference.yaml`` from the fields of the settings: ``make reference``.

A test compares it with what would be written.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from itertools import pairwise
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
import yaml

from ekf_companion.config.config import Config
from ekf_companion.config.expected import range_of
from ekf_companion.config.keys import KEYS, Key, value_of
from ekf_companion.core.settings.settings import HABITS, FilterSettings
from tests.paths import ROOT

PAGE = ROOT / "config" / "reference.yaml"
_HEAD = """\
# Every key of the configuration. `make reference` writes this file: look up here, and change
# px4.yaml, ardupilot.yaml or a file of your own.
#
# A line that begins with #key: shows a key at its default. To set it, take the # away. What a file
# does not name is at its default; `ekf-companion check-config FILE` prints all of them. A wrong key
# or value ends the start with a sentence and exit code 2.
#
# In brackets: the unit; the values that a key takes; "reloadable" where `ekf-companion reload`
# takes a change in flight (all others wait for the next start); the MAVLink parameter that sets the
# key, and its values.
#
# A file that is empty or cut off is refused. So is a reload of a file in which a key no longer
# stands that would go back to its default: write the default out."""
_WIDTH = 100
_UNBOUNDED = 1e6
_FAMILIES = {"px4": "PX4", "ardupilot": "ArduPilot", "unknown": "others"}


def reference() -> str:
    """Return a YAML file that shows every key at its default, under its text."""
    service_first = sorted(fields(Config), key=lambda one: hasattr(FilterSettings, one.name))
    return "\n".join((_HEAD, *_section(Config, "", [one.name for one in service_first]))) + "\n"


def _section(section: Any, path: str, names: list[str]) -> Iterator[str]:
    indent = "  " * path.count(".")
    hints, texts = get_type_hints(section), texts_of(section)
    for name in names:
        if is_dataclass(kind := hints[name]):
            yield from [] if path else [""]
            yield from _comment(kind.__doc__ or "", indent)
            yield f"{indent}{name}:"
            yield from _section(kind, f"{path}{name}.", [one.name for one in fields(kind)])
            continue
        key = KEYS[path + name]
        yield from [] if path else [""]
        yield from _comment(texts[name] + _auto(key), indent)
        facts = _facts(key)
        yield from _comment(f"[{'; '.join(facts)}]", indent) if facts else ()
        default = msgspec.to_builtins(value_of(Config(), key.name))
        written = yaml.safe_dump([default], default_flow_style=True, width=_WIDTH).strip()[1:-1]
        yield f"{indent}#{name}: {written}"


def texts_of(section: Any) -> dict[str, str]:
    """Return the strings below the fields of a dataclass, which only its source has."""
    found: dict[str, str] = {}
    for kind in section.__mro__[-2::-1]:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
        for entry, below in pairwise(tree.body if isinstance(tree, ast.ClassDef) else ()):
            if isinstance(entry, ast.AnnAssign) and isinstance(below, ast.Expr):
                found[ast.unparse(entry.target)] = inspect.cleandoc(ast.literal_eval(below.value))
    return found


def _comment(text: str, indent: str) -> list[str]:
    head = f"{indent}# "
    return textwrap.wrap(
        " ".join(text.split()),
        _WIDTH,
        initial_indent=head,
        subsequent_indent=head,
        break_on_hyphens=False,
        break_long_words=False,
    )


def _auto(key: Key) -> str:
    """Return what ``auto`` means, where that depends on the autopilot."""
    if not key.setting.auto:
        return ""
    values = {name: getattr(habit, key.setting.auto) for name, habit in HABITS.items()}
    said = [
        f"{value if isinstance(value, str) else format(value, 'g')} for {_FAMILIES[name]}"
        for name, value in values.items()
    ]
    return f" auto: {', '.join(said)}."


def _facts(key: Key) -> list[str]:
    """Return unit, values, whether a reload takes it, and the parameter; without what is empty."""
    setting, values = key.setting, _values(key.hint)
    facts = [
        setting.unit,
        " or ".join(filter(None, (", ".join(values[:-1]), *values[-1:]))),
        "reloadable" if setting.reload else "",
        "" if setting.param is None else f"{setting.param.name} {_parameter_range(key)}",
    ]
    return [fact for fact in facts if fact]


def _values(hint: Any) -> list[str]:
    """Return what a type takes: words and ranges."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        ranges = [range_of(one, _UNBOUNDED) for one in arguments if isinstance(one, msgspec.Meta)]
        return ranges or _values(arguments[0])
    if origin in (Union, UnionType):
        return [] if str in arguments else [value for one in arguments for value in _values(one)]
    if origin is tuple:
        return [f"each {value}".replace("each each", "each") for value in _values(arguments[0])]
    return list(arguments) if origin is Literal else ["null"] if hint is NoneType else []


def _parameter_range(key: Key) -> str:
    param = key.setting.param
    assert param is not None
    if key.choices == (False, True):
        return "0, 1"
    if key.choices:
        return ", ".join(f"{number} {word}" for number, word in enumerate(key.choices))
    low = f"{param.lowest:g} auto," if key.setting.auto else f"{param.lowest:g}"
    return f"{low} to {param.highest:g}{' sigmas of one axis' if param.is_sigma else ''}"


if __name__ == "__main__":
    PAGE.write_text(reference(), encoding="utf-8")
