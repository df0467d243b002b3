"""A companion's board beside a vehicle in closed loop: it is switched on, killed, started again."""

from dataclasses import replace

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.engine.checkpoint import LIMIT, Clocks
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.warm_start import WarmStart
from sim_autopilot.closed_loop import ClosedLoop
from sim_autopilot.config import SimConfig
from sim_autopilot.personality import Kind
from sim_autopilot.vehicle import Cold

SECOND_NS = 1_000_000_000
CLOCKS = Clocks(1_800_000_000 * SECOND_NS, 7 * SECOND_NS, bytes(range(16)))
QUIET = replace(
    SimConfig(),
    imu=replace(SimConfig().imu, rate=125.0),
    gnss=replace(SimConfig().gnss, noise_h=0.05, noise_v=0.08, noise_vel=0.05, delay=0.1),
    baro=replace(SimConfig().baro, noise=0.05, drift=0.0),
)
"""A receiver as the autopilots' own simulators have it: right to a decimetre."""
EARLY = Cold(error_n=(6.0, 0.0, -4.0), until=7.0)
"""Right again when the autopilot sets its origin, not when we set ours."""
LATE = Cold(error_n=(6.0, 0.0, -4.0), until=15.0)
"""Right again only when both have an origin."""


class Board:
    """One companion, with a disk that outlives it."""

    def __init__(self, loop: ClosedLoop, config: Config | None = None, **ways) -> None:
        """Plug it in, switched off."""
        self.loop, self.config, self.ways = loop, config or Config(), ways
        self.companion: Companion | None = None
        self.data: bytes | None = None
        self.limit = LIMIT
        """Age of a checkpoint that is too old, s."""
        self._connection = None

    def _clocks(self) -> Clocks:
        return CLOCKS.later(self.loop.now_ns)

    def start(self) -> None:
        """Start the daemon with what is on its disk."""
        now_ns = self.loop.now_ns
        warm_start = WarmStart(self.data, self._clocks(), now_ns, self.limit)
        self.companion = Companion(self.config, warm_start=warm_start)
        self._connection = self.loop.connect(self.companion, **self.ways)

    def save(self) -> None:
        """Write a checkpoint."""
        assert self.companion is not None
        self.data = self.companion.checkpoint(self._clocks()) or self.data

    def kill(self) -> None:
        """End the daemon, with the checkpoint that it wrote last."""
        self.loop.disconnect(self._connection)
        self.companion = self._connection = None

    def restart(self, gap: float, age: float = 0.0) -> None:
        """Kill it with a checkpoint so old, and start it again after so many seconds."""
        self.save()
        self.loop.run(age)
        self.kill()
        self.loop.run(gap)
        self.start()


def lifted(kind=Kind.ARDUPILOT, height=10.0, *, cold=None, seed=1, wait=25.0, start=0.0, **options):
    """Return a vehicle in the air on its first sources, and the board that was on from a time."""
    loop = ClosedLoop(kind, QUIET, cold=cold, seed=seed, **options)
    board = Board(loop)
    loop.run(start)
    board.start()
    loop.run(wait - start)
    loop.pilot.arm()
    loop.pilot.go(0.0, 0.0, height)
    loop.run(9.0)
    return loop, board


def land(loop: ClosedLoop) -> float:
    """Return home, and how far from it that is, m."""
    loop.pilot.return_home()
    assert loop.run_until(lambda: loop.pilot.mode == "DISARMED", 90.0)
    return float(np.hypot(*loop.vehicle.pos_n[:2]))
