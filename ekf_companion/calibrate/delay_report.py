"""A delay, told: keys of the configuration, and the figure of its likelihood."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ekf_companion.calibrate.delay import DROP, Delay
from ekf_companion.calibrate.report import Finding, Result, rounded


def result(found: Delay) -> Result:
    """Give what was found as keys of the configuration."""
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
        findings=[
            Finding(
                key="gnss.delay",
                value=round(found.best, 3),
                comment=f"s; 95 %: {found.low:.3f} to {found.high:.3f}",
            ),
            Finding(
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


def draw(found: Delay, sheet: Any) -> None:
    """Draw the log-likelihood by delay, all of it and near the best, into a matplotlib figure."""
    whole, near = sheet.subplots(1, 2)
    reach = 3.0 * max(found.best - found.low, found.high - found.best, 0.005)
    for axis in (whole, near):
        axis.plot(found.delays, found.gain, ".-", color="#1f77b4", linewidth=1.0, markersize=3)
        axis.axvspan(found.low, found.high, color="#d62728", alpha=0.15, label="95 %")
        axis.axvline(found.best, color="#d62728", label=f"{found.best:.3f} s")
        axis.set(xlabel="gnss.delay, s", ylabel="log-likelihood over the best")
        axis.grid(visible=True, alpha=0.3)
    inside = np.abs(found.delays - found.best) <= reach
    lowest = float(found.gain[inside].min(initial=-3.0 * DROP))
    near.set(xlim=(found.best - reach, found.best + reach), ylim=(1.05 * lowest, -0.03 * lowest))
    near.axhline(-DROP * found.widening, color="#7f7f7f", linestyle=":", linewidth=1.0)
    whole.set_title("all delays tried")
    near.set_title("near the best")
    near.legend()
