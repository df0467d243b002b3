"""Who sends the frames, and whether the messages that are needed are among them."""

from __future__ import annotations

from collections.abc import Iterator

from ekf_companion.doctor.evidence import Evidence, Means, Source
from ekf_companion.doctor.stage import Problem, Stage, StageResult, failed, judged, warning
from ekf_companion.mavlink import admission, signing
from ekf_companion.mavlink.audit import INERTIAL
from ekf_companion.mavlink.messages import LAYOUTS
from ekf_companion.status.snapshot import PeerState

_GROUND_STATION = 6
_KINDS = {3: "ArduPilot", 12: "PX4"}
NORTH = ("ATTITUDE", "GLOBAL_POSITION_INT", "VFR_HUD")


def source(evidence: Evidence) -> StageResult:
    """Judge who sends heartbeats, and which autopilot is in use."""
    pilots = [source for source in evidence.sources if source.is_autopilot]
    saw = "; ".join(
        _describe(source) + ("" if _is_let_in(evidence, source) else ", refused")
        for source in evidence.sources
        if source.heartbeats or source.poses
    )
    if evidence.peer is None:
        saw = saw or f"no heartbeat in {evidence.seconds:.0f} s"
        return judged(Stage.SOURCE, saw, [_nobody(evidence, pilots)])
    return judged(Stage.SOURCE, saw, _disturbances(evidence, evidence.peer, pilots))


def _disturbances(evidence: Evidence, peer: PeerState, pilots: list[Source]) -> Iterator[Problem]:
    link = evidence.config.link
    is_signing = any(pilot.signed for pilot in pilots)
    # It accepts signed frames only
    if (
        is_signing
        and not evidence.config.signing.key_file
        and evidence.means is not Means.RECORDING
    ):
        yield warning(
            "The autopilot signs its frames, and so believes none of ours.",
            "Set signing.key_file to a file with its key.",
        )
    if not peer.is_heard:
        yield failed(
            "The autopilot's heartbeat has stopped.",
            "Look at its power and the wire; it sends one a second.",
        )
    if evidence.is_clash and evidence.means is Means.LIVE:
        yield failed(
            f"Somebody else on this link has our ids, {link.system_id or peer.system_id}/"
            f"{link.component_id}: the daemon itself, or another program.",
            "Stop the other, or set link.component_id to a free one, 191 to 194.",
        )
    ours = link.system_id or peer.system_id, link.component_id
    for other in evidence.sources:
        ids = other.system_id, other.component_id
        if not other.poses or ids in (ours, (peer.system_id, peer.component_id)):
            continue
        number, count = other.poses.most_common(1)[0]
        rate = count / max(evidence.seconds, 1.0)
        yield warning(
            f"System {ids[0]}, component {ids[1]} sends {LAYOUTS[number].name} at {rate:.0f} Hz, "
            "which the autopilot may fuse by turns with our ODOMETRY.",
            "Stop one of the two; output.odometry.second_source says what becomes of ours.",
        )
    rivals = {pilot.system_id for pilot in pilots if _is_let_in(evidence, pilot)}
    if link.autopilot is None and len(rivals) > 1:
        yield warning(
            f"Several autopilots send here; the first that was heard, {peer.system_id}, is "
            "listened to.",
            f"Set link.autopilot = {peer.system_id}, or that of the right one.",
        )


def _describe(source: Source) -> str:
    if source.poses and not source.is_autopilot:
        what = f"sends {LAYOUTS[source.poses.most_common(1)[0][0]].name}"
    elif source.is_autopilot:
        what = _KINDS.get(source.autopilot, f"autopilot of kind {source.autopilot}")
    else:
        what = "ground station" if source.type == _GROUND_STATION else "no autopilot"
    return f"{source.system_id}/{source.component_id} {what}"


def _is_let_in(evidence: Evidence, source: Source) -> bool:
    link, wanted = evidence.config.link, evidence.config.signing
    must_sign = wanted.key_file and not wanted.accept_unsigned
    return (
        (not link.allow_systems or source.system_id in link.allow_systems)
        and (not link.allow_components or source.component_id in link.allow_components)
        and (not must_sign or source.signed > 0 or evidence.means is Means.RECORDING)
    )


def _nobody(evidence: Evidence, pilots: list[Source]) -> Problem:
    wanted = evidence.config.link.autopilot
    if (problem := _refused(evidence, pilots)) is not None:
        return problem
    if pilots and wanted is not None:
        heard = ", ".join(str(pilot.system_id) for pilot in pilots)
        return failed(
            f"The autopilot {wanted} that link.autopilot names is not heard; {heard} is.",
            f"Set link.autopilot = {pilots[0].system_id}, or null for the first that is heard; or "
            f"the autopilot's own id (SYSID_THISMAV, MAV_SYSID or MAV_SYS_ID) = {wanted}.",
        )
    if any(source.type == _GROUND_STATION for source in evidence.sources if source.heartbeats):
        return failed(
            "Only a ground station sends here, no autopilot.",
            "Take the endpoint of the router on which the autopilot is; a ground station forwards "
            "it only if told so (QGroundControl: MAVLink forwarding; MAVProxy: --out).",
        )
    if any(source.heartbeats for source in evidence.sources):
        return failed(
            "Heartbeats come, but none from an autopilot.",
            "Take the port of the autopilot in link.url; behind a router, let it forward "
            "component 1.",
        )
    return failed(
        "Frames come, but no heartbeat: somebody filters it away.",
        "Let HEARTBEAT (id 0) through the router's filters (AllowMsgIdOut); PX4: "
        "MAV_n_MODE = 2 (Onboard) has it.",
    )


def _refused(evidence: Evidence, pilots: list[Source]) -> Problem | None:
    """Return why an autopilot that is there is refused: by an allow-list, or by its signature."""
    link, refused = evidence.config.link, evidence.frames.refused
    for pilot in pilots:
        checks = (
            (admission.SYSTEM, "systems", link.allow_systems, pilot.system_id),
            (admission.COMPONENT, "components", link.allow_components, pilot.component_id),
        )
        for why, name, allowed, own in checks:
            if refused.get(why) and allowed and own not in allowed:
                key = f"link.allow_{name}"
                return failed(f"{key} leaves out the autopilot's {own}.", f"Add {own} to {key}.")
    is_signing = any(pilot.signed for pilot in pilots)
    for why, problem in _UNBELIEVED.items():
        if pilots and refused.get(why) and is_signing == (why != admission.UNSIGNED):
            return problem
    return None


_UNBELIEVED = {
    signing.WRONG: failed(
        "The autopilot signs its frames with another secret than ours.",
        "Set up the key of signing.key_file in the autopilot (Mission Planner: Signing), or name "
        "the file that holds the autopilot's.",
    ),
    admission.UNSIGNED: failed(
        "The autopilot does not sign its frames, and unsigned ones are refused.",
        "Set up the same key in the autopilot (Mission Planner: Signing), or "
        "signing.accept_unsigned = true.",
    ),
    signing.OLD: failed(
        "The autopilot's signatures are over a minute old by this board's clock.",
        "Set the clocks: look at `timedatectl` here; the autopilot's own comes with a GNSS fix.",
    ),
    signing.REPLAYED: failed(
        "Signed frames come that are not newer than those before: two paths bring them, somebody "
        "plays back what he recorded, or the autopilot's clock went back.",
        "Let only one router endpoint lead here; give the autopilot a GNSS fix, whose time it "
        "takes.",
    ),
}
"""The problem with a signature, by the reason why it was refused."""


def messages(evidence: Evidence) -> StageResult:
    """Judge which of the needed messages come at all, and the answers to our requests."""
    come = {name for name, state in evidence.messages.items() if state.count and state.rate > 0.0}
    answers = {name: state.answer for name, state in evidence.messages.items() if state.answer}
    refused = {
        name: answer for name, answer in answers.items() if answer not in ("accepted", "no answer")
    }
    inertial = next((name for name in INERTIAL if name in come), "no inertial message")
    gnss, clock = (
        name if name in come else f"no {name}" for name in ("GPS_RAW_INT", "SYSTEM_TIME")
    )
    north = next((name for name in NORTH if name in come), "no ATTITUDE")
    saw = f"{inertial}, {gnss}, {north}, {clock}"
    if refused:
        saw += "; refused: " + ", ".join(f"{name} ({why})" for name, why in refused.items())
    problems = []
    if {*answers.values()} == {"no answer"}:
        one_way = failed(
            "The autopilot answers none of our requests: what we send does not arrive.",
            "Look at the wire from our TX to its RX, and at RTS and CTS: without them SERn flow "
            "control off (PX4: MAV_n_FLOW_CTRL = 0, ArduPilot: BRD_SERn_RTSCTS = 0). Behind a "
            "router, let this endpoint send to the autopilot.",
        )
        problems.append(one_way)
    return judged(Stage.MESSAGES, saw, [*problems, *_missing(evidence, come, refused)])


def _missing(evidence: Evidence, come: set[str], refused: dict[str, str]) -> Iterator[Problem]:
    if not come & {*INERTIAL}:
        yield _no_inertial(evidence, refused)
    if "GPS_RAW_INT" not in come:
        yield _no_gnss(evidence, come)
    if not come & {*NORTH, "HIGHRES_IMU", "RAW_IMU"}:
        yield warning(
            "No message contains a heading.",
            "PX4: MAV_n_MODE = 2 (Onboard) has ATTITUDE. ArduPilot: SRn_EXTRA1 = 10.",
        )
    if not come & {"HIGHRES_IMU", "SCALED_PRESSURE"}:
        yield warning(
            "No message contains the pressure, so the height is that of GNSS alone.",
            "ArduPilot: SRn_RAW_SENS = 10. PX4: MAV_n_MODE = 2 (Onboard).",
        )


def _no_inertial(evidence: Evidence, refused: dict[str, str]) -> Problem:
    if evidence.means is Means.LISTENING:
        return failed(
            "No inertial message comes by itself.",
            "The daemon asks for it: examine without --listen.",
        )
    if evidence.family == "px4":
        answer = refused.get("HIGHRES_IMU")
        return failed(
            f"No inertial message comes{f': HIGHRES_IMU was {answer}' if answer else ''}.",
            "Set MAV_n_MODE = 2 (Onboard) for this port and reboot; the mode Normal has no "
            "HIGHRES_IMU by itself.",
        )
    return failed(
        "No inertial message comes.",
        "Set SRn_RAW_SENS = 50 (MAVn_RAW_SENS from 4.7 on) for this port, and BRD_SERn_RTSCTS = 0 "
        "where no RTS and CTS are wired.",
    )


def _no_gnss(evidence: Evidence, come: set[str]) -> Problem:
    remedy = (
        "Set GPS_1_CONFIG to the receiver's port, and MAV_n_MODE = 2 (Onboard) for this one."
        if evidence.family == "px4"
        else "Set GPS1_TYPE = 1 (GPS_TYPE before 4.6) for the receiver, and SRn_EXT_STAT = 10 "
        "for this port."
    )
    if "GLOBAL_POSITION_INT" in come:
        return warning(
            "No GPS_RAW_INT comes: the autopilot's own estimate must stand in, which is no "
            "independent measurement.",
            remedy,
        )
    return failed("No GPS_RAW_INT comes: there is no position.", remedy)
