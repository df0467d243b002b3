"""The stages by the status of a daemon that runs and has the link for itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ekf_companion.doctor.diagnosis import GATES
from ekf_companion.doctor.stage import (
    NOT_REACHED,
    Outcome,
    Problem,
    Stage,
    StageResult,
    failed,
    judged,
    unknown,
    warning,
)

Data = Mapping[str, Any]
"""What ``/status`` answers, or a part of it."""
SILENT_S = 2.0
"""Seconds without a byte, as in ``status/judge``."""
_FIRST = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "GPS_RAW_INT", "ATTITUDE", "GLOBAL_POSITION_INT")
"""Messages that are named before others."""
_STATUS = "`ekf-companion status` (with the same --url)"
OLD_S = 1.0
"""Seconds without an inertial sample, as there."""


def diagnose_running(status: Data) -> list[StageResult]:
    """Judge every stage of a running daemon; those that a failed one hides are unknown.

    Causes and remedies are those of the daemon's status.
    """
    results: list[StageResult] = []
    is_hidden = False
    for stage in Stage:
        judge = _JUDGES.get(stage)
        if judge is None or is_hidden:
            words = (
                NOT_REACHED if is_hidden else "not in a daemon's status: --link or --log shows it"
            )
            results.append(unknown(stage, words))
            continue
        saw, problems = judge(status)
        results.append(judged(stage, saw, problems))
        is_hidden = stage in GATES and results[-1].outcome is Outcome.FAILED
    return results


_Seen = tuple[str, list[Problem]]


def _words(status: Data) -> str:
    """Return the daemon's own words on its state, as a sentence."""
    words = str(status["health"]["words"])
    return f"{words[0].upper()}{words[1:]}."


def _missing(status: Data) -> str:
    """Return which input the daemon reports as missing, ahead of the estimate."""
    words = str(status["health"]["words"])
    words = words.partition("; ")[2] or words
    return f"{words[0].upper()}{words[1:]}."


def _link(status: Data) -> _Seen:
    link = status["link"]
    if link["is_open"]:
        return f"{link['url']} is open", []
    remedy = "Look at the device or the host that link.url names; the daemon tries it every second."
    return f"{link['url']}: {link['failure'] or 'not open yet'}", [failed(_missing(status), remedy)]


def _bytes(status: Data) -> _Seen:
    link = status["link"]
    silent_s = link["silent_s"]
    saw = f"{link['bytes_in']} bytes"
    if silent_s is None or silent_s > SILENT_S:
        saw += ", none now" if link["bytes_in"] else ""
        remedy = "Look at the wire and the baud rate, or at where the other end sends."
        return saw, [failed(_missing(status), remedy)]
    return saw, []


def _frames(status: Data) -> _Seen:
    frames = status["frames"]
    saw = f"{frames['frames']} frames"
    if not frames["frames"]:
        cause = "Bytes come, and no frame of MAVLink is in them."
        return saw, [failed(cause, "Look at the baud rate: it must be the autopilot's.")]
    return saw, []


def _checksums(status: Data) -> _Seen:
    frames = status["frames"]
    good, bad = frames["frames"], frames["bad_crc"]
    return f"{bad / max(good + bad, 1):.1%} wrong ({bad} of {good + bad})", []


def _source(status: Data) -> _Seen:
    peer = status["peer"]
    if peer is None:
        remedy = "Look at link.autopilot, link.allow_systems and signing."
        return "no autopilot", [failed(_missing(status), remedy)]
    saw = f"{peer['system_id']}/{peer['component_id']} {peer['family']} {peer['version']}".strip()
    if not peer["is_heard"]:
        cause = f"The autopilot has been silent for {peer['silent_s']:.1f} s."
        return saw, [failed(cause, "Look at its power, and at what else was unplugged.")]
    return saw, []


def _messages(status: Data) -> _Seen:
    age_s = status["sample_age_s"]
    coming = [name for name, message in status["messages"].items() if message["rate"]]
    coming.sort(key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))
    saw = ", ".join(coming[:6]) or "none"
    if age_s is None or age_s > OLD_S:
        remedy = f"{_STATUS} shows what was asked for, and the answers."
        return saw, [failed(_missing(status), remedy)]
    return saw, []


def _rates(status: Data) -> _Seen:
    messages = status["messages"]
    asked = {name: message for name, message in messages.items() if message["asked"]}
    parts = [
        f"{name} {one['rate']:.0f} of {one['asked']:.0f} Hz"
        for name, one in asked.items()
        if one["rate"]
    ]
    if absent := [name for name, one in asked.items() if not one["rate"]]:
        parts.append(f"none of {', '.join(absent)}")
    saw = ", ".join(parts)
    problems = [
        warning(f"{name} comes too rarely.", f"{one['cause'][0].upper()}{one['cause'][1:]}.")
        for name, one in messages.items()
        if one["cause"]
    ]
    return saw or "nothing was asked for", problems


def _time(status: Data) -> _Seen:
    time = status["time"]
    saw = f"since {time['base']}, {'' if time['is_locked'] else 'not '}synchronised"
    return saw, [warning("The clocks are not compared.", time["trouble"])] if time[
        "trouble"
    ] else []


def _estimate(status: Data) -> _Seen:
    estimator, health = status["estimator"], status["health"]
    if not estimator:
        return "none", [failed(_words(status), f"See the aids in {_STATUS}.")]
    name = str(estimator["status"])
    words = "; ".join(estimator["reasons"].values()) or health["words"]
    remedy = f"See what became of each aid in {_STATUS}."
    if not health["is_healthy"] or name in ("init", "aligning", "attitude", "invalid"):
        return name, [failed(_words(status), remedy)]
    if name != "ok":
        return name, [warning(f"The estimate is {name.replace('_', ' ')}: {words}.", remedy)]
    return name, []


def _sent(status: Data) -> _Seen:
    output = status["output"]
    if output["is_streaming"]:
        return f"ODOMETRY {output['rate']:.0f} Hz", []
    why = output["silence"] or output["reason"] or "nothing is due yet"
    remedy = output["remedy"] or "Ask again in some seconds."
    return "no ODOMETRY", [
        failed(f"ODOMETRY is not sent: {why}.", f"{remedy[0].upper()}{remedy[1:]}")
    ]


def _fused(status: Data) -> _Seen:
    vehicle = status["vehicle"]
    other = vehicle and vehicle["autopilot"]
    if not other:
        return "its estimate is not heard", []
    if other["apart"]:
        remedy = "See which of its sensors it follows in its place."
        return "it does not follow", [
            warning(f"The autopilot does not follow: {other['apart']}.", remedy)
        ]
    return "nothing speaks against it", []


_JUDGES: Mapping[Stage, Callable[[Data], _Seen]] = {
    Stage.LINK: _link,
    Stage.BYTES: _bytes,
    Stage.FRAMES: _frames,
    Stage.CHECKSUMS: _checksums,
    Stage.SOURCE: _source,
    Stage.MESSAGES: _messages,
    Stage.RATES: _rates,
    Stage.TIME: _time,
    Stage.ESTIMATE: _estimate,
    Stage.SENT: _sent,
    Stage.FUSED: _fused,
}
