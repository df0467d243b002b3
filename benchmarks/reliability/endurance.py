"""Run the filter for 10^8 inertial samples and look at its covariance: ``make endurance``.

A hover is flown again and again, each time later, so that every step has new times and the filter
all that a flight has. After each round P must be symmetric to the bit and positive definite.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Events, Kind
from sim_autopilot import events as wire
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight

SECONDS = 300.0


def main() -> None:
    """Print the least eigenvalue of P, scaled to a unit diagonal, 20 times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=float, default=1e8)
    asked = parser.parse_args()
    config = SimConfig()
    config = replace(config, imu=replace(config.imu, rate=250.0))
    events = wire.events(Flight.plan("hover", config, seed=1, duration=SECONDS))
    # from the take-off on, so that every round joins the one before it
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    start, round_ = events.take(t < 15.0), events.take(t >= 15.0)
    length = int(round_.t_ns.max() - round_.t_ns.min()) + 4_000_000
    pipeline = Pipeline(FilterSettings(), "px4")
    pipeline.run(start)
    rounds = int(np.ceil(asked.steps / np.count_nonzero(round_.kind == Kind.IMU)))
    least = np.inf
    for count in range(rounds):
        later = Events(t_ns=round_.t_ns + count * length, kind=round_.kind, values=round_.values)
        pipeline.run(later)
        x = as_state(pipeline._timeline.block())
        P = np.array(x.P)
        scale = np.sqrt(np.diag(P))
        if not np.array_equal(P, P.T) or not (scale > 0.0).all():
            sys.exit(f"round {count}: P is not symmetric, or has a variance of zero")
        least = min(least, float(np.linalg.eigvalsh(P / np.outer(scale, scale)).min()))
        if least <= 0.0:
            sys.exit(f"round {count}: P is not positive definite")
        if (count + 1) % max(1, rounds // 20) == 0:
            samples = x.samples
            print(
                f"{samples:.3g} samples: least eigenvalue of the correlation {least:.2e}, "
                f"resets {x.resets:.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
