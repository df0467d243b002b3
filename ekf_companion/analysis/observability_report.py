"""Observability in sentences: when each state becomes observable, and what was missing before.

Statements on the motion are measured: turns, changes of tilt and accelerations with their times.
That a state needs motion is measured too: the same aids at rest do not make it observable.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ekf_companion.analysis.observability import ANGLES, OBSERVABLE, STATES, Observability
from ekf_companion.analysis.observability_motion import ACCELERATION
from ekf_companion.calibrate.result import rounded
from ekf_companion.nav.arrays import Array

REPORTED = (*range(9, 15), 0, 1, 2)
"""The states that are reported: biases, roll, pitch, heading."""
AT_ONCE = 5.0
"""Time after the filter's start within which a state is observable from the start, s."""
RECENT = 10.0
"""Longest time from the onset of a motion to the observability that it explains, s."""
SETTLED = 3.0
"""Time after the filter's start in which it settles: a motion until then is from the start, s."""
TOGETHER = 2.0
"""Times that differ by less are reported as one, s."""
KNOWN_HEADING = float(np.radians(5.0))
"""One sigma of a heading that counts as known, rad: half its unit."""
CORRELATED = 0.5
"""Least correlation of two states that cannot be separated."""
STRONGLY_CORRELATED = 0.9
"""Likewise for states after the most correlated one."""


class StateSummary(NamedTuple):
    """The report on one state."""

    state: str
    since: float | None
    """When it became observable, s after the first inertial sample; None: never."""
    lost: bool
    """It is no longer observable at the end."""
    sigma: float
    """One sigma at the end, SI."""
    sentence: str


def summarise(found: Observability) -> tuple[StateSummary, ...]:
    """Return the report on each bias, on roll, pitch and heading."""
    summaries = []
    for state in REPORTED:
        ratio = found.judged_sigma[:, state]
        since = _since(ratio, found.t)
        lost = since is not None and bool(ratio[-1] >= OBSERVABLE)
        sigma = _sigma(found, state)
        sentence = f"{STATES[state]}: {_when(found, state, since)}"
        if lost:
            last = float(found.t[np.flatnonzero(ratio < OBSERVABLE)[-1]])
            sentence += f"; no longer after {_s(last)}"
        if since is not None:
            sentence += f"; {_amount(state, sigma)} (one sigma) at the end"
        if state == ANGLES.index("heading"):
            sentence += f"; {_without_north(found)}"
        summaries.append(StateSummary(STATES[state], since, lost, sigma, sentence))
    return tuple(summaries)


def lines(found: Observability) -> list[str]:
    """Return the report as text, a sentence per line."""
    text = [
        f"the filter begins at {_s(found.begin)}, the recording ends at {_s(float(found.t[-1]))}; "
        "times are from the first inertial sample",
        f"in it: {_moved(found, float(found.t[-1]))}",
        f"observable: one sigma is less than {OBSERVABLE:g} of what is not known before, that is "
        f"{_and([_amount(state, OBSERVABLE * found.unit[state]) for state in (9, 12, 0)])} "
        "(gyro, accelerometer; roll and pitch, but for what noise alone leaves)",
        *found.notes,
        *[one.sentence for one in summarise(found)],
    ]
    if found.is_rest:
        text.append(
            "the vehicle stands at the start: the mean of the gyro shows its bias before all this"
        )
    full = np.flatnonzero(np.isfinite(found.singular[:, -1]))
    if len(full):
        weakest = found.singular[full, -1]
        for which, k in (("poorest", np.argmin(weakest)), ("richest", np.argmax(weakest))):
            text.append(f"{which} window of {found.window:g} s: {_window(found, int(full[k]))}")
    else:
        text.append(f"the recording holds no whole window of {found.window:g} s")
    return text


def to_dict(found: Observability) -> dict[str, Any]:
    """Return everything for JSON; sigmas and singular values in units, NaN as null."""
    return {
        "begin_s": rounded(found.begin),
        "window_s": found.window,
        "threshold": OBSERVABLE,
        "notes": list(found.notes),
        "sentences": lines(found),
        "states": {
            one.state: {
                "observable_since_s": None if one.since is None else rounded(one.since),
                "is_lost": one.lost,
                "sigma_at_end": rounded(one.sigma),
                "sentence": one.sentence,
            }
            for one in summarise(found)
        },
        "names": list(STATES),
        "unit": rounded(found.unit),
        "t_s": rounded(found.t),
        "sigma": rounded(found.sigma),
        "sigma_at_rest": rounded(found.at_rest),
        "sigma_of_window": rounded(found.window_sigma),
        "heading_without_north_rad": rounded(found.free_heading),
        "singular_values": rounded(found.singular),
        "weakest_direction": rounded(found.direction[:, -1]),
        "motion_onset_s": {
            kind: None if np.isinf(t) else rounded(t) for kind, t in found.motion.onsets().items()
        },
    }


def _since(ratio: Array, t: Array, limit: float = OBSERVABLE) -> float | None:
    below = np.flatnonzero(ratio < limit)
    return float(t[below[0]]) if len(below) else None


def _when(found: Observability, state: int, since: float | None) -> str:
    if since is None:
        return f"not observable in this flight: {_lack(found, state)}"
    took = since - found.begin
    if STATES[state] == "heading" and took <= AT_ONCE:
        return f"observable from the start ({_s(since)}), by the {_north(found)}"
    at_rest = _since(found.at_rest[:, state], found.t)
    # At rest it would have come as soon, or nearly
    if at_rest is not None and at_rest - found.begin < 2.0 * took + TOGETHER:
        by = f"by the {_north(found)}" if STATES[state] == "heading" else "needs no motion"
        if took <= AT_ONCE:
            return f"observable from the start ({_s(since)}), {by}"
        begun = max(since - AT_ONCE, found.begin + SETTLED)
        late = sorted((t, f"no {aid}") for aid, t in found.first.items() if begun < t <= since)
        if late:
            words = _and([aid for _, aid in late])
            return f"not observable before {_s(since)}, {words} fused until {_s(late[0][0])}"
        return f"observable from {_s(since)} on, {by}, only time"
    onsets = {kind: t for kind, t in found.motion.onsets().items() if t <= since}
    if onsets and max(onsets.values()) <= found.begin + SETTLED and since - found.begin <= RECENT:
        return f"observable from {_s(since)} on, by the motion that is there from the start"
    return f"not observable before {_s(since)}, {_cause(found, onsets, since)}"


def _cause(found: Observability, onsets: dict[str, float], since: float) -> str:
    """Return which motion began shortly before, or how much there was."""
    recent = sorted((t, kind) for kind, t in onsets.items() if t > since - RECENT)
    recent = [one for one in recent if one[0] > found.begin + SETTLED]
    quiet = found.motion.quiet_before(since)
    if not recent and quiet is not None and quiet[1] > since - RECENT:
        return (
            f"the motion until {_s(quiet[0])} did not show it, and then it was straight and steady "
            f"until {'then' if since - quiet[1] < TOGETHER else _s(quiet[1])}"
        )
    if not recent:
        return f"only after {_moved(found, since)}"
    parts: list[tuple[float, list[str]]] = []
    for t, kind in recent:
        if not parts or t - parts[-1][0] >= TOGETHER:
            parts.append((t, []))
        parts[-1][1].append(f"no {kind}")
    said = [
        f"{_and(kinds)} until {'then' if since - t < TOGETHER and len(parts) == 1 else _s(t)}"
        for t, kinds in parts
    ]
    return ", ".join(said)


def _lack(found: Observability, state: int) -> str:
    """Return why a state never became observable."""
    name, end = STATES[state], float(found.t[-1])
    if name.startswith("gyro") or name == "heading":
        left = _amount(state, _sigma(found, state))
        said = f"{_s(end - found.begin)} with such aids leave {left}"
    else:
        never = [f"no {kind}" for kind, t in found.motion.onsets().items() if np.isinf(t)]
        said = _and(never) if never else f"this motion does not show it ({_moved(found, end)})"
    if partner := _partner(found, state):
        said += f"; it cannot be separated from {partner}"
    return said


def _partner(found: Observability, state: int) -> str | None:
    """Return the angles or biases that cannot be separated from a state, and their amounts."""
    P = found.covariance[-1]
    sigma = np.sqrt(np.diagonal(P))
    correlation = np.abs(P[state]) / (sigma * sigma[state])
    correlation[[state, *range(3, 9)]] = 0.0
    others = [int(i) for i in np.argsort(-correlation) if correlation[i] >= STRONGLY_CORRELATED][:3]
    others = others or [int(np.argmax(correlation))]
    if correlation[others[0]] < CORRELATED:
        return None
    parts = []
    for other in others:
        name, much = STATES[other], float(abs(P[state, other]) / sigma[state])
        article = "an" if name[0] in "aeiou" else "a"
        what = f"{name} error" if name in ANGLES else name
        parts.append(f"{article} {what} of {_amount(other, much)}")
    return " with ".join(parts)


def _without_north(found: Observability) -> str:
    """Return when motion alone would show the heading."""
    since = _since(found.free_heading, found.t, KNOWN_HEADING)
    without = f"without the {_north(found)}"
    end = float(found.t[-1])
    strongest = found.motion.until(end)[2]
    if since is None:
        if strongest < ACCELERATION:
            return f"{without}, motion would not show it: no horizontal acceleration"
        return (
            f"{without}, motion would not show it to 5 deg: horizontal acceleration up to "
            f"{strongest:.1f} m/s2 did not do"
        )
    begun = found.motion.onsets()["horizontal acceleration"]
    if begun > since or begun <= found.begin + SETTLED:
        return f"{without}, motion would show it to 5 deg from {_s(since)} on"
    return (
        f"{without}, not before {_s(since)}, no horizontal acceleration until "
        f"{'then' if since - begun < TOGETHER else _s(begun)}"
    )


def _window(found: Observability, k: int) -> str:
    """Describe a window by its singular values and its weakest direction."""
    values, weakest = found.singular[k], found.direction[k, -1]
    few = int(np.count_nonzero(values < 1.0))
    largest = [i for i in np.argsort(-np.abs(weakest)) if abs(weakest[i]) >= 0.2]
    sign = np.sign(weakest[largest[0]])
    parts = " ".join(
        f"{sign * weakest[i]:+.2f} {STATES[i]}{',' if i != largest[-1] else ''}" for i in largest
    )
    return (
        f"{_s(float(found.t[k]) - found.window)} to {_s(float(found.t[k]))}, {few} of 15 singular "
        f"values below 1, the least {values[-1]:.2g}: {parts}"
    )


def _moved(found: Observability, until: float) -> str:
    yaw, tilt, acceleration = found.motion.until(until)
    return (
        f"changes of heading by {np.degrees(yaw):.0f} deg and of tilt by {np.degrees(tilt):.0f} "
        f"deg, horizontal acceleration up to {acceleration:.1f} m/s2"
    )


def _north(found: Observability) -> str:
    return "magnetometer" if found.has_magnetometer else "heading aid"


def _sigma(found: Observability, state: int) -> float:
    return float(found.sigma[-1, state] * found.unit[state])


def _amount(state: int, value: float) -> str:
    name = STATES[state]
    if name.startswith("accelerometer"):
        return f"{value:.2g} m/s2"
    return f"{np.degrees(value):.2g} deg{'/s' if name.startswith('gyro') else ''}"


def _s(t: float) -> str:
    return f"{t:.1f} s" if t < 9.95 else f"{t:.0f} s"


def _and(words: list[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
