"""What a lidar costs live: datagrams in, poses out, without sockets, on one thread.

The lidar has the points of a Livox Mid-360: 20 000 in a scan of 0.1 s.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.document import table
from ekf_companion.lidar.live import Live
from ekf_companion.lidar.recording import Mounting
from ekf_companion.lidar.settings import Settings
from sim_autopilot.lidar.beams import Beams
from sim_autopilot.lidar.livox import datagrams
from sim_autopilot.lidar.record import Lidar, simulate

HEAD = "world | points a scan | a scan, ms: mean, 95 % | the start, ms | a datagram, us | off, m"
MID_360 = Beams("mid360", 4, 5000, -7, 52, is_rosette=True, nearest=0.1, farthest=60)
LENGTH, SEED = 12.0, 3
"""s."""


def rows() -> Iterator[str]:
    """Yield the rows of the table."""
    for world in ("room", "hall"):
        flown = simulate(world, SEED, duration=LENGTH, lidar=Lidar(MID_360))
        live = Live(Mounting(flown.lidar.rotation, flown.lidar.position), Settings())
        poses, spent, received, count = [], [], 0.0, 0
        for t_ns, _, datagram in datagrams(flown, 1):
            begin = time.process_time()
            live.receive(datagram, t_ns)
            job = live.take()
            received += time.process_time() - begin
            count += 1
            if job is not None:
                begin = time.process_time()
                poses += live.process(job)
                spent.append(1e3 * (time.process_time() - begin))
        first, last = (np.array([one.t_ns * 1e-9]) for one in (poses[0], poses[-1]))
        way = flown.motion.position(last)[0] - flown.motion.position(first)[0]
        seen = flown.motion.rotation(first)[0] @ poses[0].C.T @ poses[-1].pos
        cost = np.array(spent)
        after = cost[int(np.argmax(cost)) + 1 :]
        yield " | ".join(
            [
                world,
                f"{len(flown.xyz) / len(flown.stamp):.0f}",
                f"{after.mean():.1f}, {np.percentile(after, 95):.1f}",
                f"{cost.max():.0f}",
                f"{1e6 * received / count:.1f}",
                f"{np.linalg.norm(seen - way):.3f}",
            ]
        )


def main() -> None:
    """Print the table."""
    for one in table(HEAD, rows()):
        print(one, flush=True)


if __name__ == "__main__":
    main()
