"""Whom the fake autopilot passes for: the habits, and the traps, of the real firmware.

A ``Kind`` alone is an ideal autopilot, which sends what its sensors say when it is asked. The
personalities do what the two stacks do. Sources: their code (PX4 ``streams/HIGHRES_IMU.hpp``,
``streams/GPS_RAW_INT.hpp``, ``mavlink_main.cpp``, ``mavlink_timesync.cpp``; ArduPilot
``GCS_Common.cpp``), and what was measured on both in simulation (2025). What is neither is said
to be assumed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig

UNSUPPORTED, DENIED, FAILED = 3, 2, 4


class Kind(str, Enum):
    """Which autopilot it passes itself off as."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class Pacing(Enum):
    """How a rate that was asked for becomes one that is sent."""

    NEAREST = "nearest"
    """The whole number of turns that comes nearest: the ideal."""
    DIVISION = "division"
    """A whole number of turns, never faster: of 250 Hz, 200 asked gives 125 (PX4, measured)."""
    MILLISECONDS = "milliseconds"
    """Whole milliseconds, in the turn of the loop after they are over; above 0.8 of the loop's
    rate denied (ArduPilot ``cap_message_interval``, measured: 300 asked gives 333, 400 none)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Personality:
    """Every habit. The defaults are those of an autopilot without any."""

    name: str
    summary: str
    kind: Kind
    custom_mode: int
    version: int
    """AUTOPILOT_VERSION.flight_sw_version."""
    no_such_stream: int
    """Its answer to SET_MESSAGE_INTERVAL for a message that it does not have: PX4 FAILED (4, for
    RAW_IMU and SIM_STATE too), ArduPilot DENIED (2)."""
    parameters: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    """Of the firmware's defaults, those that decide what it fuses and how fast it sends."""
    streams: Mapping[str, float] | None = None
    """The messages that it has, and how often each comes until somebody asks, Hz; None: those of
    the configuration."""
    requestable: frozenset[str] | None = None
    """What REQUEST_MESSAGE gives; None: all that it has (ArduPilot before 4.6: part of it)."""
    pacing: Pacing = Pacing.NEAREST
    link_rate: float = 0.0
    """Bytes per second that its streams may take; MAV_1_RATE goes first where it is set. Above
    that all are slowed down without a word, to 5 % at worst (PX4 ``update_rate_mult``); 0: any."""
    gcs_rate: float = 0.0
    """A ground station sets the rates of the classic groups to so many Hz every 10 s (Mission
    Planner, MAVProxy ``--streamrate``, default 4); 0: there is none."""

    timesync_rate: float = 10.0
    """Of its own requests, Hz: PX4 10, ArduPilot 0.1 (``_timesync_request.interval_ms``)."""
    is_timesync_targeted: bool = True
    """TIMESYNC carries target ids (PX4#25949); else it is a broadcast."""
    rules: str = ""
    """Whose rules judge the ODOMETRY that it gets (:class:`sim_autopilot.acceptance.Stack`); empty:
    it takes any."""

    imu_rate: float = ImuConfig().rate
    """Inertial samples where the configuration says nothing else, Hz."""
    lowpass: float = 0.0
    """Corner of the low-pass (INS_GYRO_FILTER, 20 Hz: lags by 11.5 ms, measured), Hz; 0: none."""
    vehicle_imu_rate: float = 0.0
    """HIGHRES_IMU is the mean over one such interval, and at a lower rate of the stream the others
    are never seen (PX4 IMU_INTEG_RATE), Hz; 0: every inertial sample."""
    loop_rate: float = 0.0
    """Turns of the main loop (SCHED_LOOP_RATE: Copter 400, Plane 50), Hz; 0: one per sample."""
    loop_jitter: float = 0.0
    """Mean by which a turn of the loop comes late, s. The stamp is that of sending, not of the
    sample (ArduPilot ``send_highres_imu``); the size is assumed."""
    bias_step: float = 0.0
    """The autopilot's own filter steps its bias estimates so often, s, and HIGHRES_IMU is corrected
    by them (PX4); 0: it is not."""
    missing: float = 0.0
    """Share of inertial messages that never leave (PX4, measured: 1 to 2 % on a loaded link)."""
    mag_scale: float = 1.0
    """HIGHRES_IMU magnetometer is too large by this (ArduPilot before #32286: 1e6)."""
    pressure_scale: float = 1.0
    """And abs_pressure by this (PX4 in SITL: Pa, 100)."""
    has_ground_pressure: bool = False
    """diff_pressure is the static pressure less that on the ground, and no pitot (ArduPilot)."""
    is_always_updated: bool = False
    """Magnetometer and barometer are always said to be new (ArduPilot)."""

    gnss_rate: float = GnssConfig().rate
    """Fixes where the configuration says nothing else, Hz (PX4 in SITL: 8)."""
    gnss_delay: float = GnssConfig().delay
    """And their age at their stamp, s (ArduPilot, measured: 85 ms)."""
    utc_after: float = 0.0
    """GPS_RAW_INT.time_usec is 0 until the receiver knows UTC, so long after the first fix, s (PX4;
    the time is assumed)."""
    no_gps_after: float = 0.0
    """Without fixes for so long, s, GPS_RAW_INT says NO_GPS: PX4 after 1 s, once a second, without
    any number; ArduPilot after 4 s with the last one's. 0: it falls silent."""
    is_fix_repeated: bool = False
    """GPS_RAW_INT comes at its rate, new fix or not, so that up to 200 ms pass until a 5 Hz message
    has one, and stamps are whole milliseconds (ArduPilot ``send_mavlink_gps_raw``)."""
    stray: float = 0.0
    """Before the first fix its position is so far off, m (ArduPilot, measured: 140 km)."""
    origin_after: float = 0.0
    """The origin is set so long after the first fix, s, and until then heading is magnetic and
    there is no GPS_GLOBAL_ORIGIN (ArduPilot; the time is assumed)."""

    def suited(self, config: SimConfig) -> SimConfig:
        """Give the configuration with this autopilot's rates and delays where it has the defaults.

        A flight is to be planned with it.
        """
        plain = SimConfig()

        def own(section: str, key: str, value: float) -> float:
            said: float = getattr(getattr(config, section), key)
            return value if said == getattr(getattr(plain, section), key) else said

        imu = dataclasses.replace(
            config.imu,
            rate=own("imu", "rate", self.imu_rate),
            lowpass=own("imu", "lowpass", self.lowpass),
        )
        gnss = dataclasses.replace(
            config.gnss,
            rate=own("gnss", "rate", self.gnss_rate),
            delay=own("gnss", "delay", self.gnss_delay),
        )
        return dataclasses.replace(config, imu=imu, gnss=gnss)
