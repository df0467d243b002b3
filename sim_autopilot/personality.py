"""The habits of real firmware that the fake autopilot imitates.

A ``Kind`` alone is an ideal autopilot, which sends its samples as requested. The personalities do
what the two stacks do. Sources: their code (PX4 ``streams/HIGHRES_IMU.hpp``,
``streams/GPS_RAW_INT.hpp``, ``mavlink_main.cpp``, ``mavlink_timesync.cpp``; ArduPilot
``GCS_Common.cpp``), and what was measured on both in simulation (2025). What is neither is marked
as assumed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, TypeVar

from sim_autopilot.config import CompassConfig, GnssConfig, ImuConfig, SimConfig

UNSUPPORTED, DENIED, FAILED = 3, 2, 4
Section = TypeVar("Section", ImuConfig, GnssConfig, CompassConfig)


class Kind(str, Enum):
    """The firmware that is imitated."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class Pacing(Enum):
    """How a requested rate becomes the rate of sending."""

    NEAREST = "nearest"
    """The nearest whole number of loop iterations: the ideal."""
    DIVISION = "division"
    """A whole number of loop iterations, never faster: of 250 Hz, 200 gives 125 (PX4, measured)."""
    MILLISECONDS = "milliseconds"
    """Whole milliseconds, in the first iteration of the loop after them; above 0.8 of the loop's
    rate denied (ArduPilot ``cap_message_interval``, measured: 300 gives 333, 400 is denied)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Personality:
    """All habits. The defaults are those of the ideal autopilot."""

    name: str
    summary: str
    kind: Kind
    custom_mode: int
    version: int
    """AUTOPILOT_VERSION.flight_sw_version."""
    no_such_stream: int
    """Its answer to SET_MESSAGE_INTERVAL for a message that it does not have: PX4 FAILED (4, for
    RAW_IMU and SIM_STATE too), ArduPilot DENIED (2)."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Of the firmware's defaults, those that decide what it fuses and how fast it sends."""
    streams: Mapping[str, float] | None = None
    """The messages that it has, and their rates until others are requested, Hz; None: those of the
    configuration."""
    requestable: frozenset[str] | None = None
    """What REQUEST_MESSAGE sends; None: all messages (ArduPilot before 4.6: some)."""
    pacing: Pacing = Pacing.NEAREST
    link_rate: float = 0.0
    """Bytes per second that its streams may use; MAV_1_RATE overrides it. Above that all streams
    are slowed down silently, to 5 % at worst (PX4 ``update_rate_mult``); 0: no limit."""
    gcs_rate: float = 0.0
    """A ground station sets the rates of the stream groups to so many Hz every 10 s (Mission
    Planner, MAVProxy ``--streamrate``, default 4); 0: there is none."""

    timesync_rate: float = 10.0
    """Of its own requests, Hz: PX4 10, ArduPilot 0.1 (``_timesync_request.interval_ms``)."""
    is_timesync_targeted: bool = True
    """TIMESYNC carries target ids (PX4 with #25949, after 1.17); else it is a broadcast."""
    has_random_targets: bool = False
    """Its answers to TIMESYNC carry any bytes as target ids: PX4 1.16 and 1.17 leave them
    uninitialised (``rsync`` in ``mavlink_timesync.cpp``). Measured: 1293 answers, 1240 pairs."""
    knows_odometry: bool = True
    """Whether it reads ODOMETRY (PX4 from 1.9 on, ArduPilot from 4.1 on); else it ignores it."""
    rules: str = ""
    """Rules for the ODOMETRY that it receives (:class:`sim_autopilot.acceptance.Stack`); empty: all
    is accepted."""

    imu_rate: float = ImuConfig().rate
    """Inertial samples if the configuration has the default, Hz."""
    lowpass: float = 0.0
    """Corner of the low-pass (INS_GYRO_FILTER, 20 Hz: lags by 11.5 ms, measured), Hz; 0: none."""
    vehicle_imu_rate: float = 0.0
    """HIGHRES_IMU is the mean over one such interval; at a lower rate of the stream the others are
    skipped (PX4 IMU_INTEG_RATE), Hz; 0: every inertial sample."""
    loop_rate: float = 0.0
    """Of the main loop (SCHED_LOOP_RATE: Copter 400, Plane 50), Hz; 0: that of the samples."""
    loop_jitter: float = 0.0
    """Mean lateness of an iteration of the loop, s. The stamp is that of sending, not of the
    sample (ArduPilot ``send_highres_imu``); the size is assumed."""
    bias_step: float = 0.0
    """Interval of the steps of the autopilot's own bias estimates, s, by which HIGHRES_IMU is
    corrected (PX4); 0: it is not."""
    missing: float = 0.0
    """Share of inertial messages that are not sent (PX4, measured: 1 to 2 % on a loaded link)."""
    mag_scale: float = 1.0
    """Factor on the magnetometer in HIGHRES_IMU (ArduPilot before #32286: 1e6)."""
    pressure_scale: float = 1.0
    """Factor on abs_pressure (PX4 in SITL: Pa, 100)."""
    has_ground_pressure: bool = False
    """diff_pressure is the static pressure minus that on the ground, not a pitot's (ArduPilot)."""
    is_always_updated: bool = False
    """Magnetometer and barometer are always marked as new (ArduPilot)."""

    gnss_rate: float = GnssConfig().rate
    """Fixes if the configuration has the default, Hz (PX4 in SITL: 8)."""
    gnss_delay: float = GnssConfig().delay
    """Their age at their stamp, likewise, s (ArduPilot, measured: 85 ms)."""
    compass_rate: float = CompassConfig().rate
    """Magnetic fields, likewise, Hz (ArduPilot, measured: 10)."""
    compass_delay: float = CompassConfig().delay
    """Their age, likewise, s (ArduPilot, measured: 50 ms, half of the time that it averages)."""
    utc_after: float = 0.0
    """GPS_RAW_INT.time_usec is 0 until so long after the first fix, when the receiver knows UTC, s
    (PX4; the time is assumed)."""
    outage_drift: float = 0.0
    """Acceleration of the error of the autopilot's own position while GNSS is lost, m/s^2."""
    holds_position_after: float = 0.0
    """Seconds without GNSS after which it reports one position and no velocity; 0: never."""
    no_gps_after: float = 0.0
    """Without fixes for so long, s, GPS_RAW_INT reports NO_GPS: PX4 after 1 s, once a second and
    without numbers; ArduPilot after 4 s with the last fix's. 0: it is not sent."""
    is_fix_repeated: bool = False
    """GPS_RAW_INT is sent at its rate, new fix or not, so that a 5 Hz message sends a fix up to
    200 ms late, and stamps are whole milliseconds (ArduPilot ``send_mavlink_gps_raw``)."""
    stray: float = 0.0
    """Error of its position before the first fix, m (ArduPilot, measured: 140 km)."""
    origin_after: float = 0.0
    """The origin is set so long after the first fix, s, and until then heading is magnetic and
    there is no GPS_GLOBAL_ORIGIN (ArduPilot; the time is assumed)."""

    def suited(self, config: SimConfig) -> SimConfig:
        """Return the configuration with this autopilot's rates and delays in place of the defaults.

        Plan a flight with it.
        """
        return dataclasses.replace(
            config,
            imu=_suited(config.imu, ImuConfig(), rate=self.imu_rate, lowpass=self.lowpass),
            gnss=_suited(config.gnss, GnssConfig(), rate=self.gnss_rate, delay=self.gnss_delay),
            compass=_suited(
                config.compass,
                CompassConfig(),
                rate=self.compass_rate,
                delay=self.compass_delay,
            ),
        )


def _suited(section: Section, defaults: Section, **own: Any) -> Section:
    """Return a section of the configuration with other values where it has the defaults."""
    changes = {k: v for k, v in own.items() if getattr(section, k) == getattr(defaults, k)}
    return dataclasses.replace(section, **changes)
