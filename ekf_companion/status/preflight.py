"""Whether the vehicle may take off on the estimate, by a snapshot, and why not.

The estimate is compared with its own sigmas, and with the autopilot's own attitude and position. A
difference counts beyond three sigmas of both sides, and beyond a floor that has a reason. Values of
the autopilot that are older than a second are not compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.engine.health import DECIMATED, Health
from ekf_companion.nav.earth import SEMI_MAJOR_AXIS
from ekf_companion.nav.state import Status
from ekf_companion.status.judge import judge, missing_input
from ekf_companion.status.snapshot import Snapshot
from ekf_companion.status.vehicle import AidState, AutopilotState, Preflight, VehicleEstimate

OLDEST_S = 1.0
"""Age of a value of the autopilot beyond which nothing is compared."""
SIGMAS = 3.0
AUTOPILOT_LEVEL_STD = 1.2
"""One sigma of the autopilot's roll and pitch, deg: of the 0.2 m/s2 of accelerometer bias that EKF2
begins with (EKF2_ABIAS_INIT)."""
AUTOPILOT_HEADING_STD = 5.0
"""One sigma of the autopilot's heading, deg: a compass in a drone, after its calibration."""
AUTOPILOT_VELOCITY_STD = 0.3
"""One sigma of its velocity, m/s: as of a receiver that states none."""
POSITION_FLOOR = 5.0
"""m: two filters of one receiver follow its slow error of metres at different rates."""
HEIGHT_FLOOR = 10.0
"""m: the autopilot's height may come from its barometer, which drifts by 3 m (one sigma) in an
hour."""
VELOCITY_FLOOR = 1.0
"""m/s: three times ``AUTOPILOT_VELOCITY_STD``, rounded up."""
LARGEST_HORIZONTAL_STD = 5.0
"""One sigma of the position, m: as ``output.odometry.dead_reckoning_std``, which ends ODOMETRY."""
LARGEST_HEADING_STD = 10.0
"""One sigma, deg: beyond, the status is degraded."""
LARGEST_LEVEL_STD = 5.0
"""One sigma of roll and pitch, deg: a hover that is level by them accelerates by 0.9 m/s2."""
LEANING, UPSIDE_DOWN = 45.0, 120.0
"""Angles from the vertical, deg: beyond the first no autopilot arms (ArduPilot's largest lean
angle), beyond the second the vehicle cannot be standing."""
LEVEL_DRIFT = 0.5
"""Change of roll or pitch at rest, deg: the accuracy of the autopilots' level calibrations."""
HEADING_DRIFT = 5.0
"""Change of heading at rest, deg: one sigma of a calibrated compass."""
SETTLING_S = 10.0
"""Time for which an aid must be in use without a break; EKF2 asks for the same (EKF2_REQ_GPS_H)."""
LEAST_REST_S = 4.0
"""Shortest rest over which a drift is judged."""
_HEADING_UNSURE = "heading is known to {:.0f} deg only"
ARMED = "armed"
"""Cause of a vehicle that is armed already: its verdict begins with that, not with ready."""
UNJUDGED = Preflight(ready=False, sentence="", reasons=())
"""Placeholder in a snapshot whose verdict was not computed yet."""


class Reason(NamedTuple):
    """Something that prevents a take-off."""

    cause: str
    """The reason in a word or two that do not change, for alerts."""
    words: str


def check(snapshot: Snapshot) -> Preflight:
    """Return whether the vehicle may take off, and why not."""
    reasons = list(_of_vehicle(snapshot)) + list(_of_input(snapshot))
    notes: list[str] = []
    if all(reason.cause == ARMED for reason in reasons) and snapshot.estimator is not None:
        reasons += _of_estimate(snapshot, snapshot.estimator)
        for part in (_of_attitude(snapshot), _of_position(snapshot, snapshot.estimator)):
            for one in part:
                notes.append(one) if isinstance(one, str) else reasons.append(one)
        reasons += _of_rest(snapshot)
        reasons += _of_output(snapshot)
        if not reasons:
            reasons += _of_beginning(snapshot.vehicle)
        if not reasons and snapshot.estimator.status is Status.DEGRADED and not notes:
            reasons.append(Reason("degraded", _why_degraded(snapshot, snapshot.estimator)))
    notes += _remarks(snapshot)
    if reasons:
        words = "; ".join(reason.words for reason in reasons)
        sentence = words if reasons[0].cause == ARMED else f"not ready: {words}"
    else:
        sentence = f"ready ({'; '.join(notes)})" if notes else "ready"
    return Preflight(
        ready=not reasons,
        sentence=sentence,
        reasons=tuple(reason.words for reason in reasons),
        notes=tuple(notes),
        causes=tuple(dict.fromkeys(reason.cause for reason in reasons)),
    )


def _why_degraded(snapshot: Snapshot, health: Health) -> str:
    """Return why the estimate is degraded, and for how long it has been so in this run."""
    foremost, why = next(iter(health.reasons.items()), (None, "see its sigmas"))
    spent = snapshot.seconds.get("degraded", {})
    words = f"the estimate is degraded: {why}"
    if foremost is not None and (seconds := spent.get(str(foremost.name).lower(), 0.0)) >= 1.0:
        words += f", {seconds:.0f} s of this run"
    return f"{words}; wait"


def _of_vehicle(snapshot: Snapshot) -> Iterator[Reason]:
    if snapshot.peer is not None and snapshot.peer.is_heard and snapshot.peer.is_armed:
        yield Reason(ARMED, "armed already: this is a check for before take-off")


def _of_input(snapshot: Snapshot) -> Iterator[Reason]:
    """Find missing input, without which there is no current estimate."""
    finding = judge(snapshot)
    if not finding.is_healthy:
        yield Reason("unhealthy", finding.line)
    elif silence := missing_input(snapshot):
        yield Reason("no input", silence)
    elif snapshot.estimator is None:
        yield Reason("aligning", "nothing is estimated yet")
    elif snapshot.estimator.status < Status.ATTITUDE:
        yield Reason("aligning", "still aligning: leave the vehicle at rest")


def _of_estimate(snapshot: Snapshot, health: Health) -> Iterator[Reason]:
    """Judge position, heading and level by their aids and their own sigmas."""
    vehicle = snapshot.vehicle
    if vehicle.needs_fix:
        yield from _of_fix(snapshot, health)
    yield from _of_heading(vehicle)
    sigma = vehicle.sigma
    for wrong in health.wrong:
        yield Reason("source wrong", wrong.sentence)
    for one in DECLARED:
        if (aid := vehicle.aids[one.name]).state == "refused":
            yield Reason(f"{one.name} refused", f"{one.sensor} refused: {aid.why}")
    if max(sigma.roll_deg, sigma.pitch_deg) > LARGEST_LEVEL_STD:
        worst = max(sigma.roll_deg, sigma.pitch_deg)
        yield Reason("level unsure", f"roll and pitch are known to {worst:.0f} deg only")


def _of_fix(snapshot: Snapshot, health: Health) -> Iterator[Reason]:
    vehicle = snapshot.vehicle
    position, height = vehicle.aids["position"], vehicle.aids["height"]
    if position.state == "refused":
        yield Reason("fix refused", f"fixes refused: {position.why}")
    elif position.state == "lost":
        yield Reason("no fix", f"no fix for {position.used_s:.0f} s{_why_no_fix(snapshot)}")
    elif math.isnan(vehicle.lat_deg):
        # A position waits for a heading: where that alone is missing, it is told as such
        why = _why_no_fix(snapshot)
        if why or not math.isnan(vehicle.heading_deg):
            yield Reason("no fix", f"no fix{why}")
    elif health.status is Status.DEAD_RECKONING:
        yield Reason("no fix", "no fix: dead reckoning")
    elif health.is_position_autopilots and not vehicle.takes_own_position:
        instead = "the position is the autopilot's own estimate"
        yield Reason("no fix", f"no fix{_why_no_fix(snapshot)}; {instead}")
    if height.state == "refused":
        yield Reason("height refused", f"the height of the fixes is refused: {height.why}")
    if (std := vehicle.sigma.horizontal_m) > LARGEST_HORIZONTAL_STD:
        yield Reason("position unsure", f"position is known to {std:.0f} m only")


def _why_no_fix(snapshot: Snapshot) -> str:
    """Return what is missing of the receiver, after a colon; empty: nothing."""
    message = snapshot.messages.get("GPS_RAW_INT")
    if message is None or message.rate == 0.0:
        return ": no GPS_RAW_INT comes"
    refused = {
        why.partition(": ")[2]: count
        for why, count in snapshot.refused.items()
        if why.startswith("GPS_RAW_INT: ")
    }
    for why in ("no 3-D fix", "no position", "time base unknown"):
        if refused.get(why):
            return f": the receiver has {why}" if why.startswith("no ") else f": {why}"
    return ""


def _of_heading(vehicle: VehicleEstimate) -> Iterator[Reason]:
    aid, std = vehicle.aids["heading"], vehicle.sigma.heading_deg
    if _is_field_refused(aid):
        is_at_times = aid.state == "used" and "magnetometer" in aid.source
        is_replaced = aid.state == "used" and not is_at_times
        words = f"compass refused{' now and then' if is_at_times else ''}: {aid.why}"
        words += f"; heading is from {aid.source}" if is_replaced else ""
        yield Reason("compass refused", words)
    elif aid.state == "refused":
        what = "compass" if "magnetometer" in aid.source else "heading"
        yield Reason("compass refused", f"{what} refused: {aid.why}")
    elif aid.state == "lost":
        yield Reason("no heading", f"no heading from {aid.source} for {aid.used_s:.0f} s")
    elif math.isnan(vehicle.heading_deg):
        yield Reason("no heading", "no heading: neither a compass nor another source is used")
    # Before there is a position, the declination is not known
    if std > LARGEST_HEADING_STD and not math.isnan(vehicle.lat_deg):
        yield Reason("heading unsure", _HEADING_UNSURE.format(std))


def _is_field_refused(aid: AidState) -> bool:
    """Whether the magnetometer is refused now, even if another heading replaces it."""
    return aid.refused_s <= OLDEST_S and "magnetic" in aid.why


def _of_attitude(snapshot: Snapshot) -> Iterator[Reason | str]:
    """Compare with the autopilot's attitude, and check that the vehicle is upright."""
    vehicle = snapshot.vehicle
    if not (snapshot.peer is not None and snapshot.peer.is_armed):
        yield from _of_mounting(vehicle)
    other = vehicle.autopilot
    if other is None or not other.attitude_message:
        yield Reason("not compared", "attitude not compared with the autopilot's: it says none")
        return
    if not other.attitude_age_s <= OLDEST_S:
        yield Reason(
            "not compared",
            "attitude not compared with the autopilot's: its "
            f"{other.attitude_message} is {other.attitude_age_s:.1f} s old",
        )
        return
    lag = vehicle.turn_rate_deg_s * other.attitude_age_s
    level, sigma = _level_difference(vehicle, other), vehicle.sigma
    std = max(sigma.roll_deg, sigma.pitch_deg)
    if level > SIGMAS * math.hypot(std, AUTOPILOT_LEVEL_STD) + lag:
        yield Reason(
            "level differs", f"roll and pitch differ from the autopilot's by {level:.0f} deg"
        )
    source = vehicle.aids["heading"].source
    if other.is_attitude_ours:
        yield "heading not compared: the autopilot's is made of our ODOMETRY"
    elif "the autopilot's own" in source:
        yield "heading not compared: ours is taken from the autopilot"
    else:
        turned = abs((vehicle.heading_deg - other.heading_deg + 180.0) % 360.0 - 180.0)
        if turned > SIGMAS * math.hypot(sigma.heading_deg, AUTOPILOT_HEADING_STD) + lag:
            yield Reason(
                "heading differs", f"heading differs from the autopilot's by {turned:.0f} deg"
            )


def _of_mounting(vehicle: VehicleEstimate) -> Iterator[Reason]:
    lean = math.degrees(math.acos(_down(vehicle.roll_deg, vehicle.pitch_deg)[2]))
    where = f"roll is {vehicle.roll_deg:.0f} and pitch {vehicle.pitch_deg:.0f} deg"
    if lean > UPSIDE_DOWN:
        yield Reason("mounting", f"mounting looks upside down: {where}")
    elif lean > LEANING:
        yield Reason("mounting", f"mounting looks wrong, or the vehicle lies on a side: {where}")


def _down(roll_deg: float, pitch_deg: float) -> tuple[float, float, float]:
    """Return the direction down in the body: forward, right, down."""
    roll, pitch = math.radians(roll_deg), math.radians(pitch_deg)
    level = math.cos(pitch)
    return -math.sin(pitch), math.sin(roll) * level, math.cos(roll) * level


def _level_difference(vehicle: VehicleEstimate, other: AutopilotState) -> float:
    """Return the angle between the two directions down, deg."""
    ours = _down(vehicle.roll_deg, vehicle.pitch_deg)
    theirs = _down(other.roll_deg, other.pitch_deg)
    cosine = sum(a * b for a, b in zip(ours, theirs, strict=True))
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


def _of_position(snapshot: Snapshot, health: Health) -> Iterator[Reason | str]:
    """Compare with the autopilot's position, height and velocity."""
    vehicle, other = snapshot.vehicle, snapshot.vehicle.autopilot
    if math.isnan(vehicle.lat_deg):
        return
    if health.is_position_autopilots:
        yield "position not compared: ours is the autopilot's own, no receiver's"
    elif other is None or not other.position_message:
        yield "position not compared: the autopilot says none"
    elif not other.position_age_s <= OLDEST_S:
        age = other.position_age_s
        yield f"position not compared: the autopilot's {other.position_message} is {age:.1f} s old"
    elif other.apart:
        yield Reason("not followed", f"the autopilot does not follow ODOMETRY: {other.apart}")
    elif other.is_position_ours:
        yield "position not compared: the autopilot's is made of our ODOMETRY"
    else:
        yield from _position_differences(vehicle, other)


def _position_differences(vehicle: VehicleEstimate, other: AutopilotState) -> Iterator[Reason]:
    sigma, lag = vehicle.sigma, math.hypot(*vehicle.vel_ned_m_s) * other.position_age_s
    far, high = _distance(vehicle, other), abs(vehicle.alt_m - other.alt_m)
    # An autopilot that states no sigma is as sure as we are: it has the same receiver
    std_h = _known(other.horizontal_std_m, sigma.horizontal_m)
    std_v = _known(other.vertical_std_m, sigma.alt_m)
    if far > max(POSITION_FLOOR, SIGMAS * math.hypot(sigma.horizontal_m, std_h)) + lag:
        yield Reason("position differs", f"position differs from the autopilot's by {far:.0f} m")
    if high > max(HEIGHT_FLOOR, SIGMAS * math.hypot(sigma.alt_m, std_v)) + lag:
        yield Reason("height differs", f"height differs from the autopilot's by {high:.0f} m")
    speed = math.dist(vehicle.vel_ned_m_s, other.vel_ned_m_s)
    std = math.hypot(*sigma.vel_ned_m_s, AUTOPILOT_VELOCITY_STD)
    if speed > max(VELOCITY_FLOOR, SIGMAS * std):
        yield Reason(
            "velocity differs", f"velocity differs from the autopilot's by {speed:.1f} m/s"
        )


def _known(value: float, otherwise: float) -> float:
    return otherwise if math.isnan(value) else value


def _distance(vehicle: VehicleEstimate, other: AutopilotState) -> float:
    """Return the horizontal distance of the two positions, m, as on a sphere."""
    lat = math.radians(vehicle.lat_deg)
    north = math.radians(vehicle.lat_deg - other.lat_deg)
    east = math.radians((vehicle.lon_deg - other.lon_deg + 180.0) % 360.0 - 180.0) * math.cos(lat)
    return SEMI_MAJOR_AXIS * math.hypot(north, east)


def _of_rest(snapshot: Snapshot) -> Iterator[Reason]:
    """Judge how the attitude has changed while the vehicle was at rest."""
    vehicle, drift = snapshot.vehicle, snapshot.vehicle.drift
    if drift.seconds < LEAST_REST_S or (snapshot.peer is not None and snapshot.peer.is_armed):
        return
    sigma, span = vehicle.sigma, f"in {drift.seconds:.0f} s at rest"
    for name, moved, std in (
        ("roll", drift.roll_deg, sigma.roll_deg),
        ("pitch", drift.pitch_deg, sigma.pitch_deg),
    ):
        if moved > max(LEVEL_DRIFT, std):
            yield Reason("levels drift", f"levels drift: {name} by {moved:.1f} deg {span}")
    if drift.heading_deg > max(HEADING_DRIFT, sigma.heading_deg):
        yield Reason("heading drifts", f"heading drifts: by {drift.heading_deg:.0f} deg {span}")


def _of_beginning(vehicle: VehicleEstimate) -> Iterator[Reason]:
    """Find out whether the estimate is too young: the first fixes are the worst."""
    name = "position" if vehicle.needs_fix else "heading"
    if (since_s := vehicle.aids[name].since_s) < SETTLING_S:
        words = f"settling: {name} is aided for {since_s:.0f} of {SETTLING_S:.0f} s"
        yield Reason("settling", words)


def _of_output(snapshot: Snapshot) -> Iterator[Reason]:
    """Find an autopilot that flies on our ODOMETRY and receives none."""
    output, other = snapshot.output, snapshot.vehicle.autopilot
    if other is not None and other.is_position_ours and not output.is_streaming:
        why = output.silence or output.reason
        words = "the autopilot flies on our ODOMETRY, and none is sent"
        yield Reason("no odometry", f"{words}: {why}" if why else words)


def _remarks(snapshot: Snapshot) -> Iterator[str]:
    """Find what is worth knowing, but prevents no take-off."""
    health, output, vehicle = snapshot.estimator, snapshot.output, snapshot.vehicle
    std = vehicle.sigma.heading_deg
    if std > LARGEST_HEADING_STD and math.isnan(vehicle.lat_deg) and not vehicle.needs_fix:
        yield f"{_HEADING_UNSURE.format(std)}: no position shows the declination"
    if health is not None and 0.0 < health.imu_rate < DECIMATED:
        yield f"inertial samples come at {health.imu_rate:.0f} Hz: fast motion is missed"
    for number, words in snapshot.imu.units.items():
        if snapshot.imu.faults.get(number) and words != "used":
            yield f"inertial unit {number}: {words}"
    if health is not None and not output.is_allowed:
        yield f"ODOMETRY is withheld: {output.reason}"
    if snapshot.process.recording_trouble:
        yield f"not all is recorded: {snapshot.process.recording_trouble}"
