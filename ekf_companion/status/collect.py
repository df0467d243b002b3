"""Collect the states of the daemon's parts, for the status and for the doctor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.link.link import Link
from ekf_companion.mavlink.encode import POSES
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.stamp import seconds_since
from ekf_companion.nav.measurements import Kind
from ekf_companion.status.aids import AidWatch
from ekf_companion.status.snapshot import (
    FrameState,
    ImuState,
    LinkState,
    MessageState,
    OutputState,
    PeerState,
    TimeState,
)
from ekf_companion.status.vehicle import AutopilotState, Sigmas, VehicleEstimate


def link_state(link: Link, silent_s: float = math.nan) -> LinkState:
    """Return the state of the link; ``silent_s``: since the last byte, NaN if none came."""
    pinned, failure = link.peers.pinned, link.failure
    return LinkState(
        url=str(link.address),
        is_open=link.is_open,
        opened=link.opened,
        failure="" if failure is None else failure.strerror or str(failure),
        bytes_in=link.bytes_in,
        bytes_out=link.bytes_out,
        dropped=link.dropped,
        unsent=link.unsent,
        silent_s=silent_s,
        refused=dict(link.refused),
        peer="" if pinned is None else f"{pinned[0]} port {pinned[1]}",
    )


def peer_state(companion: Companion, peer: tuple[int, int], now_ns: int) -> PeerState:
    """Return the autopilot that was heard last, given its system and component id."""
    session, pipeline = companion.session, companion.pipeline
    restarts = {} if pipeline is None else pipeline.health().arrivals[Kind.RESTART]
    return PeerState(
        system_id=peer[0],
        component_id=peer[1],
        family=session.decoder.family.value,
        version=session.requests.version,
        is_heard=session.peer is not None,
        silent_s=seconds_since(session.discovery.heard_ns or None, now_ns),
        is_armed=session.decoder.vehicle.is_armed,
        reboots=sum(restarts.values()),
    )


def output_state(
    session: Session,
    new: int,
    rate: float,
    unheard: Mapping[str, int] | None = None,
    silence: str = "",
    now_ns: int = 0,
) -> OutputState:
    """Return what is sent, and why.

    ``new`` and ``rate`` are those of ODOMETRY in the last seconds, Hz; ``unheard`` are the
    datagrams that found no monitor, by its address; ``silence`` is the companion's; ``now_ns`` is
    the session's clock.
    """
    decision, state = session.guard.decision, session.stream_state
    return OutputState(
        mode=session.guard.options.mode,
        is_streaming=new > 0,
        rate=rate,
        is_allowed=state.is_streaming,
        is_settled=decision.is_settled,
        is_clash=session.clash.is_clash,
        reason=state.reason,
        silence=silence,
        remedy=state.remedy,
        parameters=dict(decision.parameters),
        sent=dict(session.outbox.sent),
        withheld=sum(session.outbox.withheld[name] for name in POSES[:2]),
        late_s=session.delivery.lag.typical(now_ns)[0],
        every=session.delivery.pacing.every,
        second_source=session.second_source.words,
        advice=session.delivery.advice(now_ns) if decision.is_fused else "",
        texts_dropped=session.statustext.dropped,
        unheard=unheard or {},
    )


def imu_state(session: Session, messages: Mapping[str, MessageState]) -> ImuState:
    """Return the source of the inertial samples, given the messages that are heard."""
    decoder = session.decoder
    message, lanes = messages.get(decoder.imu_source), decoder.inertial.lanes
    return ImuState(
        message=decoder.imu_source,
        instance=decoder.inertial.unit,
        rate=0.0 if message is None else message.rate,
        is_dejittered=decoder.inertial.is_dejittered,
        units=decoder.inertial.units(),
        faults={str(one.number): one.faults for one in lanes.units if one.faults},
        changes=len(lanes.changes),
    )


def requested_rates(session: Session) -> dict[str, float]:
    """Return the rates that were requested, Hz, by message."""
    rates = dict(session.requests.rates)
    is_refused = session.requests.inertial != "HIGHRES_IMU"
    if is_refused and "RAW_IMU" in session.requests.results:  # asked in its place
        rates["RAW_IMU"] = rates.get("HIGHRES_IMU", 0.0)
    return rates


def time_state(session: Session, now_ns: int) -> TimeState:
    """Return what is known of the autopilot's clock."""
    timesync, base = session.timesync, session.decoder.clock
    peer_ns = timesync.peer_ns(now_ns)
    return TimeState(
        base="unknown" if base.latest_us is None else "unix" if base.is_unix else "boot",
        is_locked=timesync.is_locked,
        trouble=timesync.trouble,
        offset_s=math.nan if peer_ns is None else (peer_ns - now_ns) * 1e-9,
        skew_ppm=timesync.skew * 1e6,
        rtt_p50_ms=timesync.rtt_ns(50) * 1e-6,
        rtt_p95_ms=timesync.rtt_ns(95) * 1e-6,
        residual_us=timesync.residual_ns * 1e-9 * 1e6,
        answers=timesync.answers,
        refused=dict(timesync.refused),
    )


def frame_state(session: Session) -> FrameState:
    """Return what the bytes were."""
    counters = session.counters()
    return FrameState(
        frames=counters["frames"],
        bad_crc=counters["bad_crc"],
        unknown_id=counters["unknown_id"],
        incompatible=counters["incompatible"],
        junk_bytes=counters["junk_bytes"],
        lost=counters["lost"],
        late=counters["late"],
        duplicates=counters["duplicate"],
        again=counters["again"],
        again_late=session.past.lag_us * 1e-6,
        signed=counters["signed"],
        refused=dict(session.admission.refused),
        ignored=dict(session.ignored),
    )


def vehicle_estimate(companion: Companion, watch: AidWatch, now_ns: int) -> VehicleEstimate:
    """Return where the vehicle is by our estimate, and by the autopilot's."""
    pipeline, config = companion.pipeline, companion.tuning.config
    out = None if pipeline is None else as_estimate(pipeline.values())
    nowhere = (math.nan,) * 3
    lla, vel_n = (nowhere, nowhere) if out is None else (out.lla, out.vel_n)
    euler, std_euler = (nowhere, nowhere) if out is None else (out.euler, out.std_euler)
    std_pos, std_vel = (nowhere, nowhere) if out is None else (out.std_pos, out.std_vel)
    roll, pitch, yaw = map(math.degrees, euler)
    return VehicleEstimate(
        lat_deg=lla[0],
        lon_deg=lla[1],
        alt_m=lla[2],
        height_m=math.nan if out is None else -out.pos_n[2],
        vel_ned_m_s=(vel_n[0], vel_n[1], vel_n[2]),
        roll_deg=roll,
        pitch_deg=pitch,
        heading_deg=yaw % 360.0,
        turn_rate_deg_s=math.nan if pipeline is None else _turn_rate(pipeline),
        sigma=sigmas(std_pos, std_vel, std_euler),
        aids=watch.states(now_ns),
        drift=watch.drift(),
        autopilot=autopilot_state(companion.session, now_ns),
        needs_fix=config.preflight.needs_fix,
        takes_own_position=config.gnss.source == "global",
    )


def sigmas(
    std_pos: Sequence[float], std_vel: Sequence[float], std_euler: Sequence[float]
) -> Sigmas:
    """Return one sigma of position (m), velocity (m/s) and attitude (rad) as the status has it."""
    roll, pitch, heading = map(math.degrees, std_euler)
    return Sigmas(
        north_m=std_pos[0],
        east_m=std_pos[1],
        horizontal_m=math.hypot(std_pos[0], std_pos[1]),
        alt_m=std_pos[2],
        vel_ned_m_s=(std_vel[0], std_vel[1], std_vel[2]),
        roll_deg=roll,
        pitch_deg=pitch,
        heading_deg=heading,
    )


def _turn_rate(pipeline: Pipeline) -> float:
    """Return how fast the vehicle turns about any axis, deg/s."""
    x = pipeline.filter_state
    return math.degrees(math.hypot(*(x.gyro[i] - x.gyro_bias[i] for i in range(3))))


def autopilot_state(session: Session, now_ns: int) -> AutopilotState | None:
    """Return what the autopilot's own estimate says; None if it has said nothing."""
    attitude = session.autopilot_estimate.attitude(now_ns)
    position = session.autopilot_estimate.position(now_ns)
    if attitude is None and position is None:
        return None
    roll, pitch, yaw = map(math.degrees, (math.nan,) * 3 if attitude is None else attitude.euler)
    ages = [one.age for one in (attitude, position) if one is not None]
    nan, decoder, following = math.nan, session.decoder, session.following.state
    return AutopilotState(
        roll_deg=roll,
        pitch_deg=pitch,
        heading_deg=yaw % 360.0,
        lat_deg=nan if position is None else math.degrees(position.lat),
        lon_deg=nan if position is None else math.degrees(position.lon),
        alt_m=nan if position is None else position.alt,
        vel_ned_m_s=(nan, nan, nan) if position is None else position.vel_n,
        horizontal_std_m=nan if position is None else position.std_horizontal,
        vertical_std_m=nan if position is None else position.std_vertical,
        age_s=max(ages),
        attitude_message="" if attitude is None else attitude.message,
        attitude_age_s=nan if attitude is None else attitude.age,
        position_message="" if position is None else position.message,
        position_age_s=nan if position is None else position.age,
        is_attitude_ours=decoder.is_yaw_ours,
        is_position_ours=decoder.is_ours,
        is_followed=following.is_watched,
        apart=following.apart,
        apart_horizontal_m=following.horizontal,
        apart_vertical_m=following.vertical,
        apart_velocity_m_s=following.velocity,
        apart_heading_deg=math.degrees(following.yaw),
        lag_s=following.lag,
    )
