"""The tables of a report as HTML: errors, numbers, parameters, messages, settings.

Names, units, parameters and messages come from a log that anybody may have written: all of it is
escaped here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape

import numpy as np

from ekf_companion.analysis.flight_numbers import Numbers, Vibration
from ekf_companion.analysis.flight_review import FlightReview
from ekf_companion.analysis.score import ROWS, Score
from ekf_companion.analysis.status_bands import Band
from ekf_companion.engine.faults import SOURCES, FoundFault
from ekf_companion.logs.onboard import LEVELS, Onboard
from ekf_companion.review.difference import SETTLED_NS
from ekf_companion.version import __version__

STYLE = """
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .15em .7em; text-align: right; border-bottom: 1px solid #e5e8e8; }
th { font-weight: 500; color: #566573; } tbody th, td.text { text-align: left; }
th:first-child { padding-left: 0; text-align: left; } .scroll { overflow-x: auto; }
td.text { overflow-wrap: anywhere; } .bad { color: #a93226; } .doubtful { color: #9c640c; }
.numbers { display: flex; flex-wrap: wrap; gap: .3em 2.2em; margin: .8em 0; }
.numbers div { line-height: 1.25; } .numbers b { display: block; font-size: 1.25em; }
.numbers span { color: #566573; }
.grid { columns: 270px; column-gap: 2em; } .grid div { display: flex; gap: 1em;
  justify-content: space-between; border-bottom: 1px solid #e5e8e8; break-inside: avoid; }
.grid span { overflow-wrap: anywhere; } summary { cursor: pointer; margin: .3em 0; }
.note { color: #566573; margin: .3em 0; }
@media (max-width: 560px) { .scroll th, .scroll td { padding: .15em .3em; font-size: .85em; } }
"""
_ERRORS = {
    "horizontal": "horizontal",
    "vertical": "vertical",
    "vertical_about_mean": "vertical about its mean",
    "velocity": "velocity",
    "tilt": "tilt",
    "roll": "roll",
    "pitch": "pitch",
    "yaw": "yaw",
}
"""Fields of a score that are shown, and their titles."""
_SEVERE = LEVELS[:4]
PARAMETERS = (
    *("EK2_", "EK3_", "EKF", "GPS", "COMPASS_", "AHRS_", "INS_", "BARO", "GND_"),
    *("SENS_", "CAL_", "IMU_", "ATT_", "SYS_HAS_", "VISO_", "MAG_"),
)
"""Prefixes of the parameters of ArduPilot and PX4 that affect an estimate."""
NOT_OF_IT = ("INS_LOG_", "INS_HNTC", "INS_HNTCH", "INS_HNTC2", "INS_NOTCH", "EKF2_LOG")
"""Prefixes of those that only affect the log, or filters of the controllers' input."""


def title(text: str) -> str:
    """Return a heading."""
    return f"<h2>{escape(text)}</h2>"


def head(review: FlightReview) -> str:
    """Return the part below the verdict: the flight's numbers, and a table of the errors."""
    return _facts(review) + _errors(review.numbers, review.duration)


def _facts(review: FlightReview) -> str:
    motion = review.numbers.motion
    minutes, seconds = divmod(round(review.duration), 60)
    facts = [("duration", f"{minutes} min {seconds} s" if minutes else f"{seconds} s")]
    far = motion.way >= 10_000.0
    way = f"{motion.way * 1e-3:.1f} km" if far else f"{motion.way:.0f} m"
    for name, value, text in (
        ("way over ground", motion.way, way),
        ("top speed over ground", motion.top_speed, f"{motion.top_speed:.1f} m/s"),
        ("highest above lowest point", motion.height, f"{motion.height:.1f} m"),
    ):
        if np.isfinite(value):
            facts.append((name, text))
    if motion.wind:
        facts.append(("wind in the mean", motion.wind))
    cells = (f"<div><b>{escape(text)}</b><span>{escape(name)}</span></div>" for name, text in facts)
    return f"<div class=numbers>{''.join(cells)}</div>"


def _errors(numbers: Numbers, duration: float) -> str:
    scores = [one for one in numbers.errors if any(_spread(one, name) for name in _ERRORS)]
    if not scores:
        return ""
    first = "".join(f"<th colspan=3>from {escape(_short(one.reference))}</th>" for one in scores)
    names = "<th>RMS</th><th>95 %</th><th>max</th>" * len(scores)
    units = {name: (unit.replace("mps", "m/s"), scale) for name, unit, scale in ROWS}
    rows = []
    for name, words in _ERRORS.items():
        if not any(_spread(one, name) for one in scores):
            continue
        unit, scale = units[name]
        cells = ""
        for one in scores:
            spread = _spread(one, name)
            for value in spread or (None,) * 3:
                cells += f"<td>{'' if value is None else _digits(value * scale)}</td>"
        rows.append(f"<tr><th>{escape(words)}, {escape(unit)}</th>{cells}</tr>")
    note = (
        f"The first {SETTLED_NS * 1e-9:.0f} s with a position are left out."
        if numbers.settled
        else f"Of all {duration:.0f} s, the start too: the flight is short."
    )
    return (
        f"<div class=scroll><table id=errors><thead><tr><th>error</th>{first}</tr>"
        f"<tr><th></th>{names}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
        f"<p class=note>{escape(note)}</p>"
    )


def _short(name: str) -> str:
    """Return a trajectory's name without its messages."""
    return {"autopilot": "the autopilot", "simulator": "the truth"}.get(
        short := name.partition(" (")[0], short
    )


def _spread(one: Score, name: str) -> tuple[float, float, float] | None:
    found = getattr(one, name)
    return None if found is None else (found.rms, found.p95, found.largest)


def _digits(value: float) -> str:
    """Return a number with as many digits as a reader needs."""
    if not np.isfinite(value):
        return ""
    size = abs(value)
    return f"{value:.{3 if size < 1.0 else 2 if size < 10.0 else 1 if size < 100.0 else 0}f}"


def vibration(found: Vibration | None, when: Callable[[int], float]) -> str:
    """Return the vibration of the samples; ``when`` returns the page's time of a stamp, s."""
    if found is None:
        return ""
    rows = (
        ("accelerometer, m/s2", found.accel, found.accel_clipped),
        ("gyro, rad/s", found.gyro, found.gyro_clipped),
    )
    body = ""
    for name, values, clipped in rows:
        cells = "".join(f"<td>{value:.2g}</td>" for value in values)
        mark = " class=bad" if clipped else ""
        body += f"<tr><th>{name}</th>{cells}<td{mark}>{clipped}</td></tr>"
    note = (
        f"RMS of what changes faster than 5 Hz, in samples at {found.rate:.0f} Hz. The worst "
        f"second, from {when(found.worst_ns):.0f} s on, has {_digits(found.worst)} m/s2. Clipped: "
        "the sample repeats the largest reading of its axis, the end of the sensor's range."
    )
    return (
        "<div class=scroll><table id=vibration><thead><tr><th>RMS</th><th>x</th><th>y</th>"
        f"<th>z</th><th>clipped samples</th></tr></thead><tbody>{body}</tbody></table></div>"
        f"<p class=note>{escape(note)}</p>"
    )


def parameters(found: Onboard) -> str:
    """Return the autopilot's parameters that affect an estimate."""
    chosen = {
        name: value
        for name, value in sorted(found.parameters.items())
        if name.startswith(PARAMETERS) and not name.startswith(NOT_OF_IT)
    }
    if not chosen:
        return ""
    count = f"{len(chosen)} of {len(found.parameters)} parameters of the autopilot"
    pairs = [(name, f"{value:.7g}") for name, value in chosen.items()]
    return _folded(f"{count}: of its estimator and its sensors", _grid(pairs), "parameters")


def messages(found: Onboard, when: Callable[[int], float]) -> str:
    """Return the autopilot's messages, with times of the page."""
    if not found.messages:
        return ""
    body = []
    for one in found.messages:
        time = "" if one.t_ns is None else f"{when(one.t_ns):.1f}"
        kind = "bad" if one.level in _SEVERE else "doubtful" if one.level == "warning" else ""
        body.append(
            f"<tr><td>{time}</td><td class=text>{escape(one.level)}</td>"
            f"<td class='text {kind}'>{escape(one.text)}</td></tr>"
        )
    more = f"<p class=note>{found.left_out} more are left out.</p>" if found.left_out else ""
    table = (
        "<table id=messages><thead><tr><th>time, s</th><th></th><th></th></tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table>{more}"
    )
    return _folded(f"{len(body)} messages of the autopilot", table, "said", is_open=len(body) < 30)


def faults(found: Sequence[FoundFault], when: Callable[[int], float]) -> str:
    """Return the faults that were beyond doubt; ``when`` returns the page's time of a stamp, s."""
    if not found:
        return ""
    body = ""
    for one in found:
        words, std = one.size_words
        body += (
            f"<tr><td class=text>{escape(SOURCES[one.source][1])}</td>"
            f"<td class=text>{escape(words)}</td><td>{escape(std)}</td>"
            f"<td>{when(one.onset_ns):.0f}</td><td>{when(one.until_ns):.0f}</td>"
            f"<td>{one.evidence:.0f}</td></tr>"
        )
    note = (
        "To: when it was beyond doubt last; one that has been repaired is so no longer. Evidence: "
        "logarithm of how much more likely the readings are with the fault than without any."
    )
    return (
        "<div class=scroll><table id=faults><thead><tr><th>source</th><th>fault</th><th>sigma</th>"
        f"<th>from, s</th><th>to, s</th><th>evidence</th></tr></thead><tbody>{body}</tbody></table>"
        f"</div><p class=note>{escape(note)}</p>"
    )


def settings(review: FlightReview) -> str:
    """Return the version and settings that made the estimate."""
    pairs = [("ekf-companion", __version__)]
    if review.onboard.firmware:
        pairs.append(("autopilot", review.onboard.firmware))
    changed = review.settings
    pairs += [(name, value) for name, value in changed.items()]
    note = "" if changed else "<p class=note>All settings of the estimator are the defaults.</p>"
    return _grid(pairs) + note


def band_words(found: Sequence[Band]) -> list[str]:
    """Return the name of each band, with its duration."""
    return [f"{one.name}, {_seconds(one.seconds)}" for one in found]


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if value < 10.0 else f"{value:.0f} s"


def _grid(pairs: Iterable[tuple[str, str]]) -> str:
    cells = (
        f"<div><span>{escape(name)}</span><span>{escape(value)}</span></div>"
        for name, value in pairs
    )
    return f"<div class=grid>{''.join(cells)}</div>"


def _folded(words: str, content: str, name: str, *, is_open: bool = False) -> str:
    opened = " open" if is_open else ""
    return f"<details id={name}{opened}><summary>{escape(words)}</summary>{content}</details>"
