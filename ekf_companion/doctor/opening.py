"""The first stage: whether the link opens, and if not, why."""

from __future__ import annotations

import errno

from ekf_companion.config.service import HttpConfig
from ekf_companion.doctor.evidence import Evidence, Opening
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, unknown, warning
from ekf_companion.doctor.transport import BAUD


def link(evidence: Evidence) -> StageResult:
    """Judge the opening of the link."""
    opening = evidence.opening
    if opening is None:
        return unknown(Stage.LINK, "a recording has none")
    if not opening.failure:
        state = evidence.link
        again = state is not None and state.opened > 1
        lost = warning(
            f"The link was lost and opened again {state.opened - 1} times." if state else "",
            "Look at the plug and the power; over USB switch autosuspend off (udev: "
            "power/control = on); over TCP look at who closes it.",
        )
        return judged(Stage.LINK, f"{opening.url} is open", [lost if again else None])
    reason = _reason(opening, evidence.config.http)
    return judged(Stage.LINK, f"{opening.url}: {opening.failure}", [reason])


def _reason(opening: Opening, http: HttpConfig) -> Problem:
    match opening.number:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            return _missing(opening)
        case errno.EACCES | errno.EPERM:
            return _forbidden(opening)
        case errno.EBUSY | errno.EAGAIN | errno.EADDRINUSE:
            return _busy(opening, http)
        case errno.ECONNREFUSED | errno.ETIMEDOUT | errno.EHOSTUNREACH | errno.ENETUNREACH:
            return failed(
                "Nobody listens there, or the network does not reach it.",
                "Start what should listen, and look at host and port in link.url: ArduPilot's "
                "simulator and mavlink-router listen at TCP 5760; PX4 sends UDP, to 14540: "
                "udpin:0.0.0.0:14540.",
            )
        case errno.EADDRNOTAVAIL:
            return failed(
                "This board has no such address.",
                "Listen at all of them: udpin:0.0.0.0:PORT in link.url.",
            )
    return _other(opening)


def _missing(opening: Opening) -> Problem:
    present = ", ".join(opening.present)
    return failed(
        f"There is no {opening.device or 'such device'}: not plugged in, not powered, or of "
        "another name.",
        f"This board has {present}: set link.url to serial:{opening.present[0]}:{BAUD}, or the "
        "one that is the autopilot's; names under /dev/serial/by-id stay."
        if present
        else "This board has no serial device at all: plug the autopilot in, look at `dmesg`; on a "
        "Raspberry Pi switch the port on (enable_uart=1, and no console on it).",
    )


def _forbidden(opening: Opening) -> Problem:
    if opening.kind != "serial":
        return failed(
            "This user may not open that port: those below 1024 are root's.",
            "Take a port above 1023 in link.url, as in udpin:0.0.0.0:14540.",
        )
    group = opening.group or "dialout"
    return failed(
        f"This user may not open {opening.device}: it belongs to the group {group}.",
        f"Run `sudo usermod -aG {group} $USER` and log in again; under systemd set "
        f"SupplementaryGroups={group}.",
    )


def _busy(opening: Opening, http: HttpConfig) -> Problem:
    what = opening.device or "that port"
    asked = "" if http.url == HttpConfig().url else f" --url {http.url}"
    holder = opening.holder
    if holder is None:
        return failed(
            f"Another program has {what}.",
            (
                f"Find it with `sudo fuser -v {opening.device}` and stop it"
                if opening.device
                else "Find it with `sudo ss -lptun` and stop it, or take another port in link.url"
            )
            + "; mavlink-router can give each program an endpoint. Is it our own daemon? "
            + (f"Ask it with `ekf-companion status{asked}`, or " if http.url else "Then ")
            + "`sudo systemctl stop ekf-companion` first.",
        )
    if holder.is_daemon:
        ask = (
            f"Ask it: `ekf-companion status{asked}`, or `ekf-companion doctor --url {http.url}` "
            "(http.host and http.port as configured here). "
            if http.url
            else "It has no page to ask, as http.port is 0. "
        )
        return failed(
            f"Our own daemon has {what}: {holder}.",
            f"{ask}To examine the link from here, `{holder.stop}` first.",
        )
    return failed(
        f"{holder} has {what}.",
        f"Stop it (`{holder.stop}`), or let "
        "mavlink-router have the port and give each program an endpoint of its own.",
    )


def _other(opening: Opening) -> Problem:
    if opening.kind == "serial":
        return failed(
            f"{opening.device} cannot be set up as a serial port.",
            f"Set link.url to a serial device, as in serial:/dev/ttyACM0:{BAUD}.",
        )
    return failed(
        "The link cannot be opened: a name that nobody knows, or no network.",
        "Write the host in link.url as a number, as in 192.168.1.2, and look at `ip route`.",
    )
