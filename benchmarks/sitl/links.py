"""Lines that are too slow, late or lossy for the traffic."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.sitl.flight import Log, climb, vehicle
from benchmarks.sitl.line import Line, pace
from benchmarks.sitl.pilot import square
from benchmarks.sitl.score import at, silence
from benchmarks.sitl.simulator import ALONE, Simulator
from benchmarks.sitl.throttle import Line as Wire

WIRES = {
    "TCP at 57600": Wire(kind="tcp", baud=57600),
    "TCP at 38400": Wire(kind="tcp", baud=38400),
    "pty at 57600": Wire(kind="pty", baud=57600),
    "UDP, 200 ms": Wire(kind="udp", delay=0.2),
    "UDP, 200 ms, VISO_DELAY_MS 225": Wire(kind="udp", delay=0.2),
    "UDP, 400 ms": Wire(kind="udp", delay=0.4),
    "UDP, 200 ms, jitter 50 ms": Wire(kind="udp", delay=0.2, jitter=0.05),
    "UDP, 10 % lost": Wire(kind="udp", loss=0.1),
    "UDP, stalls of 0.5 s": Wire(kind="udp", stall=0.5),
}
SETTINGS = {"UDP, 200 ms, VISO_DELAY_MS 225": {"VISO_DELAY_MS": 225.0}}
"""Parameters of ArduPilot for some of the lines."""
_BAD = "(?i)no ODOMETRY|not sent|withheld|line|link|late|slow|follow|TIMESYNC|DELAY"
_GOOD = "(?i)ODOMETRY is streamed"
_RECENT = 0.5
"""Without an arrival for so long nothing arrives, s."""
_PAUSE = 2.0
"""A silence that must be reported to the pilot, s."""
_NATURAL = 3.0
"""A failsafe within this time of the last arrival is due to what arrived, s."""


def fly_wire(simulator: Simulator, folder: Path, wire: Wire, settings: Mapping[str, float]) -> Log:
    """Change from the receiver to ODOMETRY over a bad line, hover, fly a square, change back."""
    parameters = {**simulator.alternative, **ALONE, **settings}
    if wire.baud and "VISO_TYPE" in parameters:
        parameters["SERIAL1_BAUD"] = wire.baud // 1000
    with vehicle(simulator, folder, parameters, wire=wire) as (pilot, _, log):
        climb(pilot, log)
        pilot.wait(5.0)
        simulator.change(pilot, is_into=True)
        log.marks["into"] = pilot.t
        pilot.wait(20.0)
        log.marks["moving"] = pilot.t
        pilot.follow(*square())
        log.marks["end"] = pilot.t
        simulator.change(pilot, is_into=False)
        pilot.wait(3.0)
        pilot.land()
    return log


def linked(
    simulator: Simulator, folder: Path, names: Sequence[str] | None = None
) -> Iterator[Line]:
    """Fly over each of the lines, or over those of some names."""
    for words in names or WIRES:
        if words in SETTINGS and "VISO_TYPE" not in simulator.alternative:
            continue
        wire = WIRES[words]
        place = folder / ("line-" + "".join(c if c.isalnum() else "-" for c in words))
        yield from judged(words, fly_wire(simulator, place, wire, SETTINGS.get(words, {})))


def judged(name: str, log: Log) -> Iterator[Line]:
    """Return the lines of a flight over a bad line."""
    flown, into, end = log.flown, log.marks["into"], log.marks["end"]
    assert flown is not None
    arrival = flown.arrival
    own = flown.autopilot
    rows = (own.t >= into) & (own.t <= end)
    t = own.t[rows]
    error = abs(own.pos_n[rows] - at(t, flown.truth.t, flown.truth.pos_n)).max(axis=1, initial=0.0)
    is_fed = np.array([_is_fed(arrival, one) for one in t], dtype=bool)
    worst = float(error[is_fed].max(initial=0.0))
    yield Line(name, "autopilot's error while ODOMETRY arrives, any axis", worst, 1.0, " m")
    if (is_wrong := is_fed & (error > 1.0)).any():
        found = told(log, float(t[is_wrong][0]))
        yield Line(name, "until the pilot reads of that error", found, 3.0, " s")
    ours = [text for when, text in _alarms(log) if _is_fed(arrival, when, _NATURAL)]
    yield Line(name, "alarms while ODOMETRY arrives", len(ours), 0)
    inside = (arrival >= into) & (arrival <= end)
    if inside.any() and flown.taken is not None:
        lag = arrival[inside] - flown.taken.t[inside]
        yield Line(
            name, "age of ODOMETRY at its arrival, 95 %", float(np.quantile(lag, 0.95)), 0.5, " s"
        )
    rate = float(inside.sum() / (end - into))
    yield Line(name, "rate of ODOMETRY that arrives", rate, np.inf, " Hz")
    pause = silence(arrival, into, end, _RECENT)
    yield Line(name, "ODOMETRY silent", pause.total, np.inf, " s")
    if pause.longest > _PAUSE and pause.since is not None:
        yield Line(name, "until the pilot reads of the silence", told(log, pause.since), 2.0, " s")
    height = flown.truth.pos_n[(flown.truth.t >= into) & (flown.truth.t <= end), 2]
    away = float(abs(height - height[0]).max())
    if not _alarms(log):
        yield Line(name, "true change of height", away, 1.0, " m")
    yield pace(name, log)


def _alarms(log: Log) -> list[tuple[float, str]]:
    texts = log.alarms(log.marks["into"], log.marks["end"])
    return [(t, text) for t, text in log.texts if text.strip() in texts and t > log.marks["into"]]


def _is_fed(arrival: np.ndarray, t: float, recent: float = _RECENT) -> bool:
    """Return whether ODOMETRY arrived shortly before a time."""
    k = np.searchsorted(arrival, t, side="right") - 1
    return bool(k >= 0 and t - arrival[k] <= recent)


def told(log: Log, since: float) -> float:
    """Return how long after a time the pilot has read that the line is bad.

    0: before it, and no text since then that ODOMETRY is streamed.
    """
    before = [text for t, text in log.said if t <= since and re.search(f"{_BAD}|{_GOOD[4:]}", text)]
    if before and not re.search(_GOOD, before[-1]):
        return 0.0
    return log.told_after(_BAD, since)
