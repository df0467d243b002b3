"""Whether bytes come, whether they are frames, and whether their checksums are right."""

from __future__ import annotations

from ekf_companion.doctor.evidence import Evidence, Means
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, warning
from ekf_companion.logs import recording

BAUD = 921600
"""Proposed to users."""
_PRINTABLE = 0.85
"""Share of text among the bytes beyond which they are from a console; noise has 0.37."""
_NOISE = 0.001
_MUCH_NOISE = 0.2
"""Shares of frames whose checksum is wrong."""
PORT_MODE = (
    "PX4: MAV_1_CONFIG = 102 (TELEM 2), MAV_1_MODE = 2 (Onboard), SER_TEL2_BAUD = 921600, then "
    "reboot. ArduPilot: SERIALn_PROTOCOL = 2 (MAVLink 2), SERIALn_BAUD = 921, then reboot"
)


def bytes_(evidence: Evidence) -> StageResult:
    """Judge whether any bytes come."""
    opening, state = evidence.opening, evidence.link
    refused = state.refused if state else {}
    reasons = ", ".join(f"{count} {why}" for why, count in refused.items())
    problems = []
    if evidence.bytes_in:
        rate = evidence.bytes_rate
        saw = f"{evidence.bytes_in} bytes, {rate / 1e3:.1f} kB/s"
        # The share of a serial port's capacity, ten bits a byte
        if opening and opening.kind == "serial" and "ttyACM" not in opening.device:
            share = rate * 10.0 / opening.baud
            saw += f", {share:.0%} of the wire" if share else ""
            if share > 0.85:
                full = warning(
                    f"The wire is full: {rate / 1e3:.1f} kB/s of {opening.baud / 1e4:.1f}.",
                    f"Raise the baud rate at both ends to {BAUD}, or lower link.imu_rate.",
                )
                problems.append(full)
        if state is not None and state.dropped > 0:
            dropped = warning(
                "This board was too slow to read all that came.",
                "Stop what else uses the processor, or lower link.imu_rate.",
            )
            problems.append(dropped)
        saw += f"; datagrams not heard: {reasons}" if reasons else ""
    elif count := sum(refused.values()):
        saw = f"{count} datagrams, none taken"
        refusal = failed(
            f"Datagrams came, and were refused ({reasons}).",
            'Set link.peer to who sends them, or to "".',
        )
        problems.append(refusal)
    else:
        saw = f"none in {evidence.seconds:.0f} s"
        problems.append(_silence(evidence))
    return judged(Stage.BYTES, saw, problems)


def _silence(evidence: Evidence) -> Problem:
    kind, url = (evidence.opening.kind, evidence.opening.url) if evidence.opening else ("", "")
    listening = (
        " PX4 over USB begins only when it receives a heartbeat: leave out --listen."
        if evidence.means is Means.LISTENING
        else ""
    )
    if kind == "serial":
        return failed(
            "Nothing comes over the wire: TX and RX not crossed, no common ground, the "
            "autopilot without power, or its port not set to MAVLink.",
            f"Cross TX and RX, join the grounds; then {PORT_MODE}.{listening}",
        )
    if kind == "udpin":
        port = url.rsplit(":", 1)[-1]
        return failed(
            "Nobody sends here: the sender has another address or port, or a firewall is between.",
            f"Let the sender send to this board's address, port {port}: PX4's simulator sends to "
            f"14540; mavlink-router needs an [UdpEndpoint] with Mode = Normal, Port = {port}; "
            f"MAVProxy --out udpout:ADDRESS:{port}. Firewall: `sudo ufw allow {port}/udp`."
            + listening,
        )
    if kind == "udpout":
        return failed(
            "Nobody answers there: no program listens at that port, or it is another host's.",
            "Look at host and port in link.url. Where the autopilot sends by itself, listen "
            f"instead: udpin:0.0.0.0:14540.{listening}",
        )
    return failed(
        "The connection stands, and nothing comes through it.",
        "Let what is behind it forward the autopilot to this endpoint; ArduPilot's simulator "
        f"serves only one at 5760.{listening}",
    )


def frames(evidence: Evidence) -> StageResult:
    """Judge whether the bytes are MAVLink."""
    counted = evidence.frames
    saw = f"{counted.frames} frames"
    if not counted.frames:
        problem = _no_frames(evidence)
        return judged(Stage.FRAMES, f"none in {evidence.bytes_in} bytes", [problem])
    if evidence.first_version:
        saw += f", {evidence.first_version} of MAVLink 1"
    if counted.unknown_id:
        saw += f", {counted.unknown_id} of messages that are not known here"
    only_first = evidence.first_version >= 0.99 * counted.frames
    first = warning(
        "MAVLink 1 is spoken here, which has no ODOMETRY and drops extension fields "
        "such as GPS accuracies.",
        "ArduPilot: SERIALn_PROTOCOL = 2 (MAVLink 2) for this port. PX4: MAV_PROTO_VER = 2.",
    )
    return judged(Stage.FRAMES, saw, [first if only_first else None])


def _no_frames(evidence: Evidence) -> Problem:
    sample = evidence.sample
    text = sum(32 <= byte < 127 or byte in b"\r\n\t\x1b" for byte in sample)
    if evidence.mismatched or evidence.frames.unknown_id or evidence.frames.incompatible:
        return failed(
            "There are MAVLink frames, and none that is known here: another dialect, or flags "
            "that nobody knows.",
            "Use an autopilot of the common or ardupilotmega dialect.",
        )
    if sample.startswith((b"$G", b"$P")) or b"\n$G" in sample:
        return failed(
            "This is NMEA: the wire leads to a GNSS receiver, or the port is set to NMEA.",
            f"Take the autopilot's telemetry port. {PORT_MODE}.",
        )
    if b"\xb5\x62" in sample[:512]:
        return failed(
            "This is UBX: the wire leads to a u-blox receiver, not to the autopilot.",
            "Take the autopilot's telemetry port in link.url.",
        )
    if sample and text > _PRINTABLE * len(sample):
        words = sample.decode("ascii", "replace").split()
        return failed(
            f"This is text, a console's, not MAVLink: “{' '.join(words[:6])[:48]}”.",
            f"Set the port to MAVLink. {PORT_MODE}. On a Raspberry Pi take the console off the "
            "port: remove console=serial0,… from cmdline.txt.",
        )
    if evidence.is_serial and evidence.opening is not None:
        return failed(
            f"Bytes that are no MAVLink: most likely the baud rate is not {evidence.opening.baud}.",
            "Try link.url with :57600, :115200, :460800 and :921600, or set the autopilot's: "
            "SER_TEL2_BAUD = 921600 (PX4), SERIALn_BAUD = 921 (ArduPilot). Or " + PORT_MODE + ".",
        )
    return failed(
        "Bytes that are no MAVLink: another program's stream arrives at this port.",
        "Look at who sends to the port of link.url, and what.",
    )


def checksums(evidence: Evidence) -> StageResult:
    """Judge how many frames are damaged."""
    counted = evidence.frames
    if evidence.means is Means.RECORDING:
        share = evidence.damaged / max(evidence.damaged + counted.frames, 1)
        damage = warning(
            "The recording is damaged in places.",
            "Look at the link of whoever recorded it, and at the disk; what is whole is used.",
        )
        runs = recording.counted(evidence.damaged, "run")
        saw = f"{runs} of damaged bytes among {counted.frames} frames"
        return judged(Stage.CHECKSUMS, saw, [damage if share > _NOISE else None])
    bad = max(counted.bad_crc, sum(evidence.mismatched.values()))
    share = bad / max(bad + counted.frames, 1)
    saw = f"{share:.1%} wrong ({bad} of {bad + counted.frames})"
    # One message that has nearly all the wrong checksums
    mismatched = evidence.mismatched
    name = max(mismatched, key=mismatched.__getitem__, default="")
    if name and mismatched[name] >= 5 and mismatched[name] > 0.8 * bad:
        problem = warning(
            f"{name} always has a wrong checksum: the sender defines that message otherwise "
            "(another dialect, or an older definition).",
            f"Update the autopilot's firmware, or do without {name}.",
        )
        return judged(Stage.CHECKSUMS, saw, [problem])
    remedy = (
        "Shorten and shield the wire, join the grounds, keep it from power leads; connect RTS and "
        "CTS, or lower the baud rate at both ends."
        if evidence.is_serial
        else "Look for two senders whose bytes are mixed at one port, or a radio at its limit."
    )
    noise = None
    if share > _MUCH_NOISE:
        noise = failed("Most of what comes is damaged on its way.", remedy)
    elif share > _NOISE and bad > 2:
        noise = warning("Frames are damaged on their way.", remedy)
    return judged(Stage.CHECKSUMS, saw, [noise])
