"""Fly the autopilots' simulators, score them against their truth, and judge each line.

``make sitl PX4=PATH ARDUPILOT=PATH``: a simulator without a path is left out, in a sentence.
docs/SITL.md says what each line means.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from benchmarks.document import table
from benchmarks.sitl import basic, faults, links, sources, starts, wings
from benchmarks.sitl.line import Line
from benchmarks.sitl.simulator import ArduCopter, ArduPlane, Px4, Rover, Simulator
from ekf_companion.errors import CompanionError

HEAD = "simulator | flight | quantity | found | limit | verdict"

PARTS: dict[str, Callable[[Simulator, Path], Iterator[Line]]] = {
    "paths": basic.compared,
    "outage": basic.lost,
    "restart": basic.restarted,
    "switch": basic.switched,
    "endurance": basic.lasting,
    "reboot": basic.rebooted,
    "cold": starts.cold,
    "late": starts.late,
    "stale": starts.stale,
    "fix": starts.before_fix,
    "links": links.linked,
    "second": sources.second,
    "compass": sources.compass,
    "receivers": sources.receivers,
    "faults": faults.faulty,
    "moving": faults.moving_outage,
    "legs": faults.long_legs,
    "wing": wings.winged,
}
_BESIDE = {ArduPlane: "arduplane", Rover: "ardurover"}
"""Binaries that lie beside ArduCopter's."""


def _simulators(arguments: argparse.Namespace) -> Iterator[Simulator]:
    """Yield those that are there; print of each other that it is left out."""
    asked: tuple[tuple[type[Simulator], str | None, str], ...] = (
        (Px4, arguments.px4, "PX4"),
        (ArduCopter, arguments.ardupilot, "ARDUPILOT"),
    )
    for kind, path, variable in asked:
        if path:
            yield kind(Path(path), arguments.instance)
        else:
            print(
                f"{kind.name}: left out; give the path of its simulator: make sitl {variable}=PATH"
            )
    if not arguments.ardupilot:
        return
    for kind, name in _BESIDE.items():
        binary = Path(arguments.ardupilot).with_name(name)
        if binary.exists():
            yield kind(binary, arguments.instance)
        else:
            print(f"{kind.name}: left out; {binary} is not there")


def main() -> int:
    """Fly; return 1 if a line is bad."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--px4", metavar="PATH", help="bin/px4 in a build of px4_sitl_default")
    parser.add_argument(
        "--ardupilot",
        metavar="PATH",
        help="bin/arducopter in a build for sitl; arduplane and ardurover beside it are flown too",
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--vehicles", nargs="+", metavar="NAME", help="of those that are there")
    parser.add_argument("--wires", nargs="+", metavar="NAME", help="lines of the part links")
    parser.add_argument("--pairs", type=int, default=3, help="of flights of the paths (3)")
    parser.add_argument("--instance", type=int, default=0, help="ArduPilot's ports are 10 further")
    parser.add_argument("--out", type=Path, default=Path("build/sitl"), help="for all logs")
    arguments = parser.parse_args()
    # The processes of a flight are ended in any case
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    parts = PARTS | {"paths": partial(basic.compared, pairs=arguments.pairs)}
    parts["links"] = partial(links.linked, names=arguments.wires)
    rows, is_bad = [], False
    for simulator in _simulators(arguments):
        if arguments.vehicles and simulator.name not in arguments.vehicles:
            continue
        for part in arguments.only:
            if part not in (simulator.parts or PARTS):
                continue
            try:
                for line in parts[part](simulator, (arguments.out / simulator.name).resolve()):
                    is_bad |= not line.is_good
                    rows.append(line.row(simulator.name))
                    print(rows[-1], flush=True)
            except (CompanionError, OSError) as error:
                is_bad = True
                rows.append(f"{simulator.name} | {part} | {error} | | | **not flown**")
                print(rows[-1], flush=True)
    if rows:
        print()
        print("\n".join(table(HEAD, rows)))
    return int(is_bad)


if __name__ == "__main__":
    sys.exit(main())
