"""The settings of the estimator, and their place in the kernel's parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from msgspec import Meta

from ekf_companion.core.settings.setting import (
    Anchor,
    AnchorBias,
    Angle,
    Auto,
    Declination,
    DelayStd,
    Gauss,
    MatrixRow,
    NotNegative,
    Param,
    Positive,
    Probability,
    Seconds,
    Setting,
    Share,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Habit:
    """How late, and how sampled, the stamps of an autopilot's family are."""

    gnss_delay: float
    """A fix is older than its stamp by this, s."""
    gnss_delay_std: float
    """One sigma of that, s: the filter estimates the rest."""
    unset_gnss_delay: float
    """What the autopilot's parameter says where nobody has set it, s; NaN: nothing."""
    imu_lag: float
    """An inertial sample says what was true this long before its stamp, s."""
    imu_samples: Literal["mean", "instant"]
    """What a sample is: the mean since the one before, or a reading at its time."""
    mag_delay: float
    """A magnetic field is older than its stamp by this, s."""
    airspeed_delay: float
    """An airspeed is older than its stamp by this, s."""
    keeps_bias: bool
    """The biases of what it sends are the sensors' own, and the same after a reboot in flight."""


HABITS = {
    # ArduPilot sends the IMU behind a 20 Hz low-pass of second order, read at the time of sending,
    # and stamps a fix on its arrival: both measured against its simulator's truth. With receivers
    # of its earlier years the delay was 0.2 s and more.
    # Its compass is the mean of what a driver has read in the 0.1 s since the reading before: 0.050
    # to 0.052 s late in three flights with a truth, 0.04 to 0.06 in a real copter's log.
    # Its airspeed is smoothed: 0.25 s late in its simulator's flight with a truth.
    "ardupilot": Habit(
        gnss_delay=0.085,
        gnss_delay_std=0.1,
        unset_gnss_delay=math.nan,
        imu_lag=0.0115,
        imu_samples="instant",
        mag_delay=0.05,
        airspeed_delay=0.25,
        keeps_bias=True,
    ),
    # PX4 takes its own filter's biases off, which begin anew with it. It sends means and stamps a
    # fix on arrival: no delay in its simulator, 0.06 to 0.11 s with receivers. An airspeed it takes
    # for 0.1 s late (EKF2_ASP_DELAY).
    "px4": Habit(
        gnss_delay=0.05,
        gnss_delay_std=0.06,
        unset_gnss_delay=0.11,
        imu_lag=0.002,
        imu_samples="mean",
        mag_delay=0.0,
        airspeed_delay=0.1,
        keeps_bias=False,
    ),
    "unknown": Habit(
        gnss_delay=0.0,
        gnss_delay_std=0.1,
        unset_gnss_delay=math.nan,
        imu_lag=0.0,
        imu_samples="mean",
        mag_delay=0.0,
        airspeed_delay=0.0,
        keeps_bias=False,
    ),
}
"""What ``auto`` means, by the autopilot's family."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSettings:
    """The inertial sensor."""

    gyro_noise: Annotated[
        Positive,
        Setting("rad/s/sqrt(Hz)", reload=True, param=Param(8, "EC_GYRO_NSE", 1e-5, 0.1)),
    ] = 2e-3
    """White noise of the angular rate: the sensor's own, and what vibration adds. PX4's EKF2 takes
    0.015 rad/s at 100 Hz, which is 1.5e-3."""
    accel_noise: Annotated[
        Positive, Setting("m/s^2/sqrt(Hz)", reload=True, param=Param(9, "EC_ACC_NSE", 1e-4, 5.0))
    ] = 3e-2
    """White noise of the specific force, likewise. EKF2: 0.35 m/s^2 at 100 Hz, which is 3.5e-2."""
    gyro_bias_walk: Annotated[NotNegative, Setting("rad/s/sqrt(s)", reload=True)] = 1e-4
    """Random walk of the gyro bias, as EKF2 and EKF3 take it. With learn_noise 0.007 to 9 times its
    variance counts: less while fixes and samples agree, more while the bias runs one way, as it
    does while a sensor warms up."""
    accel_bias_walk: Annotated[NotNegative, Setting("m/s^2/sqrt(s)", reload=True)] = 5e-4
    """Random walk of the accelerometer bias, likewise."""
    gyro_bias: Annotated[Positive, Setting("rad/s")] = 0.02
    """One sigma of the gyro bias at a start in motion; a start at rest measures the bias."""
    accel_bias: Annotated[Positive, Setting("m/s^2")] = 0.2
    """One sigma of the accelerometer bias at the start: 0.02 g, a MEMS sensor over temperature.
    Raise it where nobody has calibrated."""
    learn_noise: Annotated[bool, Setting(reload=True)] = True
    """Take both white noises from the differences between samples; the numbers above then count as
    far as the fixes show that the samples are worse than that. How fast biases and the compass's
    error change, and the magnetometer's noise, are learnt from how they are corrected. false: only
    what is configured counts."""
    lag: Annotated[Seconds | Auto, Setting("s", auto="imu_lag")] = "auto"
    """An inertial sample says what was true this long before its stamp. ArduPilot's was measured
    with INS_GYRO_FILTER and INS_ACCEL_FILTER at 20 Hz; with 60 Hz give 0.006."""
    samples: Annotated[Literal["auto", "mean", "instant"], Setting(auto="imu_samples")] = "auto"
    """What a sample is: the mean since the one before it, or a reading at its time."""
    gap: Annotated[Positive, Setting("s")] = 0.2
    """Longest silence to bridge as if nothing had been missed. Raise it on a radio."""
    gap_reset: Annotated[Positive, Setting("s")] = 1.0
    """Silence after which position, velocity and attitude begin anew with the next fixes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssSettings:
    """The satellite receiver."""

    source: Annotated[Literal["auto", "raw", "global"], Setting(reload=True)] = "auto"
    """raw: GPS_RAW_INT. global: GLOBAL_POSITION_INT, the autopilot's own estimate, which is no
    independent measurement: the status is degraded at best. auto: the second only for an autopilot
    that never sends a fix of its receiver."""
    delay: Annotated[
        Seconds | Auto, Setting("s", auto="gnss_delay", param=Param(3, "EC_GPS_DELAY", -1.0, 1.0))
    ] = "auto"
    """A fix is older than its stamp by this; the filter estimates the rest. auto begins with what
    the log or the autopilot says, which is asked for it: SENS_GPS0_DELAY or EKF2_GPS_DELAY (PX4),
    GPS1_DELAY_MS (ArduPilot), ms. `ekf-companion calibrate delay LOG` measures it."""
    delay_std: Annotated[DelayStd | Auto, Setting("s", auto="gnss_delay_std")] = "auto"
    """One sigma of the delay: how far the filter may move it. 0: the delay is known. auto is 0.02
    where log or autopilot say a delay that somebody has set, not PX4's default."""
    timing_std: Annotated[NotNegative, Setting("s", reload=True)] = 0.02
    """One sigma of the error in time that the stamp of a fix, and the receiver's own filter, leave.
    It counts in manoeuvres: times the acceleration in the velocity, times the velocity in the
    position."""
    velocity_lag_std: Annotated[NotNegative, Setting("s", reload=True)] = 0.0
    """One sigma of how much later the velocity of a fix is true than its position: many receivers
    filter it, by 0.1 to 0.2 s. With 0.1 the estimator learns it in manoeuvres; until then a
    position is no surer than that times the speed. 0: they are true at the same time."""
    lever_arm: Annotated[tuple[float, float, float], Setting("m")] = (0.0, 0.0, 0.0)
    """The antenna from the inertial sensor: forward, right, down. Measure it to a few centimetres:
    in a turn of 2 rad/s, 0.3 m of it are 0.6 m/s."""
    lever_arm_std: Annotated[NotNegative, Setting("m", reload=True)] = 0.2
    """One sigma of the lever arm per axis. Lower it to 0.02 when it has been measured."""
    use_velocity: Annotated[bool, Setting(reload=True, param=Param(4, "EC_GPS_VEL_USE"))] = True
    """Use the receiver's velocity beside its position. false only where that velocity is wrong."""
    white_share: Annotated[Share | Auto, Setting(reload=True)] = "auto"
    """Share of the position's variance, as the receiver states it, that is white noise; the rest is
    an error that changes slowly. auto: learnt from the fixes."""
    slow_time: Annotated[Positive, Setting("s", reload=True)] = 100.0
    """Time constant of that slow error."""
    position_std: Annotated[
        NotNegative, Setting("m", reload=True, param=Param(5, "EC_GPS_POS_NSE", 0.005, 50.0))
    ] = 0.1
    """Least one sigma of the white noise of a horizontal axis, whatever the receiver claims. Raise
    it among houses and trees; lower it to 0.02 for RTK."""
    height_std: Annotated[
        NotNegative, Setting("m", reload=True, param=Param(6, "EC_GPS_HGT_NSE", 0.01, 50.0))
    ] = 0.2
    """Least one sigma of the white noise of the height, likewise; 0.04 for RTK."""
    velocity_std: Annotated[
        NotNegative, Setting("m/s", reload=True, param=Param(7, "EC_GPS_VEL_NSE", 0.005, 10.0))
    ] = 0.05
    """Least one sigma of the velocity per axis."""
    velocity_slow_std: Annotated[NotNegative, Setting("m/s", reload=True)] = 0.03
    """One sigma of the slow error of the velocity per axis, of a receiver whose white noise is
    0.1 m/s or less; of a noisier one it is larger in proportion. 0: there is none."""
    velocity_slow_time: Annotated[Positive, Setting("s", reload=True)] = 20.0
    """Time constant of the slow error of the velocity."""
    velocity_std_unknown: Annotated[Positive, Setting("m/s", reload=True)] = 0.3
    """One sigma of the velocity per axis where the receiver gives none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingSettings:
    """The sources of heading."""

    source: Annotated[
        Literal["auto", "gnss", "magnetometer", "autopilot"],
        Setting(reload=True, param=Param(10, "EC_HDG_SRC")),
    ] = "auto"
    """gnss: two antennas. autopilot: its own yaw, where the compass is poor and the autopilot has a
    better source. auto: the best of the three that speaks."""
    declination: Annotated[Declination | Auto, Setting("rad, east positive")] = "auto"
    """Declination of the magnetic field. auto: World Magnetic Model at the place."""
    year: Annotated[float, Meta(ge=2025.0, le=2030.0), Setting("decimal year")] = 2026.0
    """Date for the World Magnetic Model. A year off is 0.003 rad at most places."""
    hard_iron: Annotated[tuple[Gauss, Gauss, Gauss], Setting("gauss")] = (0.0, 0.0, 0.0)
    """What the vehicle itself adds to the field: forward, right, down. It is subtracted from what
    the magnetometer says. `ekf-companion calibrate mag LOG` measures it."""
    soft_iron: tuple[MatrixRow, MatrixRow, MatrixRow] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    """Matrix, by rows, that turns the rest into the Earth's field; measured likewise."""
    magnetometer_std: Annotated[
        Positive, Setting("rad", reload=True, param=Param(11, "EC_MAG_NSE", 1e-3, 1.0))
    ] = 0.02
    """One sigma of the slow error of a compass heading beside hard iron: of the declination, the
    scale, the mounting. Where GNSS shows in motion that it is smaller, half of this counts."""
    hard_iron_std: Annotated[Positive, Setting("gauss")] = 0.01
    """One sigma per axis of the vehicle's own field that calibration leaves. Raise it where motor
    currents turn the compass. The filter finds it as soon as the vehicle turns."""
    hard_iron_walk: Annotated[NotNegative, Setting("gauss/sqrt(s)", reload=True)] = 1e-4
    """Random walk of that field: the currents."""
    magnetometer_delay: Annotated[Seconds | Auto, Setting("s", auto="mag_delay")] = "auto"
    """A magnetic field is older than its stamp by this."""
    magnetometer_noise: Annotated[NotNegative, Setting("gauss", reload=True)] = 0.01
    """White noise of the field: weighs more where the horizontal field is weak, near the poles.
    With imu.learn_noise it is learnt, from a twentieth of this variance on."""
    field_strength: Annotated[Positive, Setting(reload=True)] = 0.25
    """Largest difference of the field's strength from the World Magnetic Model's, as a share of it.
    Beyond, the magnetometer is disturbed or not calibrated, and no heading is taken from it."""
    field_dip: Annotated[Positive, Setting("rad", reload=True)] = 0.26
    """Largest difference of the field's dip from the model's, likewise."""
    heading_std: Annotated[NotNegative, Setting("rad", reload=True)] = 0.02
    """Least one sigma of a heading from GNSS or the autopilot."""
    slow_time: Annotated[Positive, Setting("s", reload=True)] = 100.0
    """Time constant of the slow error of a compass or of the autopilot's heading: until GNSS has
    shown it in motion, yaw is no surer than that error. With imu.learn_noise an error that is seen
    to change less lasts up to a hundred times as long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BaroSettings:
    """The barometer: its height less the estimated one is an offset that walks."""

    use: Annotated[bool, Setting(reload=True, param=Param(12, "EC_BARO_USE"))] = True
    """Use the barometer. false in a vehicle whose static pressure jumps, with an open cockpit or
    strong downwash."""
    std: Annotated[
        Positive, Setting("m", reload=True, param=Param(13, "EC_BARO_NSE", 0.01, 50.0))
    ] = 0.5
    """White noise of the pressure altitude."""
    walk: Annotated[NotNegative, Setting("m/sqrt(s)", reload=True)] = 0.05
    """Random walk of the offset: weather, wind, temperature."""
    speed_walk: Annotated[NotNegative, Setting("m/sqrt(s) per m/s", reload=True)] = 0.01
    """Random walk of the offset for each m/s of speed: the air's pressure on the hull. With
    imu.learn_noise less counts where the speed changes and the offset does not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeFinderSettings:
    """A range finder that looks down: the height of the ground below is an offset that walks."""

    use: Annotated[bool, Setting(reload=True)] = True
    """Use the range finder, once there is a position. false over water or crops that it looks
    into."""
    std: Annotated[Positive, Setting("m", reload=True)] = 0.1
    """White noise of the range, if the sensor states no more."""
    walk: Annotated[NotNegative, Setting("m/sqrt(s)", reload=True)] = 0.2
    """Random walk of the ground's height below a vehicle that hovers. Over a deck that heaves by
    2 m in 12 s or a lift that moves by 0.5 m/s the height stays within 5 sigma; with a tenth of it,
    it does not. Lower it where nothing below moves."""
    speed_walk: Annotated[NotNegative, Setting("m/sqrt(s) per m/s", reload=True)] = 0.1
    """Random walk of the ground's height for each m/s of speed: how rough it is. Raise it over
    woods and roofs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AirspeedSettings:
    """An airspeed sensor, whose slow errors are the wind and a scale; and sideslip."""

    use: Annotated[bool, Setting(reload=True)] = True
    """Use the airspeed in flight, once there is a position; of a multirotor it is not used."""
    std: Annotated[Positive, Setting("m/s", reload=True)] = 1.4
    """White noise of the airspeed, gusts among it, ten times a second, if the sensor states no
    more; as EKF2_EAS_NOISE and EK3_EAS_M_NSE have it."""
    wind_walk: Annotated[NotNegative, Setting("m/s/sqrt(s)", reload=True)] = 0.05
    """Random walk of the wind per axis, as EKF2_WIND_NSD has it."""
    wind_climb_walk: Annotated[NotNegative, Setting("m/s/sqrt(s) per m/s", reload=True)] = 0.05
    """Random walk of the wind for each m/s of climb: with height wind grows. EKF2 has half of it,
    with which an estimate lagged behind the wind of a climb to 50 m by 1.8 of its sigmas."""
    scale: Annotated[Positive, Setting(reload=True)] = 0.1
    """One sigma of the scale before flight shows it: calibration, mounting, the air's density."""
    scale_walk: Annotated[NotNegative, Setting("1/sqrt(s)", reload=True)] = 1e-4
    """Random walk of the scale."""
    least_speed: Annotated[Positive, Setting("m/s", reload=True)] = 5.0
    """Least airspeed that counts: below, a pitot tube measures noise, and the air may come from any
    side. EKF3 assumes no sideslip from 5 m/s on; EKF2_ARSP_THR is 8 in PX4's fixed wings."""
    sideslip: Annotated[NotNegative, Setting("rad", reload=True)] = 0.17
    """One sigma of the angle by which the air comes from the side of a fixed wing in flight, as
    EKF3 has it. EKF2_BETA_NOISE: 0.3. 0: nothing is assumed of it."""
    delay: Annotated[Seconds | Auto, Setting("s", auto="airspeed_delay")] = "auto"
    """An airspeed is older than its stamp by this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSettings:
    """The speed of a ground vehicle's wheels; and that it moves along its own axis."""

    use: Annotated[bool, Setting(reload=True)] = True
    """Use the wheels, once there is a position; only of a vehicle that rolls."""
    std: Annotated[Positive, Setting("m/s", reload=True)] = 0.1
    """One sigma of the speed over a second, if the sensor states no more."""
    slip: Annotated[NotNegative, Setting(reload=True)] = 0.02
    """One sigma of what slips within a second, along and across, as a share of the speed. Raise it
    on loose ground and for tracks."""
    across: Annotated[NotNegative, Setting("m/s", reload=True)] = 0.2
    """The same of the speed across and up beside that: rough ground, suspension. 0: nothing is
    assumed of where the vehicle moves to."""
    scale_walk: Annotated[NotNegative, Setting("1/sqrt(s)", reload=True)] = 1e-3
    """Random walk of the scale, which the first readings in motion with fixes show."""
    lever_arm: Annotated[tuple[float, float, float], Setting("m")] = (0.0, 0.0, 0.0)
    """The middle of the axle that does not steer, from the inertial sensor: forward, right,
    down."""
    yaw: Annotated[Angle, Setting("rad")] = 0.0
    """Where the wheels point to in the body, from its forward axis to the right."""
    delay: Annotated[Seconds, Setting("s")] = 0.0
    """A speed is older than its stamp by this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OpticalFlowSettings:
    """A camera that looks down: velocity over the height above the ground.

    That is the range finder's or, without one, where the vehicle last stood.
    """

    use: Annotated[bool, Setting(reload=True)] = True
    """Use the flow, once there is a position. false over water or crops that move."""
    std: Annotated[Positive, Setting("rad/s", reload=True)] = 0.1
    """White noise of a rate at the best quality; at a lower one more, in proportion. A PX4FLOW in
    flight has 0.05, of which most lasts for several readings."""
    scale_std: Annotated[NotNegative, Setting(reload=True)] = 0.1
    """One sigma of the scale, as of the focal length, before anything is known of it."""
    turn_std: Annotated[NotNegative, Setting("rad", reload=True)] = 0.05
    """One sigma of the camera's mounting about the body's down axis."""
    bias_std: Annotated[NotNegative, Setting("rad/s", reload=True)] = 0.01
    """One sigma of a constant rate, per axis: the sensor's gyro, a ground that is not level."""
    scale_walk: Annotated[NotNegative, Setting("1/sqrt(s)", reload=True)] = 0.005
    """Random walk of the scale: what is seen changes."""
    bias_walk: Annotated[NotNegative, Setting("rad/s/sqrt(s)", reload=True)] = 0.0005
    """Random walk of that rate."""
    lever_arm: Annotated[tuple[float, float, float], Setting("m")] = (0.0, 0.0, 0.0)
    """Position of the sensor from the inertial sensor: forward, right, down."""
    turn: Annotated[float, Meta(ge=-3.2, le=3.2), Setting("rad")] = 0.0
    """By which the sensor's x axis is turned from forward, clockwise as seen from above, where the
    autopilot does not turn it already."""
    least_quality: Annotated[float, Meta(ge=0.0, le=1.0), Setting(reload=True)] = 0.15
    """Least quality that is used, of 1. ArduPilot uses 0.2 and more."""
    lowest: Annotated[NotNegative, Setting("m", reload=True)] = 0.2
    """Height over the ground below which the camera is out of focus, and its flow is not used."""
    delay: Annotated[Seconds, Setting("s")] = 0.0
    """A flow is older than the middle of its interval by this or, where the message states no
    interval (OPTICAL_FLOW, OF, .csv), than its stamp."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorRangeSettings:
    """Ranges between a tag on the vehicle and anchors, as of ultra-wideband radios."""

    use: Annotated[bool, Setting(reload=True)] = True
    """Use the ranges, once there is a position."""
    std: Annotated[Positive, Setting("m", reload=True)] = 0.3
    """Noise of a range, if the sensor states no more. Two-way ranges in a room have 0.07, and what
    stands between, which lasts for seconds, adds 0.1 to 0.4."""
    bias_std: Annotated[NotNegative, Setting("m", reload=True)] = 0.3
    """One sigma of an error that all ranges share: the delay of the radios."""
    spread_std: Annotated[NotNegative, Setting("m", reload=True)] = 0.05
    """One sigma of how much the error of an anchor's ranges differs from that: its own delay, and
    its place among the others."""
    frame_std: Annotated[NotNegative, Setting("m", reload=True)] = 2.0
    """One sigma, per axis, of where all of them are: the place that they were surveyed from, as by
    a receiver's fix; where they count from the origin that is the first fix. Beside a receiver the
    position is no surer than that, or than the receiver. 0: exactly there, whatever it says."""
    frame_yaw_std: Annotated[NotNegative, Setting("rad", reload=True)] = 0.05
    """One sigma of how they are turned about the vertical: north by a compass in the hand."""
    delay_std: Annotated[NotNegative, Setting("s", reload=True)] = 0.1
    """One sigma of how much later than ``delay`` the ranges are, as of visual_velocity; 0: none."""
    walk: Annotated[NotNegative, Setting("m/sqrt(s)", reload=True)] = 0.005
    """Random walk of these errors."""
    lever_arm: Annotated[tuple[float, float, float], Setting("m")] = (0.0, 0.0, 0.0)
    """Position of the tag from the inertial sensor: forward, right, down."""
    delay: Annotated[Seconds, Setting("s")] = 0.0
    """A range is older than its stamp by this."""
    anchors: tuple[Anchor, ...] = ()
    """Each anchor as [number, north, east, down], m from the origin; where places are geodetic, as
    [number, latitude, longitude, altitude], deg and m above mean sea level."""
    places: Literal["local", "geodetic"] = "local"
    """What the places of the anchors are."""
    biases: tuple[AnchorBias, ...] = ()
    """By how much the ranges of an anchor are too long, as [number, m], where it was calibrated.
    Then lower bias_std to 0.03 and spread_std to 0.01."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualOdometrySettings:
    """The pose of another estimator: visual or lidar odometry, motion capture."""

    use: Annotated[bool, Setting(reload=True)] = False
    """Use its poses, as what is travelled between them. Not where GNSS is in them already."""
    std: Annotated[Positive, Setting("m", reload=True)] = 0.05
    """White noise of the position, if the source states no more."""
    yaw_std: Annotated[Positive, Setting("rad", reload=True)] = 0.005
    """White noise of its yaw."""
    scale_std: Annotated[NotNegative, Setting("1", reload=True)] = 0.02
    """One sigma of its scale at first. 0.1 for a single camera without an inertial sensor; 0 for
    motion capture: without fixes the scale is found by accelerometers, which are 1 % off too."""
    delay: Annotated[Seconds, Setting("s")] = 0.0
    """A pose is older than its stamp by this; the rest is found."""
    delay_std: Annotated[NotNegative, Setting("s", reload=True)] = 0.15
    """One sigma of that."""
    lever_arm: Annotated[tuple[float, float, float], Setting("m")] = (0.0, 0.0, 0.0)
    """Place that its position is of, from the inertial sensor: forward, right, down."""
    timing_std: Annotated[NotNegative, Setting("s", reload=True)] = 0.005
    """Jitter of its stamps."""
    walk: Annotated[NotNegative, Setting("m/sqrt(s)", reload=True)] = 0.002
    """Random walk of its frame's place in a hover."""
    speed_walk: Annotated[NotNegative, Setting("m/sqrt(s) per m/s", reload=True)] = 0.03
    """Random walk of its frame's place for each m/s of speed: its drift."""
    yaw_walk: Annotated[NotNegative, Setting("rad/sqrt(s)", reload=True)] = 3e-3
    """Random walk of its frame's yaw: measured of a monocular one over 30 to 100 s."""
    scale_walk: Annotated[NotNegative, Setting("1/sqrt(s)", reload=True)] = 2e-4
    """Random walk of its scale."""
    delay_walk: Annotated[NotNegative, Setting("s/sqrt(s)", reload=True)] = 1e-4
    """Random walk of its delay."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualVelocitySettings:
    """The velocity of another estimator, used where that gives no pose."""

    use: Annotated[bool, Setting(reload=True)] = False
    """Use its velocity."""
    std: Annotated[Positive, Setting("m/s", reload=True)] = 0.1
    """White noise of the velocity, if the source states no more."""
    yaw_std: Annotated[NotNegative, Setting("rad", reload=True)] = 0.3
    """One sigma at first of the yaw of its frame, where it is not in the body; 0: it is north."""
    scale_std: Annotated[NotNegative, Setting("1", reload=True)] = 0.1
    """One sigma of its scale at first, as of visual_odometry."""
    delay: Annotated[Seconds, Setting("s")] = 0.0
    """A velocity is older than its stamp by this; the rest is found."""
    delay_std: Annotated[NotNegative, Setting("s", reload=True)] = 0.1
    """One sigma of that."""
    lever_arm: Annotated[tuple[float, float, float], Setting("m")] = (0.0, 0.0, 0.0)
    """Place that its velocity is of, from the inertial sensor: forward, right, down."""
    timing_std: Annotated[NotNegative, Setting("s", reload=True)] = 0.005
    """Jitter of its stamps."""
    yaw_walk: Annotated[NotNegative, Setting("rad/sqrt(s)", reload=True)] = 3e-3
    """Random walk of its frame's yaw."""
    scale_walk: Annotated[NotNegative, Setting("1/sqrt(s)", reload=True)] = 1e-3
    """Random walk of its scale."""
    delay_walk: Annotated[NotNegative, Setting("s/sqrt(s)", reload=True)] = 1e-4
    """Random walk of its delay."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignSettings:
    """The start, which finds down and north before anything is estimated, and standing still."""

    time: Annotated[float, Meta(ge=0.2, le=30.0), Setting("s")] = 1.0
    """Length of rest, or least of motion with fixes, to find down from."""
    rest_gyro: Annotated[Positive, Setting("rad/s", reload=True)] = 0.05
    """Largest spread of the rate at rest, all axes together. Raise it on a ship."""
    rest_accel: Annotated[Positive, Setting("m/s^2", reload=True)] = 0.6
    """Largest spread of the specific force at rest, all axes together, likewise."""
    use_rest: Annotated[bool, Setting(reload=True)] = True
    """Fuse zero velocity while the vehicle stands still, when the gyro shows its bias. Never while
    the autopilot says that it flies. false on a ship."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GateSettings:
    """Which measurements to refuse, and for how long."""

    probability: Annotated[
        Probability, Setting(reload=True, param=Param(14, "EC_GATE", 1.0, 6.0, is_sigma=True))
    ] = 0.999999
    """Share of good measurements that a gate lets through. Lower it (0.999) to refuse more."""
    soft_probability: Annotated[Probability, Setting(reload=True)] = 0.99
    """Share of good measurements that count in full; beyond, the further out the less."""
    timeout_position: Annotated[Positive, Setting("s", reload=True)] = 7.0
    """After this time without an accepted position, the next one resets the estimated position."""
    timeout_velocity: Annotated[Positive, Setting("s", reload=True)] = 7.0
    """The same for the velocity."""
    timeout_height: Annotated[Positive, Setting("s", reload=True)] = 5.0
    """The same for the height."""
    timeout_heading: Annotated[Positive, Setting("s", reload=True)] = 10.0
    """The same for the heading."""
    limit_position: Annotated[Positive, Setting("m", reload=True)] = 100.0
    """One sigma of the horizontal position beyond which the estimate is invalid and not sent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IntegritySettings:
    """How surely the error is within what is published of it."""

    risk: Annotated[float, Meta(gt=0.0, le=0.5), Setting(reload=True)] = 1e-3
    """Probability with which the error exceeds the protection level, which is published where
    weigh_faults is act. The odds of faults are known to a factor of two or so, and errors of
    sensors are no normal distribution far out: so one of a thousand can be shown by flights, and
    rarer ones are a matter of belief."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """The settings of the estimator."""

    imu: ImuSettings = field(default_factory=ImuSettings)
    gnss: GnssSettings = field(default_factory=GnssSettings)
    heading: HeadingSettings = field(default_factory=HeadingSettings)
    baro: BaroSettings = field(default_factory=BaroSettings)
    range_finder: RangeFinderSettings = field(default_factory=RangeFinderSettings)
    airspeed: AirspeedSettings = field(default_factory=AirspeedSettings)
    wheel: WheelSettings = field(default_factory=WheelSettings)
    optical_flow: OpticalFlowSettings = field(default_factory=OpticalFlowSettings)
    anchor_range: AnchorRangeSettings = field(default_factory=AnchorRangeSettings)
    visual_odometry: VisualOdometrySettings = field(default_factory=VisualOdometrySettings)
    visual_velocity: VisualVelocitySettings = field(default_factory=VisualVelocitySettings)
    align: AlignSettings = field(default_factory=AlignSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    integrity: IntegritySettings = field(default_factory=IntegritySettings)
    vehicle: Annotated[
        Literal["auto", "fixed_wing", "rotary", "ground", "other"], Setting(reload=True)
    ] = "auto"
    """How the vehicle moves: what is assumed of sideslip and wheels. auto: by HEARTBEAT, or what
    the log says of it; where nothing does, nothing is assumed that a sensor does not imply."""
    window: Annotated[float, Meta(ge=0.1, le=10.0), Setting("s")] = 2.0
    """How late a measurement may come and still take its place in time. Longer takes memory and,
    where measurements are that late, time. With weigh_faults at most 1024 inertial samples."""
    weigh_faults: Literal["off", "report", "act"] = "off"
    """Weigh beside the estimate what may have begun to be wrong: some twenty kinds of faults, each
    with its odds. ``report`` tells them and changes no estimate; ``act`` lets them decide in place
    of the gates' own rules, live as in logs. Either takes seven times the filter's time."""
