"""Why an estimate has no position yet, with the remedy."""

from __future__ import annotations

from collections.abc import Mapping

from ekf_companion.core.memory.enums import Aid, Arrival, Verdict
from ekf_companion.engine.health import Health
from ekf_companion.nav.measurements import Kind

_FEW_FIELDS = 10
"""A working magnetometer of 10 Hz or more gives so many different readings within a second."""
_SIMULATOR = "in ArduPilot's simulator set SIM_MAG_RND 5"


def lacking(health: Health, refused: Mapping[str, int]) -> str:
    """Return why an estimate has no position yet, and what to do; the first cause only.

    Args:
        health: The filter's account; its status is INIT, ALIGNING or ATTITUDE.
        refused: How often a message's content was refused, by ``message: why``.
    """
    if not health.arrivals[Kind.GNSS][Arrival.TAKEN]:
        return _no_fix(refused)
    verdicts = health.verdicts[Aid.HEADING]
    if verdicts[Verdict.FUSED] + verdicts[Verdict.DEWEIGHTED]:
        return "fixes and a heading have come, and the vehicle moves: let it stand for a second"
    return f"north is not found: {_no_heading(health, refused)}; or fly: north follows from motion"


def _no_fix(refused: Mapping[str, int]) -> str:
    found = {key: n for key, n in refused.items() if key.startswith("GPS_RAW_INT: ")}
    if not found:
        return "no fix has come: check that the autopilot has a receiver and sends GPS_RAW_INT"
    why = max(found, key=lambda key: found[key]).partition(": ")[2]
    return f"no fix can be used ({why}): give the receiver a free view of the sky"


def _no_heading(health: Health, refused: Mapping[str, int]) -> str:
    """Return why no heading is used; that of the autopilot is the last resort."""
    fields = health.arrivals[Kind.MAG][Arrival.TAKEN]
    if refused.get("mag: no field of the Earth"):
        why = "the magnetometer's field is not the Earth's: check its unit and its calibration"
    elif health.verdicts[Aid.HEADING][Verdict.DISTURBED]:
        why = "the magnetic field is disturbed: calibrate the magnetometer, away from iron"
    elif 0 < fields < _FEW_FIELDS:
        why = "the magnetometer repeats one reading: check it, or restart the autopilot"
        why += f"; {_SIMULATOR}"
    elif fields:
        why = "no magnetic field is used: see the verdicts of heading in /status"
    else:
        why = "no magnetic field comes: check that the autopilot has a magnetometer"
    if refused.get("heading: made of our own"):
        why += " (the autopilot's heading is made of ours)"
    return why
