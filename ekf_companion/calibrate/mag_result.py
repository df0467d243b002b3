"""Measured iron as keys of the configuration."""

from __future__ import annotations

from typing import Any

import numpy as np

from ekf_companion.calibrate import ellipsoid
from ekf_companion.calibrate.mag import Iron
from ekf_companion.calibrate.result import Result, Setting, rounded, spelled

AXES = ("forward", "right", "down")
FEW = 0.1
"""Share of directions below which hard iron is a guess."""
DISTURBED = 0.03
"""Remaining error of the strength above which motors, or the place, change the field, gauss."""


def result(found: Iron) -> Result:
    """Return measured iron as keys of the configuration."""
    fit = found.fit
    is_whole = found.method == "ellipsoid"
    is_sure = bool((np.abs(fit.hard) > 2.0 * fit.hard_std).any())
    is_sure |= is_whole and bool(np.abs(fit.soft - np.eye(3)).max() > 2.0 * fit.soft_std)
    remark = "" if is_sure else "; no more than its uncertainty: leave it as it is"
    axes = zip(AXES, fit.hard_std, found.determined, strict=True)
    stds = [f"{axis} {f'{std:.3f}' if known else 'not determined'}" for axis, std, known in axes]
    settings = [
        Setting(
            key="heading.hard_iron",
            value=fit.hard.round(4).tolist(),
            comment=f"gauss; one sigma: {', '.join(stds)}{remark}",
            is_sure=is_sure,
        )
    ]
    if is_whole:
        soft_iron = Setting(
            key="heading.soft_iron",
            value=fit.soft.round(4).tolist(),
            comment=f"one sigma of an element up to {fit.soft_std:.3f}",
            is_sure=is_sure,
        )
        settings.append(soft_iron)
    return Result(settings=settings, notes=_notes(found), data=_data(found))


def _notes(found: Iron) -> list[str]:
    """Return what the numbers are based on, as sentences."""
    fit, extremes = found.fit, found.by_extremes
    where = "by the World Magnetic Model there" if found.is_place_known else "as it was measured"
    notes = [
        f"strength of the field: {found.strength:.3f} gauss {where}; the magnetometer's differs by "
        f"{found.rms_before:.3f} RMS as it is, by {fit.rms:.3f} after the {found.method} below",
        f"the field has come from {100.0 * found.share:.0f} % of all directions",
    ]
    if found.method == "hard iron":
        notes.append(
            "too few to tell soft iron, so hard iron alone was fitted, and its sigma allows for "
            f"a soft iron of {100.0 * ellipsoid.LIKELY_SOFT:.0f} %; for both, turn the vehicle all "
            "ways round, nose up, nose down, on each side and on its back"
        )
    if found.method == "hard iron" and found.share < FEW:
        notes.append(
            "that is very few: the answer leans on the strength of the field and on the "
            "magnetometer's scale. Believe it only if another flight agrees"
        )
    if found.method == "circle":
        axis = AXES[int(np.argmin(found.determined))]
        notes.append(
            f"the vehicle has turned about its {axis} axis only: hard iron {axis} is not "
            "determined and left at 0; tilted, the compass will be off. Turn it all ways round"
        )
    if fit.rms > DISTURBED:
        notes.append(
            "what remains is large: currents of the motors, or iron near by, change the field. "
            "Calibrate in the open, and mount the compass away from wires"
        )
    notes.append(
        "by largest and smallest values (offset half their sum, scale half their difference): "
        f"hard_iron {spelled(extremes.hard.tolist())}, soft_iron diagonal "
        f"{spelled(np.diag(extremes.soft).tolist())}, which leaves {extremes.rms:.3f} RMS"
    )
    return notes


def _data(found: Iron) -> dict[str, Any]:
    fit, extremes = found.fit, found.by_extremes
    return {
        "method": found.method,
        "hard_iron_gauss": rounded(fit.hard),
        "hard_iron_std_gauss": rounded(np.where(found.determined, fit.hard_std, np.nan)),
        "soft_iron": rounded(fit.soft),
        "soft_iron_std": rounded(fit.soft_std) if found.method == "ellipsoid" else None,
        "determined": dict(zip(AXES, found.determined.tolist(), strict=True)),
        "rms_gauss": {
            "before": rounded(found.rms_before),
            "after": rounded(fit.rms),
            "by_extremes": rounded(extremes.rms),
        },
        "by_extremes": {
            "hard_iron_gauss": rounded(extremes.hard),
            "soft_iron": rounded(extremes.soft),
        },
        "strength_gauss": rounded(found.strength),
        "share_of_directions": found.share,
    }
