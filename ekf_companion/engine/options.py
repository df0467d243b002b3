"""What the configuration says of the link, as the options of a session."""

from __future__ import annotations

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig
from ekf_companion.engine.checkpoint import Vehicle
from ekf_companion.engine.tuning import parameters
from ekf_companion.mavlink.clock import TimesyncOptions
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.session import RATES, SessionOptions


def session_options(
    config: Config, is_recording: bool = False, expected: Vehicle | None = None
) -> SessionOptions:
    """Return what the configuration says of the link, and which autopilot may be expected there."""
    link, timesync, odometry = config.link, config.timesync, config.output.odometry
    return SessionOptions(
        system_id=link.system_id,
        component_id=link.component_id,
        autopilot_system_id=link.autopilot,
        allow_systems=link.allow_systems,
        allow_components=link.allow_components,
        accept_unsigned=config.signing.accept_unsigned,
        rates=_rates(link),
        expected=None if expected is None else PeerFound(*expected[1:], Family(expected.family)),
        is_recording=is_recording,
        parameters=parameters(config),
        timesync=TimesyncOptions(
            respond=timesync.respond,
            request=timesync.request,
            largest_rtt_ms=timesync.largest_rtt * 1e3,
        ),
        reads_others=config.visual_odometry.use or config.visual_velocity.use,
        withhold_unfollowed=odometry.not_followed == "withhold",
        guard=GuardOptions(
            mode=odometry.mode,
            independent=odometry.independent,
            withhold_in_flight=odometry.withhold_in_flight,
            second_source=odometry.second_source,
        ),
    )


def _rates(link: LinkConfig) -> dict[str, float]:
    return {
        **RATES,
        "HIGHRES_IMU": link.imu_rate,
        "SCALED_IMU2": link.spare_imu_rate,
        "SCALED_IMU3": link.spare_imu_rate,
        "GPS_RAW_INT": link.gnss_rate,
        "ATTITUDE": link.heading_rate,
        "SCALED_PRESSURE": link.baro_rate,
    }
