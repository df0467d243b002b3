"""Links that deliver frames late, twice, or by another path: ``make links``.

The frames of simulated flights are delivered at changed times: a link stalls and brings a few of
its frames afterwards, recorded frames come once more from the autopilot's address, the same stream
comes by two paths, or by a slower one from some time on and that one may have samples of its
own. The daemon's core receives them; its
estimates are compared with the truth at their stamps.
"""

from __future__ import annotations

import argparse
import random
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.document import table, write
from ekf_companion.config.config import Config
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.intake import open_live
from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import id_of, parsed
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.state import COLUMNS, Status
from sim_autopilot.__main__ import app

Delivered = tuple[int, bytes, int]
"""Time of arrival, ns, the frame, and the path it came by."""
AUTOPILOTS = ("px4", "ardupilot", "ardupilot-old")
"""Whose inertial messages are HIGHRES_IMU, HIGHRES_IMU and RAW_IMU."""
BEGIN = 30.0
"""The trouble begins so long after the flight, s."""
LENGTH = 70.0
"""Of a flight, s."""
SIGMAS = 5.0
SMALL = np.array([2.0, 2.0])
"""Errors that are no lie, however small their sigma: horizontally, m, and of the tilt, deg."""
LARGEST = np.array([3.0, 5.0])
"""Errors that are never exceeded."""
RIGHT = np.array([2.0, 2.0])
"""Errors that are right again."""
AFTER = 2.0
"""They are so long after the trouble, s."""
SECOND_NS = 1_000_000_000
FIXES = (IDS["GPS_RAW_INT"], IDS["GPS2_RAW"])


class Trouble(NamedTuple):
    """A way in which frames are delivered."""

    name: str
    deliver: Callable[[list[Delivered]], list[Delivered]]
    end: float
    """Time from its beginning after which the link is normal again, or steady, s."""


class Outcome(NamedTuple):
    """The result of a flight with such a link."""

    worst: Array
    """Largest horizontal error, m, and tilt, deg, from the begin on."""
    late: Array
    """The same from two seconds after the end on."""
    lies: float
    """s."""
    resets: int
    """How often the estimate was reset."""
    lost: int
    """Frames that are counted as lost, beyond those that are."""
    good: float
    """Share of the estimates with quality 100 from the begin on."""


def _split(frames: list[Delivered], begin_ns: int, end_ns: int) -> list[list[Delivered]]:
    before = [one for one in frames if one[0] < begin_ns]
    within = [one for one in frames if begin_ns <= one[0] < end_ns]
    return [before, within, [one for one in frames if one[0] >= end_ns]]


def _begin(frames: list[Delivered]) -> int:
    return frames[0][0] + round(BEGIN * SECOND_NS)


def _stop(span: float, frames: list[Delivered], lag: Callable[[], float | None]) -> list[Delivered]:
    """Stop for a span, s, then deliver each frame of it as much later as it lags; None: never."""
    begin = _begin(frames)
    end = begin + round(span * SECOND_NS)
    before, within, after = _split(frames, begin, end)
    held = [
        (end + round(late * SECOND_NS) + 1000 * i, *one[1:])
        for i, one in enumerate(within)
        if (late := lag()) is not None
    ]
    return sorted([*before, *held, *after], key=lambda one: one[0])


def stall(span: float, share: float, behind: float, frames: list[Delivered]) -> list[Delivered]:
    """Stop for a span, s, then deliver a share of what was sent, all but ``behind`` s late."""
    chance = random.Random(1)
    return _stop(span, frames, lambda: behind if chance.random() < share else None)


def replay(count: int, age: float, times: int, frames: list[Delivered]) -> list[Delivered]:
    """Deliver frames of some time before once more, in a burst."""
    begin = _begin(frames)
    old = [one for one in frames if one[0] >= begin - round(age * SECOND_NS)][:count]
    again = [(begin + 1000 * i, *one[1:]) for i, one in enumerate(old * times)]
    return sorted([*frames, *again], key=lambda one: one[0])


def backlog(span: float, share: float, behind: float, frames: list[Delivered]) -> list[Delivered]:
    """Stop for a span, s, then deliver all that was sent, a share of it ``behind`` s later."""
    chance = random.Random(4)
    return _stop(span, frames, lambda: behind if chance.random() < share else 0.0)


def two_paths(apart: float, missing: float, frames: list[Delivered]) -> list[Delivered]:
    """Deliver the stream by a second path too; each loses a share."""
    chance, begin = random.Random(2), _begin(frames)
    first = [one for one in frames if one[0] < begin or chance.random() >= missing]
    second = [
        (at + round(apart * SECOND_NS), frame, 1)
        for at, frame, _ in frames
        if at >= begin and chance.random() >= missing
    ]
    return sorted([*first, *second], key=lambda one: one[0])


def change(apart: float, missing: float, frames: list[Delivered]) -> list[Delivered]:
    """Deliver by a slower path from some time on: it begins with what was sent just then."""
    chance, begin = random.Random(3), _begin(frames)
    first = [one for one in frames if one[0] < begin and chance.random() >= missing]
    slower = [
        (at + round(apart * SECOND_NS), frame, 1)
        for at, frame, _ in frames
        if at + round(apart * SECOND_NS) >= begin
    ]
    return sorted([*first, *slower], key=lambda one: one[0])


def own_samples(apart: float, frames: list[Delivered]) -> list[Delivered]:
    """Change to a slower path that was sent samples of its own, each numbered by itself.

    As an autopilot does on two ports: of every second frame of a kind each is sent one, but the
    receiver's fixes come by both.
    """
    begin, count = _begin(frames), Counter[int]()
    paths: tuple[list[Delivered], list[Delivered]] = [], []
    for at, frame, _ in frames:
        number = id_of(frame)
        count[number] += 1
        for path in (0, 1):
            if number in FIXES or count[number] % 2 == path:
                numbered = _numbered(frame, len(paths[path]))
                paths[path].append((at + round(apart * SECOND_NS) * path, numbered, path))
    first = [one for one in paths[0] if one[0] < begin]
    return sorted([*first, *(one for one in paths[1] if one[0] >= begin)], key=lambda one: one[0])


def _numbered(frame: bytes, sequence: int) -> bytes:
    """Return a frame of MAVLink 2 with another sequence number."""
    one = parsed(id_of(frame), frame)
    sender = Sender(one.system_id, one.component_id)
    sender.sequence = sequence & 0xFF
    return sender.frame(LAYOUTS[one.message_id].name, one.payload)


def troubles() -> Iterator[Trouble]:
    """Yield all that are tried."""
    for span in (0.3, 0.6, 1.0, 1.6, 2.0):
        for share in (0.0, 0.01, 0.05, 0.2, 0.5):
            for behind in (0.0, 0.1):
                name = f"stall of {span:g} s, {share:.0%} of it {behind:g} s later"
                yield Trouble(name, partial(stall, span, share, behind), span + behind)
        for share in (0.02, 0.1, 0.5):
            name = f"backlog of {span:g} s, {share:.0%} of it 0.1 s later"
            yield Trouble(name, partial(backlog, span, share, 0.1), span + 0.1)
    for age in (0.2, 0.5, 1.0, 1.5, 8.0):
        for count, times in ((75, 1), (300, 1), (75, 8)):
            name = f"{count} frames {age:g} s old once more, {times} times"
            yield Trouble(name, partial(replay, count, age, times), 0.1)
    for apart in (0.05, 0.2, 0.4, 1.0, 2.5):
        for missing in (0.0, 0.2):
            name = f"two paths {apart:g} s apart, each loses {missing:.0%}"
            yield Trouble(name, partial(two_paths, apart, missing), apart)
    for apart in (0.05, 0.2, 0.4, 1.0, 2.5):
        for missing in (0.0, 0.2):
            name = f"a path {apart:g} s slower, after one that loses {missing:.0%}"
            yield Trouble(name, partial(change, apart, missing), apart)
    for apart in (0.2, 0.8, 1.2, 1.6, 2.0, 2.5):
        name = f"a path {apart:g} s slower, with samples of its own"
        yield Trouble(name, partial(own_samples, apart), apart)


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A simulated flight as it was sent, and its true motion."""

    frames: list[Delivered]
    t_ns: Array
    truth: Array
    """Latitude, longitude, deg, and roll, pitch, rad; shape (n, 4)."""

    @classmethod
    def of(cls, autopilot: str, seed: int, scenario: str) -> Flown:
        """Fly."""
        with tempfile.TemporaryDirectory() as folder:
            log, truth = Path(folder) / "flight.tlog", Path(folder) / "truth.csv"
            asked = ["generate", "--scenario", scenario, "--personality", autopilot]
            asked += ["--seed", str(seed), "--duration", str(LENGTH)]
            app([*asked, "-o", str(log), "--truth", str(truth)], standalone_mode=False)
            frames = [(stamp_us * 1000, raw, 0) for stamp_us, raw in tlog.read(log).frames()]
            rows = np.genfromtxt(truth, delimiter=",", names=True)
        names = ("lat_deg", "lon_deg", "roll_rad", "pitch_rad")
        return cls(frames, rows["time_us"] * 1e3, np.stack([rows[n] for n in names], axis=1))

    def errors(self, t_ns: Array, values: Array) -> Array:
        """Return horizontal error, m, and that of the tilt, deg, shape (n, 2)."""
        at = {name: values[:, COLUMNS.index(name) - 1] for name in COLUMNS[1:]}
        lat, lon, roll, pitch = (np.interp(t_ns, self.t_ns, one) for one in self.truth.T)
        north = (at["lat_deg"] - lat) * 111_200.0
        east = (at["lon_deg"] - lon) * 111_200.0 * np.cos(np.radians(lat))
        down = _down(at["roll"], at["pitch"]), _down(roll, pitch)
        cosine = np.clip(np.sum(down[0] * down[1], axis=1), -1.0, 1.0)
        return np.stack([np.hypot(north, east), np.degrees(np.arccos(cosine))], axis=1)


def _down(roll: Array, pitch: Array) -> Array:
    """Return the direction of the vertical in the body, shape (n, 3)."""
    return np.stack(
        [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1
    )


def estimates(frames: list[Delivered], companion: Companion) -> tuple[Array, Array, Array]:
    """Return times of arrival and stamps, ns, and all estimates that follow from frames."""
    rows: list[tuple[int, int, Array]] = []
    last = None
    for at, frame, path in frames:
        companion.receive(frame, at, path)
        if companion.estimate is not last and companion.pipeline is not None:
            last = companion.estimate
            rows.append((at, companion.pipeline.stamp_ns, companion.pipeline.values()))
        companion.session.data_to_send()
    arrival, stamp, values = zip(*rows, strict=True)
    return np.array(arrival), np.array(stamp), np.array(values)


def score(flown: Flown, trouble: Trouble) -> Outcome:
    """Run a flight over such a link, and compare with the truth."""
    companion = Companion(Config(), open_pipeline=open_live)
    arrival, stamp, values = estimates(trouble.deliver(flown.frames), companion)
    begin = _begin(flown.frames)
    kept = np.isfinite(values[:, 0]) & (arrival >= begin)
    arrival, stamp, values = arrival[kept], stamp[kept], values[kept]
    errors = flown.errors(stamp, values)
    at = {name: values[:, COLUMNS.index(name) - 1] for name in COLUMNS[1:]}
    sigma = np.stack(
        [
            np.hypot(at["sd_pos_n"], at["sd_pos_e"]),
            np.degrees(np.hypot(at["sd_roll"], at["sd_pitch"])),
        ],
        axis=1,
    )
    is_good = at["status"] == Status.OK
    is_lie = is_good & ((errors > SIGMAS * sigma) & (errors > SMALL)).any(axis=1)
    step = np.clip(np.diff(arrival, append=arrival[-1]) * 1e-9, 0.0, 0.1)
    is_after = arrival > begin + (trouble.end + AFTER) * SECOND_NS
    assert companion.pipeline is not None
    return Outcome(
        worst=errors.max(axis=0),
        late=errors[is_after].max(axis=0),
        lies=float(step[is_lie].sum()),
        resets=companion.pipeline.resets,
        lost=companion.session.sequence.lost,
        good=float(np.mean(is_good)),
    )


def rows(seed: int, scenario: str, only: str) -> Iterator[str]:
    """Yield a row of the table for each trouble and autopilot."""
    for autopilot in AUTOPILOTS:
        flown = Flown.of(autopilot, seed, scenario)
        for trouble in [Trouble("none", lambda frames: frames, 0.0), *troubles()]:
            if only not in trouble.name and trouble.name != "none":
                continue
            o = score(flown, trouble)
            is_right = (o.worst <= LARGEST).all() and (o.late <= RIGHT).all() and o.lies == 0.0
            yield " | ".join(
                [
                    *(autopilot, trouble.name),
                    *(f"{o.worst[0]:.2f}", f"{o.worst[1]:.1f}"),
                    *(f"{o.late[0]:.2f}", f"{o.late[1]:.1f}", f"{o.lies:.1f}"),
                    *(f"{o.good:.2f}", str(o.resets), str(o.lost), "" if is_right else "over"),
                ]
            )


HEAD = (
    "autopilot | trouble | horizontal m | tilt deg | after m | after deg | lies s | quality 100 | "
    "resets | lost | "
)


def main() -> None:
    """Print the table, or write it into a document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--scenario", default="figure-eight")
    parser.add_argument("--only", default="", help="troubles whose name holds this")
    parser.add_argument("--write", type=Path, metavar="FILE", help="a document with marks")
    asked = parser.parse_args()
    lines = table(HEAD, rows(asked.seed, asked.scenario, asked.only))
    if asked.write is None:
        for line in lines:
            print(line, flush=True)
        return
    write(asked.write, "links", "\n".join(lines))


if __name__ == "__main__":
    main()
