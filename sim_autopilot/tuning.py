"""The numbers of the autopilots' filters, with the names of their parameters.

Sources, with the parameters' defaults: PX4 1.17, ``ekf2/EKF/common.h``, ``ekf2/params_*.yaml`` and
``EKF/aid_sources/external_vision``; ArduPilot 4.7, ``AP_NavEKF3`` (``AP_NavEKF3.h``,
``_Measurements.cpp``, ``_PosVelFusion.cpp``, ``_MagFusion.cpp``) and ``AP_VisualOdom.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """What distinguishes one autopilot's filter from another's."""

    name: str
    step: float
    """Interval of prediction and fusion, s (EKF2_PREDICT_US; EKF_TARGET_DT)."""
    horizon: float
    """How far in the past it fuses, s (EKF2_DELAY_MAX; the largest sensor delay of EKF3)."""
    delay: float
    """Taken off the stamp, s (EKF2_EV_DELAY, VISO_DELAY_MS); half a step comes on top."""
    gyro_noise: float = 0.015
    """rad/s in one step (EKF2_GYR_NOISE, EK3_GYRO_P_NSE)."""
    accel_noise: float = 0.35
    """m/s^2 in one step (EKF2_ACC_NOISE, EK3_ACC_P_NSE)."""
    gyro_bias_noise: float = 1e-3
    """rad/s^2 (EKF2_GYR_B_NOISE, EK3_GBIAS_P_NSE)."""
    accel_bias_noise: float
    """m/s^3 (EKF2_ACC_B_NOISE, EK3_ABIAS_P_NSE)."""
    accel_bias_start: float
    """One sigma, m/s^2 (EKF2_ABIAS_INIT; ACCEL_BIAS_LIM_SCALER of EKF3)."""
    accel_bias_limit: float
    """m/s^2 (EKF2_ABL_LIM; ACCEL_BIAS_LIMIT of EKF3)."""
    is_message_trusted: bool
    """The velocity's sigma is the message's, floored (EKF2_EV_NOISE_MD 0); else the parameter's."""
    position_floor: float
    """m (EKF2_EVP_NOISE, VISO_POS_M_NSE)."""
    velocity_floor: float
    """m/s (EKF2_EVV_NOISE, VISO_VEL_M_NSE)."""
    yaw_floor: float
    """rad. EKF2 floors the variance by EKF2_EVA_NOISE itself: the sigma is its root."""
    position_gate: float = 5.0
    """Sigmas (EKF2_EVP_GATE, EK3_POS_I_GATE)."""
    velocity_gate: float
    """Sigmas (EKF2_EVV_GATE, EK3_VEL_I_GATE)."""
    yaw_gate: float
    """Sigmas (EKF2_HDG_GATE, EK3_YAW_I_GATE)."""
    retry: float
    """Without an accepted position for so long it is reset to the next, s (``no_aid_timeout_max``;
    ``posRetryTimeUseVel_ms``)."""
    least_interval: float
    """Between messages, s: what comes sooner is dropped (``extNavIntervalMin_ms``)."""
    longest_interval: float
    """s: after a longer silence fusion ends (twice ``EV_MAX_INTERVAL``)."""
    quality_min: int = 0
    """EKF2_EV_QMIN, VISO_QUAL_MIN; 0: off."""


EKF2 = Tuning(
    name="EKF2",
    step=0.010,
    horizon=0.200,
    delay=0.0,
    accel_bias_noise=0.003,
    accel_bias_start=0.2,
    accel_bias_limit=0.4,
    is_message_trusted=True,
    position_floor=0.1,
    velocity_floor=0.1,
    yaw_floor=0.316,
    velocity_gate=3.0,
    yaw_gate=2.6,
    retry=1.0,
    least_interval=0.0,
    longest_interval=0.4,
)
"""PX4's."""
EKF3 = Tuning(
    name="EKF3",
    step=0.012,
    horizon=0.220,
    delay=0.0,
    accel_bias_noise=0.02,
    accel_bias_start=0.2,
    accel_bias_limit=1.0,
    is_message_trusted=False,
    position_floor=0.2,
    velocity_floor=0.1,
    yaw_floor=0.2,
    velocity_gate=5.0,
    yaw_gate=3.0,
    retry=10.0,
    least_interval=0.020,
    longest_interval=0.5,
)
"""ArduPilot's, with the VISO_DELAY_MS that our documents ask for; its default is 10."""
