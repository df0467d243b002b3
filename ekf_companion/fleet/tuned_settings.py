"""The result of a tuned fleet: keys of the configuration, each with its interval, and the gain."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ekf_companion.calibrate.result import Result, Setting
from ekf_companion.config.config import Config
from ekf_companion.fleet.tune import Fit, mean_and_error
from ekf_companion.fleet.tune_parameter import ARM, DELAY, PARAMETERS, WHITE_SHARE
from ekf_companion.logs.recording import counted

SHOWN = 5
"""Flights left aside that are named."""
OPEN = "these flights do not show it"
LEARNT = "likeliest; not set, as flights left out are likelier with noise that is learnt"


def result(found: Fit, config: Config) -> Result:
    """Return a fit as keys of the configuration; what the flights do not show are comments."""
    gnss = found.settings(config).gnss
    arm_is_shown = bool(found.is_shown[ARM].all())
    settings = [
        Setting(
            key="gnss.delay",
            value=round(float(found.values[DELAY]), 4),
            comment=_words(found, DELAY),
            is_sure=bool(found.is_shown[DELAY]),
        ),
        Setting(
            key="gnss.delay_std",
            value=math.ceil(found.delay_std * 1e3) / 1e3,
            comment="s; of the delay of another flight",
            is_sure=bool(found.is_shown[DELAY]),
        ),
        Setting(
            key="gnss.lever_arm",
            value=[round(part, 3) for part in gnss.lever_arm],
            comment="; ".join(
                f"{PARAMETERS[i].name} {_words(found, i)}" for i in range(ARM.start, ARM.stop)
            ),
            is_sure=bool(found.is_shown[ARM].any()),
        ),
        Setting(
            key="gnss.lever_arm_std",
            value=math.ceil(found.arm_std * 1e3) / 1e3,
            comment="m; of the axis that is known least",
            is_sure=arm_is_shown,
        ),
        *(_noise(found, i, "gnss", is_set=True) for i in range(4, 8)),
    ]
    if found.is_fixed:
        share = "the least: what the receiver states is its slow error"
        settings.append(Setting(key="gnss.white_share", value=WHITE_SHARE, comment=share))
    settings += [_noise(found, i, "imu", is_set=found.is_fixed) for i in range(8, 10)]
    if found.is_fixed:
        fixed = "the noise is as these flights had it; true where the next may vibrate more"
        settings.append(Setting(key="imu.learn_noise", value=False, comment=fixed))
    return Result(settings=settings, notes=list(_notes(found)), data=_data(found))


def _noise(found: Fit, i: int, section: str, *, is_set: bool) -> Setting:
    shown = bool(found.is_shown[i])
    return Setting(
        key=f"{section}.{PARAMETERS[i].name}",
        value=float(f"{found.values[i]:.3g}"),
        comment=_words(found, i) if is_set or not shown else f"{_words(found, i)}; {LEARNT}",
        is_sure=shown and is_set,
    )


def _words(found: Fit, i: int) -> str:
    one = PARAMETERS[i]
    words = f"{one.unit}; 95 %: {found.low[i]:.3g} to {found.high[i]:.3g}"
    if any(math.isclose(found.values[i], end) for end in (one.low, one.high)):
        words += ", at the end of the range that is searched"
    return words if found.is_shown[i] else f"{words}: {OPEN}"


def _notes(found: Fit) -> Iterator[str]:
    fixed, learnt = (mean_and_error(gains) for gains in found.gains.T)
    chosen, other = (fixed, learnt) if found.is_fixed else (learnt, fixed)
    kind, less = ("fixed", "learnt") if found.is_fixed else ("learnt", "fixed")
    yield f"fitted to {counted(found.flights, 'flight')}"
    yield (
        f"each flight left out in turn gains {chosen[0]:.1f} in log-likelihood by these keys, "
        f"noise {kind} (standard error {chosen[1]:.1f}); with noise {less} {other[0]:.1f}"
    )
    if not chosen[0] > 2.0 * chosen[1]:
        yield "that is no more than chance: keep the configuration that there is"
    for one in found.refused[:SHOWN]:
        yield f"left aside: {one}"
    if (more := len(found.refused) - SHOWN) > 0:
        yield f"left aside: {more} more"


def _data(found: Fit) -> dict[str, object]:
    fixed, learnt = (mean_and_error(gains) for gains in found.gains.T)
    parameters = {
        one.name: {
            "value": float(found.values[i]),
            "interval": [float(found.low[i]), float(found.high[i])],
            "is_shown": bool(found.is_shown[i]),
        }
        for i, one in enumerate(PARAMETERS)
    }
    return {
        "flights": found.flights,
        "parameters": parameters,
        "gain_fixed": {"mean": fixed[0], "standard_error": fixed[1]},
        "gain_learnt": {"mean": learnt[0], "standard_error": learnt[1]},
        "left_aside": list(found.refused),
    }
