"""Lay a status out for a terminal: the verdicts, the vehicle, then the stages of a measurement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ekf_companion.cli.vehicle_view import named, vehicle_parts

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

Data = Mapping[str, Any]
_SLOW = 0.5
"""Share of the requested rate below which a message is marked."""


def view(data: Data, url: str, *, is_brief: bool = False) -> Group:
    """Return the page for an answer of ``/status``, the most useful first; in brief, only that.

    ``url`` is where it was asked.
    """
    from rich.console import Group
    from rich.text import Text

    health = data["health"]
    is_good = health.get("is_ok") and (data["estimator"] or {}).get("status") == "ok"
    colour = "green" if is_good else "yellow" if health["is_healthy"] else "red"
    verdict = Text(health["words"], style=f"bold {colour}")
    vehicle = vehicle_parts(data, is_brief=is_brief)
    parts = [verdict, *vehicle[:1], Text(f"{named(data)}; {url}", style="dim"), *vehicle[1:]]
    if is_brief:
        return Group(*parts)
    parts += [_stages(data), _rates(data["messages"])]
    if data["estimator"]:
        parts.append(_aids(data["estimator"]))
    return Group(*parts)


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, justify="right", overflow="fold")
    table.columns[0].justify, table.columns[0].no_wrap = "left", True
    return table


def _stages(data: Data) -> Table:
    from rich.markup import escape

    table = _table("Stage", "")
    table.columns[1].justify = "left"
    for name, text in (
        ("link", _link(data["link"])),
        ("frames", _frames(data["frames"])),
        ("autopilot", _peer(data["peer"])),
        ("refused", _counts(data["refused"])),
        ("inertial", _inertial(data["imu"])),
        ("time", _time(data["time"])),
        ("estimate", _estimate(data)),
        *((("faults", words),) if (words := _faults(data["estimator"])) else ()),
        ("output", _output(data["output"])),
        ("guard", _guard(data["output"])),
        ("settings", _settings(data)),
        ("process", _process(data["process"])),
    ):
        table.add_row(name, escape(text or "-"))
    return table


def _link(link: Data) -> str:
    state = "open" if link["is_open"] else "closed"
    state += f" ({link['failure']})" if link["failure"] else ""
    text = f"{link['url']} {state}, {link['bytes_in']} bytes in, {link['bytes_out']} out"
    text += f", silent for {_number(link['silent_s'], 's', 1)}"
    text += f", from {link['peer']}" if link["peer"] else ""
    losses = {"dropped": link["dropped"], "unsent": link["unsent"], **link["refused"]}
    return _with_losses(text, losses)


def _frames(frames: Data) -> str:
    names = ["bad_crc", "unknown_id", "incompatible", "junk_bytes"]
    names += ["lost", "late", "duplicates", "again"]
    losses = {name.replace("_", " "): frames[name] for name in names}
    text = f"{frames['frames']} good, {frames['signed']} signed"
    return _with_losses(text, {**losses, **frames["refused"], **frames["ignored"]})


def _peer(peer: Data | None) -> str:
    if peer is None:
        return "none heard"
    text = f"system {peer['system_id']}, component {peer['component_id']}, {peer['family']}"
    text += f" {peer['version']}" if peer["version"] else ""
    text += ", armed" if peer["is_armed"] else ", disarmed"
    text += f", rebooted {_times(peer['reboots'])}" if peer["reboots"] else ""
    silent = f", silent for {_number(peer['silent_s'], 's', 1)}"
    return text if peer["is_heard"] else text + silent


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _inertial(imu: Data) -> str:
    text = f"{imu['message']}, sensor {imu['instance']}, {imu['rate']:.1f} Hz"
    text += ", stamps brought back to the samples" if imu["is_dejittered"] else ""
    units = imu["units"].items()
    others = [f"sensor {number} {words}" for number, words in units if words != "used"]
    return "; ".join([text, *others])


def _time(time: Data) -> str:
    text = f"base {time['base']}, {'locked' if time['is_locked'] else 'not locked'}"
    text += f" within {_number(time['residual_us'], 'us', 0)}" if time["is_locked"] else ""
    text += f" ({time['trouble']})" if time["trouble"] else ""
    text += f", skew {_number(time['skew_ppm'], 'ppm', 1)}"
    trips = f"{_number(time['rtt_p50_ms'], 'ms', 2)} and {_number(time['rtt_p95_ms'], 'ms', 2)}"
    return _with_losses(f"{text}, round trip {trips} (median, 95 %)", time["refused"])


def _estimate(data: Data) -> str:
    estimator = data["estimator"]
    if not estimator:
        return "none yet"
    horizontal = _number(estimator["std_horizontal"], "m", 2)
    text = f"{estimator['status'].upper()}, start {estimator['start']}"
    text += f", sigma {horizontal} and {_number(estimator['std_vertical'], 'm', 2)}"
    text += ", receiver 2 in use" if estimator["receiver"] else ""
    text += f", newest sample {_number(data['sample_age_s'], 's', 2)} ago"
    text += f", {estimator['samples']} samples"
    text += f", {estimator['gaps']} gap{'' if estimator['gaps'] == 1 else 's'}"
    text = _with_losses(text, {f"resets for {reason}": n for reason, n in data["resets"].items()})
    return text + _reasons(data["seconds"])


def _faults(estimator: Data | None) -> str:
    """Return what is suspected and what was found; empty: nothing, or nobody asked."""
    if not estimator:
        return ""
    parts = [f"suspected: {one}" for one in estimator.get("suspected", ())]
    parts += [f"found: {one}" for one in estimator.get("found", ())]
    if estimator.get("protection_horizontal") is not None:
        horizontal = _number(estimator["protection_horizontal"], "m", 1)
        vertical = _number(estimator["protection_vertical"], "m", 1)
        parts.append(f"protection level {horizontal} horizontal, {vertical} vertical")
    return "; ".join(parts)


def _reasons(seconds: Mapping[str, Mapping[str, float]]) -> str:
    """Return for how long the estimate was worse than OK in this run, and why."""
    from ekf_companion.nav.reason import to_words
    from ekf_companion.nav.state import Reason

    text = ""
    for status, by_reason in seconds.items():
        found = {Reason[why.upper()]: spent for why, spent in by_reason.items() if why}
        text += f"; {status.replace('_', ' ')}: {to_words(found)}" if found else ""
    return text


def _output(output: Data) -> str:
    streams = f"streams at {output['rate']:.1f} Hz" if output["is_streaming"] else "is not sent"
    text = f"ODOMETRY {streams}"
    text += f": {output['silence']}" if output["silence"] else ""
    losses = {"withheld": output["withheld"], "thrown away": output["unsent"]}
    losses |= {"texts dropped": output["texts_dropped"]}
    return _with_losses(f"{text}, sent {_counts(output['sent']) or 'nothing'}", losses)


def _guard(output: Data) -> str:
    """Return the guard's verdict, and the autopilot's parameters that it follows from."""
    text = f"{output['mode']}, ODOMETRY {'streamed' if output['is_allowed'] else 'withheld'}"
    text += "" if output["is_settled"] else ", for now"
    text += f": {output['reason']}" if output["reason"] else ""
    text += f"; {output['remedy']}" if output["remedy"] else ""
    read = ", ".join(f"{name} {value:g}" for name, value in output["parameters"].items())
    return f"{text} ({read})" if read else text


def _settings(data: Data) -> str:
    """Return the settings that differ from the file read at the start."""
    changes = [f"{key} {value} over MAVLink" for key, value in data["tuned"].items()]
    if (reload := data["reload"])["count"]:
        changes.append(f"reloaded {_times(reload['count'])}, last: {reload['words']}")
    return "; ".join(changes)


def _process(process: Data) -> str:
    text = f"version {process['version']}, pid {process['pid']}"
    text += f", up {_number(process['uptime_s'], 's', 0)}"
    text += f", {process['cpu_share']:.1%} of a processor, {process['rss_mb']:.0f} MB"
    text += f", loop lag {_number(process['loop_lag_ms'], 'ms', 1)}"
    if process["latency_count"]:
        mean = process["latency_sum_ms"] / process["latency_count"]
        text += f", latency {mean:.2f} ms in the mean, {_share(process)}"
    if process["recorded_bytes"]:
        text += f", {process['recorded_bytes'] / 1e6:.1f} MB recorded"
    heat = process["temperatures"].items()
    text += "".join(f", {name} {celsius:.0f} degC" for name, celsius in heat)
    return _with_losses(text, {"unrecorded bytes": process["unrecorded_bytes"]})


def _share(process: Data) -> str:
    """Return the latency within which 99.9 % of the estimates were sent."""
    for bound, count in process["latency"].items():
        if count >= 0.999 * process["latency_count"]:
            return f"99.9 % within {float(bound):g} ms"
    return "over 0.1 % beyond the largest bound"


def _rates(messages: Mapping[str, Data]) -> Table:
    from rich.markup import escape

    table = _table("Message", "count", "Hz", "asked", "answer")
    for name, message in messages.items():
        asked = f"{message['asked']:g}" if message["asked"] else ""
        rate, answer = f"{message['rate']:.1f}", escape(message["cause"] or message["answer"])
        style = "yellow" if message["rate"] < _SLOW * message["asked"] else None
        table.add_row(name, str(message["count"]), rate, asked, answer, style=style)
    return table


def _aids(estimator: Data) -> Table:
    table = _table("Aid", "fused", "refused", "other", "test ratio", "NIS")
    for aid, verdicts in estimator["verdicts"].items():
        fused = verdicts.get("fused", 0) + verdicts.get("deweighted", 0)
        refused = verdicts.get("gated", 0) + verdicts.get("denied", 0)
        other = sum(verdicts.values()) - fused - refused
        ratio, nis = estimator["ratios"].get(aid), estimator["nis"].get(aid)
        row = (str(fused), str(refused), str(other), _number(ratio, "", 2), _number(nis, "", 2))
        table.add_row(aid, *row, style="yellow" if (ratio or 0.0) > 1.0 else None)
    return table


def _number(value: float | None, unit: str, digits: int) -> str:
    return "?" if value is None else f"{value:.{digits}f} {unit}".rstrip()


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count)


def _with_losses(text: str, losses: Mapping[str, int]) -> str:
    """Return a text with the losses, if there are any."""
    return f"{text}; {lost}" if (lost := _counts(losses)) else text
