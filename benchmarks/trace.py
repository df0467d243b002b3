"""Count what one frame of the autopilot goes through: ``python -m benchmarks.trace``.

A simulated flight is received as the daemon receives it. Of each frame are counted, up to what is
queued to be sent: the files in which something is called; the moves, where a call is in another
file than the call before it; and the calls. A comprehension is none. A module that is compiled is
entered and not followed: what compiled code does by itself, before it comes back or calls Python,
is the one call that began it.

The table shows the median over all frames of a message that bring the same messages, and the least
and most of each: a sample may hold a pressure or a field that is due as well, which is one more
measurement. ``--calls MESSAGE`` lists the calls of the median frame.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache, wraps
from itertools import pairwise
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, NamedTuple

import ekf_companion
from benchmarks.document import table

PACKAGE = Path(ekf_companion.__file__).resolve().parent
FAMILIES = ("px4", "ardupilot")
DURATION, SETTLED = 24.0, 18.0
"""Of the flight, and the part of it that is not counted, s."""
SENDER = ("127.0.0.1", 14550)


class Call(NamedTuple):
    """One call of a function of ours."""

    file: str
    """Below the package."""
    function: str


class Cost(NamedTuple):
    """What one frame went through."""

    files: int
    moves: int
    calls: int


class Seen(NamedTuple):
    """The frames of one message that brought the same messages."""

    message: str
    brought: tuple[str, ...]
    frames: list[list[Call]]

    @property
    def median(self) -> list[Call]:
        """The calls of the median frame, by their number."""
        return sorted(self.frames, key=len)[len(self.frames) // 2]


def cost(calls: list[Call]) -> Cost:
    """Return the cost of a frame."""
    files = [call.file for call in calls]
    moves = sum(a != b for a, b in pairwise(files))
    return Cost(len(set(files)), moves, len(files))


class Tracer:
    """Keeps the calls of our functions while it is open."""

    def __init__(self) -> None:
        self.calls: list[Call] = []
        """Of the last frame."""
        self._is_open = False
        self._entered: dict[object, object] = {}

    def __enter__(self) -> Tracer:
        self.calls, self._is_open = [], True
        sys.setprofile(self._on_event)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
        self._is_open = False

    def _on_event(self, frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_name
        if (
            event == "call"
            and not name.startswith("<")
            and (file := ours(frame.f_code.co_filename))
        ):
            self.calls.append(Call(file, name))

    def count_entries(self) -> None:
        """Count from now on where modules in Python enter compiled ones; these leave no frame."""
        modules = {name: one for name, one in sys.modules.items() if name.startswith("ekf_")}
        compiled = {name for name, one in modules.items() if not is_python(one)}
        for module in filter(is_python, modules.values()):
            for name, one in list(vars(module).items()):
                is_ours = getattr(one, "__module__", None) in compiled and callable(one)
                if is_ours and (type(one) is type or not isinstance(one, type)):
                    setattr(module, name, self._counted(one))

    def _counted(self, one: Any) -> Any:
        """Return a compiled function, or a class of them, whose calls are kept."""
        if one not in self._entered:
            file = f"{one.__module__.removeprefix('ekf_companion.').replace('.', '/')}.py"
            if isinstance(one, type):
                members = {
                    name: self._kept(file, name, getattr(one, name))
                    for name in dir(one)
                    if not name.startswith("_") and callable(getattr(one, name))
                }
                self._entered[one] = type(one.__name__, (one,), members)
            else:
                self._entered[one] = self._kept(file, one.__name__, one)
        return self._entered[one]

    def _kept(self, file: str, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def entry(*given: Any, **named: Any) -> Any:
            # Compiled code leaves no frame: the caller of its own is the entry before
            if self._is_open and sys._getframe(1).f_code is not sys._getframe(0).f_code:
                self.calls.append(Call(file, name))
            return function(*given, **named)

        return entry


@cache
def ours(path: str) -> str:
    """Return the name of a file below the package; empty: it is not one of ours."""
    return str(Path(path).relative_to(PACKAGE)) if path.startswith(f"{PACKAGE}/") else ""


def is_python(module: ModuleType) -> bool:
    """Return whether a module is not compiled."""
    return (getattr(module, "__file__", None) or "").endswith(".py")


def watch(family: str, tracer: Tracer) -> list[Seen]:
    """Fly before a companion, and return what its frames went through."""
    from ekf_companion.config.config import Config
    from ekf_companion.mavlink.frame import Splitter
    from ekf_companion.mavlink.messages import LAYOUTS
    from sim_autopilot.config import SimConfig
    from sim_autopilot.firmware import PERSONALITIES
    from sim_autopilot.flight import Flight
    from sim_autopilot.loop import Bench

    engine = importlib.import_module("ekf_companion.engine.companion")
    tracer.count_entries()
    found: dict[tuple[str, tuple[str, ...]], list[list[Call]]] = {}
    nature = PERSONALITIES[family]
    flight = Flight.plan("figure-eight", nature.suited(SimConfig()), seed=11, duration=DURATION)
    settled_ns = flight.first_ns + round(SETTLED * 1e9)

    class Peer:
        """A companion whose frames are traced once it has found its estimate."""

        def __init__(self) -> None:
            self._companion = companion = engine.Companion(Config())
            self.tick, self.data_to_send = companion.tick, companion.data_to_send
            self._splitter = Splitter()

        def receive(self, data: bytes, now_ns: int) -> None:
            outbox = self._companion.session.outbox
            before = outbox.sent.copy()
            with tracer:
                self._companion.receive(data, now_ns, SENDER)
            names = [LAYOUTS[one.message_id].name for one in self._splitter.feed(data)]
            if now_ns >= settled_ns and len(names) == 1:
                brought = tuple(sorted((outbox.sent - before).elements()))
                found.setdefault((names[0], brought), []).append(tracer.calls)

    for _ in Bench(flight, Peer(), personality=nature, latency=0.001).frames():
        pass
    return [Seen(*key, frames) for key, frames in sorted(found.items())]


def rows(seen: Iterable[Seen]) -> Iterator[str]:
    """Yield a row of the table for each message and what it brings."""
    for one in seen:
        usual = cost(one.median)
        costs = list(zip(*map(cost, one.frames), strict=True))
        numbers = [f"{min(all_)} | {a} | {max(all_)}" for a, all_ in zip(usual, costs, strict=True)]
        yield " | ".join([one.message, ", ".join(one.brought), str(len(one.frames)), *numbers])


def main() -> None:
    """Print the tables."""
    logging.disable(logging.CRITICAL)
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--calls", metavar="MESSAGE", help="list the calls of its median frames")
    parser.add_argument("--family", choices=FAMILIES, help="only before this autopilot")
    asked = parser.parse_args()
    tracer = Tracer()
    for family in [asked.family] if asked.family else FAMILIES:
        seen = [one for one in watch(family, tracer) if asked.calls in (None, one.message)]
        kinds = [f"least {kind} | {kind} | most" for kind in Cost._fields]
        head = " | ".join(["message | brings | frames", *kinds])
        print(f"\n## {family}\n", *table(head, rows(seen)), sep="\n")
        for one in seen if asked.calls else ():
            print(f"\n{one.message}, bringing {', '.join(one.brought) or 'nothing'}:")
            print("\n".join(f"{call.file:36s} {call.function}" for call in one.median))


if __name__ == "__main__":
    main()
