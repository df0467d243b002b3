"""Whether an autopilot would fuse our ODOMETRY together with the GNSS that is in it already.

Pure functions of the autopilot's parameters. Our estimate is a function of the same fixes: fused
beside them it makes the covariance too small, and brings a glitch past the gate twice. Nothing is
sent to an autopilot whose parameters cannot be read.

Sources: PX4, parameters EKF2_EV_CTRL, EKF2_GPS_CTRL (1.14 and later), EKF2_SENS_EN (1.18),
EKF2_AID_MASK, EKF2_HGT_MODE (before); ArduPilot, EKF Source Selection and Switching, and
``AP_NavEKF_Source``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from ekf_companion.mavlink.decision import Decision, listed, says, streamed, withheld
from ekf_companion.mavlink.decode import Family

Mode = Literal["auto", "always", "never"]
Parameters = Mapping[str, float | None]
"""By name, as read; None: the autopilot has no such parameter. One that is absent has not been
answered."""

_VISION, _GNSS, _ENABLED = "EKF2_EV_CTRL", "EKF2_GPS_CTRL", "EKF2_SENS_EN"
_MASK, _HEIGHT = "EKF2_AID_MASK", "EKF2_HGT_MODE"
_DRIVER, _OPTIONS = "VISO_TYPE", "EK3_SRC_OPTIONS"
_PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
_SETS = {k: tuple(f"EK3_SRC{k}_{part}" for part in _PARTS) for k in (1, 2, 3)}

_PX4_NEW = (_VISION, _GNSS)
_PX4_OLD = (_MASK, _HEIGHT)
SUCCESSORS: Mapping[str, tuple[str, ...]] = dict.fromkeys(_PX4_OLD, _PX4_NEW)
"""By a parameter that newer firmware lacks, those that it has instead: the old one is requested
only where these stay unanswered or do not exist."""
_ARDUPILOT = (_DRIVER, _OPTIONS, *_SETS[1], *_SETS[2], *_SETS[3])
NAMES: Mapping[Family, tuple[str, ...]] = {
    Family.PX4: (*_PX4_NEW, _ENABLED, *_PX4_OLD),
    Family.ARDUPILOT: _ARDUPILOT,
    Family.UNKNOWN: (),
}
"""All parameters that may decide."""

_EV_BITS = {1: "horizontal position", 2: "height", 4: "velocity", 8: "yaw"}
_GNSS_BITS = {1: "position", 2: "height", 4: "velocity", 8: "yaw"}
_ENABLED_GNSS, _ENABLED_VISION = 0b11, 0b1000
"""Of EKF2_SENS_EN, PX4 1.18: what a ground station may switch off in flight, whatever the other
parameters say: both receivers; vision. Source: PX4 #26739, ``EstimatorFusionControl.msg``."""
_AID_EV_BITS = {8: "horizontal position", 16: "yaw", 256: "velocity"}
_AID_GNSS_BITS = {1: "position and velocity", 128: "yaw"}
_AID_OTHER_BITS = {2: "flow", 4: "no IMU bias", 32: "drag", 64: "a turned frame"}
_BITS = 1 << 32
"""Beyond all bits of a parameter."""
_GNSS_HEIGHT = 1
"""Of EKF2_HGT_MODE: the old filter then takes the height from GNSS, whatever the mask."""
_EXTERNAL, _GPS = 6, 3
_YAW_OF_GNSS = (2, 3, 8)
"""From two antennas, with the compass as fallback, and from the course (GSF)."""
_ALL_VELOCITIES = 1
"""Of EK3_SRC_OPTIONS, set by default: external velocities of every set are fused in every set."""


def decide(
    family: Family,
    parameters: Parameters,
    mode: Mode = "auto",
    independent: bool = False,
    is_complete: bool = True,
) -> Decision:
    """Decide whether ODOMETRY is sent, from the autopilot's answers so far.

    ``mode`` and ``independent`` are the configuration's, of ``output.odometry``; ``is_complete`` is
    whether no more answers are waited for.
    """
    decision = _decide(family, parameters, mode, independent, is_complete)
    read = {name: value for name, value in parameters.items() if value is not None}
    is_fused, is_yaw_fused = _taken(family, parameters) if decision.is_streaming else (False, False)
    return replace(
        decision,
        parameters=read,
        is_fused=is_fused,
        is_yaw_fused=is_yaw_fused,
        is_alternative=is_fused and _is_alternative(family, parameters),
        is_followed_from_start=is_fused and _is_from_start(family, parameters),
    )


def _decide(
    family: Family, parameters: Parameters, mode: Mode, independent: bool, is_complete: bool
) -> Decision:
    if mode == "never":
        return withheld("output.odometry.mode is never", text="ODOMETRY is switched off")
    if mode == "always":
        reason = "output.odometry.mode is always: nothing guards against counting GNSS twice"
        unguarded = streamed(reason, "ODOMETRY is streamed unguarded")
        return replace(unguarded, is_warning=True)
    if independent:
        return streamed("our sensors are our own (output.odometry.independent)")
    if family is Family.UNKNOWN:
        return streamed("who listens is neither PX4 nor ArduPilot")
    if not is_complete and (unread := missing(family, parameters)):
        reason = f"the autopilot is being asked for {listed(unread)}"
        return replace(withheld(reason), is_settled=False)
    if family is Family.ARDUPILOT:
        return _by_ardupilot(parameters)
    if is_old(family, parameters) and (mask := parameters.get(_MASK)) is not None:
        return _by_old_px4(parameters, int(mask) % _BITS)
    return _by_px4(parameters)


def is_old(family: Family, parameters: Parameters) -> bool:
    """Return whether it is a PX4 before 1.14, by the parameters that it has."""
    has_newer = parameters.get(_VISION) is not None or parameters.get(_GNSS) is not None
    return family is Family.PX4 and not has_newer and parameters.get(_MASK) is not None


def missing(family: Family, parameters: Parameters) -> tuple[str, ...]:
    """Return the parameters that must be waited for before the decision."""
    if family is Family.PX4:
        vision = parameters.get(_VISION)
        if vision is None:
            return _unanswered((*_PX4_NEW, *_PX4_OLD), parameters)
        if not _bits(vision, _EV_BITS):
            return ()
        return _unanswered((_GNSS,), parameters)
    if family is Family.ARDUPILOT and (_DRIVER not in parameters or parameters[_DRIVER]):
        return _unanswered(_ARDUPILOT, parameters)
    return ()


def helpful(family: Family, parameters: Parameters) -> tuple[str, ...]:
    """Return what may yet lift the guard, and is not waited for: much firmware lacks it."""
    if family is not Family.PX4:
        return ()
    both = _bits(parameters.get(_VISION), _EV_BITS) and _bits(parameters.get(_GNSS), _GNSS_BITS)
    return _unanswered((_ENABLED,), parameters) if both else ()


def _taken(family: Family, parameters: Parameters) -> tuple[bool, bool]:
    """Return whether the autopilot fuses our estimate, and our yaw; unread, it counts as both."""
    if family is Family.UNKNOWN:
        return False, False
    if family is Family.ARDUPILOT:
        if not parameters.get(_DRIVER, 1):
            return False, False
        if _unanswered(_ARDUPILOT, parameters):
            return True, True
        own = {name for names in _SETS.values() for name in names if parameters[name] == _EXTERNAL}
        return bool(own), any(name.endswith("YAW") for name in own)
    if parameters.get(_VISION) is not None:
        ours = _bits(parameters[_VISION], _EV_BITS) if _is_on(parameters, _ENABLED_VISION) else []
        return bool(ours), _EV_BITS[8] in ours
    mask = parameters.get(_MASK)
    if mask is not None and parameters.get(_GNSS) is None:
        ours = _bits(mask, _AID_EV_BITS, {**_AID_GNSS_BITS, **_AID_OTHER_BITS})
        return bool(ours), _AID_EV_BITS[16] in ours
    is_unread = _VISION not in parameters
    return is_unread, is_unread


def _is_alternative(family: Family, parameters: Parameters) -> bool:
    """Return whether a source set of ArduPilot's that has a position has none of ours."""
    positions = [parameters.get(names[0]) for names in _SETS.values()]
    is_own = any(value not in (None, 0.0, _EXTERNAL) for value in positions)
    return family is Family.ARDUPILOT and is_own


def _is_from_start(family: Family, parameters: Parameters) -> bool:
    """Return whether the position of the set that ArduPilot begins with is ours."""
    return family is Family.ARDUPILOT and parameters.get(_SETS[1][0]) == _EXTERNAL


def watched(family: Family, parameters: Parameters) -> tuple[str, ...]:
    """Return the parameters whose change would change the decision."""
    if family is Family.PX4:
        if parameters.get(_VISION) is None:
            return (*_PX4_NEW, *_PX4_OLD)
        return _PX4_NEW if parameters.get(_ENABLED) is None else (*_PX4_NEW, _ENABLED)
    if family is Family.ARDUPILOT and not parameters.get(_DRIVER, 1):
        return (_DRIVER,)
    return NAMES[family]


# PX4


def _by_px4(parameters: Parameters) -> Decision:
    if _VISION not in parameters:
        return _unread((_VISION,), parameters)
    vision = parameters[_VISION]
    ours = _bits(vision, _EV_BITS)
    if vision is None or not ours:
        return streamed(says(_VISION, vision, "the autopilot fuses nothing of ours"))
    if _GNSS not in parameters:
        return _unread((_GNSS,), parameters)
    theirs = _bits(parameters[_GNSS], _GNSS_BITS)
    if not theirs:
        reason = says(_GNSS, parameters[_GNSS], "the autopilot fuses ours, and no GNSS")
        return streamed(reason)
    enabled = parameters.get(_ENABLED)
    if not _is_on(parameters, _ENABLED_VISION):
        return streamed(says(_ENABLED, enabled, "vision is switched off in the autopilot"))
    if not _is_on(parameters, _ENABLED_GNSS):
        return streamed(says(_ENABLED, enabled, "GNSS is switched off in the autopilot"))
    return withheld(
        f"{_VISION} is {vision:g} and {_GNSS} is {parameters[_GNSS]:g}: the autopilot would fuse "
        f"our {listed(ours)} together with the {listed(theirs)} of the GNSS that is in it",
        f"set {_GNSS} to 0 to fly on our estimate, or {_VISION} to 0 to fly on GNSS",
        f"no ODOMETRY: set {_GNSS} 0",
        is_double=True,
    )


def _is_on(parameters: Parameters, bits: int) -> bool:
    """Return whether one of these bits of EKF2_SENS_EN is set; firmware without it has all on."""
    enabled = parameters.get(_ENABLED)
    return enabled is None or bool(int(enabled) % _BITS & bits)


def _by_old_px4(parameters: Parameters, mask: int) -> Decision:
    """Decide by the one mask for both of PX4 before 1.14."""
    # An unknown bit may mean either
    ours = _bits(mask, _AID_EV_BITS, {**_AID_GNSS_BITS, **_AID_OTHER_BITS})
    theirs = _bits(mask, _AID_GNSS_BITS, {**_AID_EV_BITS, **_AID_OTHER_BITS})
    known = sum((*_AID_EV_BITS, *_AID_GNSS_BITS, *_AID_OTHER_BITS))
    if not ours:
        return streamed(f"{_MASK} is {mask}: the autopilot fuses nothing of ours")
    if theirs:
        lone, alone = mask & known & ~sum(_AID_GNSS_BITS), mask & known & ~sum(_AID_EV_BITS)
        return withheld(
            f"{_MASK} is {mask}: the autopilot would fuse our {listed(ours)} together with the "
            f"{listed(theirs)} of the GNSS that is in it",
            f"set {_MASK} to {lone} to fly on our estimate, or to {alone} to "
            "fly on GNSS, and reboot",
            f"no ODOMETRY: set {_MASK} {lone}",
            is_double=True,
        )
    height = parameters.get(_HEIGHT)
    if height is None:
        return _unread((_HEIGHT,), parameters)
    if height == _GNSS_HEIGHT:
        return withheld(
            f"{_HEIGHT} is 1 and {_MASK} is {mask}: the autopilot would fuse our {listed(ours)} "
            "together with the height of the GNSS that is in it",
            f"set {_HEIGHT} to 3 (vision) or 0 (barometer), and reboot",
            f"no ODOMETRY: set {_HEIGHT} 3",
            is_double=True,
        )
    return streamed(f"{_MASK} is {mask}: the autopilot fuses ours, and no GNSS")


# ArduPilot


def _by_ardupilot(parameters: Parameters) -> Decision:
    if not parameters.get(_DRIVER, 1):
        reason = says(_DRIVER, parameters[_DRIVER], "the autopilot takes no ODOMETRY")
        return streamed(reason)
    if unread := _unanswered(_ARDUPILOT, parameters):
        return _unread(unread, parameters)
    pooled = _pooled(parameters)
    is_taken = False
    for names in _SETS.values():
        own = [name for name in names if parameters.get(name) == _EXTERNAL]
        ours = [*own, *(name for name in pooled if name not in own)]
        theirs = [name for name in names if _is_of_gnss(name, parameters.get(name))]
        is_taken = is_taken or bool(ours)
        if ours and theirs:
            return _double(own, ours, theirs, parameters)
    if not is_taken:
        return streamed("no EK3_SRCn_* is 6: the autopilot fuses nothing of ours")
    return streamed("the autopilot fuses ours, and no EK3_SRCn set has GNSS too")


def _double(own: list[str], ours: list[str], theirs: list[str], parameters: Parameters) -> Decision:
    """Return the decision where one of the source sets has both."""
    listing = ", ".join(f"{name} {parameters[name]:g}" for name in (*ours, *theirs))
    if own:
        remedy = f"set {listed(theirs)} to 6 to fly on our estimate"
        text = f"no ODOMETRY: set {theirs[0]} 6"
    else:
        # The sets are alternatives, but for the velocities
        lone = int(parameters[_OPTIONS] or 0) & ~_ALL_VELOCITIES
        listing += f", {_OPTIONS} {parameters[_OPTIONS]:g}"
        remedy = f"set {_OPTIONS} to {lone}, so that only the set in use is fused"
        text = f"no ODOMETRY: set {_OPTIONS} {lone}"
    return withheld(
        f"the autopilot would fuse it together with the GNSS that is in it: {listing}",
        f"{remedy}, or {_DRIVER} to 0 to fly on GNSS",
        text,
        is_double=True,
    )


def _pooled(parameters: Parameters) -> list[str]:
    """Return the external velocities that are fused whichever set is in use."""
    if not int(parameters.get(_OPTIONS) or 0) & _ALL_VELOCITIES:
        return []
    names = [f"EK3_SRC{k}_{part}" for k in _SETS for part in ("VELXY", "VELZ")]
    return [name for name in names if parameters.get(name) == _EXTERNAL]


def _is_of_gnss(name: str, value: float | None) -> bool:
    return value in _YAW_OF_GNSS if name.endswith("YAW") else value == _GPS


# Words


def _unread(names: tuple[str, ...], parameters: Parameters) -> Decision:
    """Return the decision where parameters were not answered, or none at all."""
    question = "cannot find out whether the autopilot would fuse it together with GNSS"
    if all(value is None for value in parameters.values()):
        return withheld(
            f"{question}: it answers no request for a parameter",
            "check that it hears us on this link, or set output.odometry.mode to always",
            "no ODOMETRY: no parameter is answered",
        )
    return withheld(
        f"{question}: it did not answer for {listed(names)}",
        f"look for {names[0]} in a ground station; where this firmware has none, set "
        "output.odometry.mode to always",
        f"no ODOMETRY: {names[0]} unread",
    )


def _unanswered(names: tuple[str, ...], parameters: Parameters) -> tuple[str, ...]:
    return tuple(name for name in names if name not in parameters)


def _bits(
    value: float | None, meanings: Mapping[int, str], others: Mapping[int, str] | None = None
) -> list[str]:
    """Return what the set bits mean, unknown ones too: a later firmware may fuse by them."""
    mask = int(value or 0) % _BITS
    unknown = mask & ~sum(meanings) & ~sum(others or {})
    known = [meaning for bit, meaning in meanings.items() if mask & bit]
    return [*known, *([f"something unknown ({unknown})"] if unknown else [])]
