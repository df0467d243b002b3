"""A measured delay as keys of the configuration."""

from __future__ import annotations

import math

from ekf_companion.calibrate.delay import Delay
from ekf_companion.calibrate.result import Result, Setting, rounded


def result(found: Delay) -> Result:
    """Return a measured delay as keys of the configuration."""
    sigma = max((found.high - found.low) / 3.92, 0.002)
    notes = [
        f"{found.rows} innovations of GNSS in {found.seconds:.0f} s, horizontal acceleration "
        f"{found.acceleration:.1f} m/s2 RMS",
        f"the estimator by itself finds {found.learnt:.3f} s in this flight",
    ]
    if found.widening > 1.5:
        notes.append(
            f"the interval is {math.sqrt(found.widening):.1f} times as wide as independent "
            "innovations would make it"
        )
    return Result(
        settings=[
            Setting(
                key="gnss.delay",
                value=round(found.best, 3),
                comment=f"s; 95 %: {found.low:.3f} to {found.high:.3f}",
            ),
            Setting(
                key="gnss.delay_std",
                value=math.ceil(sigma * 1e3) / 1e3,
                comment="s; of that interval. auto lets the estimator move it more",
            ),
        ],
        notes=notes,
        data={
            "delay_s": found.best,
            "interval_s": [found.low, found.high],
            "widening": found.widening,
            "learnt_s": found.learnt,
            "acceleration_mps2": found.acceleration,
            "curve": {"delay_s": rounded(found.delays), "log_likelihood": rounded(found.gain)},
        },
    )
