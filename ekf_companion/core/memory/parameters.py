"""The numbers that the kernel runs with; ``from_settings`` fills them in.

``setup.py`` makes ``parameters.pxd`` from it.
"""

from typing import Annotated

from ekf_companion.core.memory.declare import Count, Real, Structs, Vector, doubles, struct
from ekf_companion.core.memory.enums import AIDS, FAULTS, MOST_SLOW_ERRORS, RUNS

MOST_OWN = 12
"""Settings that an aid may have beside ``use``, ``std`` and its walks, a vector's each counted."""


@struct
class AidParameters:
    """The numbers of an aid that declares itself."""

    use: Real
    std: Real
    """White noise, of the unit of its measurement."""
    walk: Annotated[Vector, MOST_SLOW_ERRORS]
    """Random walk of its slow errors, of their units by sqrt(s)."""
    speed_walk: Annotated[Vector, MOST_SLOW_ERRORS]
    """The same for each m/s of speed."""
    climb_walk: Annotated[Vector, MOST_SLOW_ERRORS]
    """The same for each m/s of climb or descent."""
    own: Annotated[Vector, MOST_OWN]
    """Its other settings, in the order in which they are declared."""
    error: Real
    """The first of its slow errors in P."""
    errors: Real
    """How many it has."""
    stuck_after: Real
    """Time after which a reading that does not change is a fault, s; 0: never."""
    patience: Real
    """Readings in a row that may lie between the gates; 0: any number may."""
    yields: Real
    """It is wrong where the receiver's velocity contradicts it."""
    is_tried: Real
    """It counts once its readings have agreed for long."""
    parts: Real
    """Observations that one measurement makes."""
    shows: Real
    """Without fixes navigation goes on by it; 2: and can start by it."""


@struct
class FaultParameters:
    """The numbers of a kind of fault."""

    rows: Count
    """Its components."""
    std: Real
    """One sigma of each, before anything is known, in its unit."""
    tail: Real
    """One sigma of the tenth that is larger by orders of magnitude; as ``std``: none is."""
    rate: Real
    """How often it begins in an hour."""
    every: Real
    """Time between two onsets that are told apart, s; 0: each reading is one."""
    shows: Count
    """:class:`~.enums.Shows`: in which rows."""
    source: Count
    """:class:`~.enums.Source`: whose."""


@struct
class Parameters:
    """The numbers that the filter runs with; ``settings.py`` describes them."""

    gyro_noise: Real
    accel_noise: Real
    gyro_bias_walk: Real
    accel_bias_walk: Real
    gyro_bias_std: Real
    accel_bias_std: Real
    learn_noise: Real
    mean_samples: Real
    """Samples are means since the one before; 0: readings at their time."""
    lever_arm_b: Annotated[Vector, 3]
    lever_var: Real
    """Variance of the lever arm, m^2."""
    gnss_delay: Real
    """By which fixes are taken to be older than their stamps, s."""
    delay_std: Real
    told_delay_std: Real
    """One sigma of a delay that the autopilot tells, s; negative: that does not count."""
    unset_delay: Real
    """What it tells where nobody has set the delay, s; NaN: nothing."""
    gnss_floor: Annotated[Vector, RUNS]
    """Least sigma of position, height, velocity."""
    vel_std_default: Real
    use_velocity: Real
    use_derived: Real
    """Use the autopilot's own position: 0 never, 1 if no receiver ever sent a fix, 2 only that."""
    gnss_offset_time: Real
    white_share: Real
    """NaN: learnt."""
    timing_std: Real
    lag_std: Real
    """One sigma of how much later a receiver's velocity is true than its position, s."""
    gnss_vel_slow_std: Real
    """One sigma of the slow error of the receiver's velocity, m/s."""
    gnss_vel_offset_time: Real
    """Its time constant, s."""
    vehicle: Real
    """:class:`~.measurements.VehicleType`; 0: as the autopilot reports it."""
    heading: Real
    """:class:`HeadingChoice`."""
    mag_std: Real
    mag_noise: Real
    iron_std: Real
    iron_walk: Real
    heading_floor: Real
    heading_time: Real
    field_strength: Real
    field_dip: Real
    aid: Annotated[Structs, AidParameters, AIDS]
    """By number; of an aid that has settings of its own all are 0."""
    gate: Annotated[Vector, 3]
    """Largest NIS to fuse, for 1, 2 and 3 degrees of freedom."""
    soft_gate: Annotated[Vector, 3]
    """Largest NIS to fuse with full weight."""
    timeout_pos: Real
    timeout_vel: Real
    timeout_height: Real
    timeout_heading: Real
    align_time: Real
    lag: Real
    gap: Real
    gap_reset: Real
    limit_pos: Real
    rest_gyro: Real
    rest_accel: Real
    use_rest: Real
    gravity: Real
    keeps_bias: Real
    """The biases outlive a reboot of the autopilot in flight."""
    weighs_faults: Real
    """The bank of fault hypotheses runs beside the filter: 1 it tells, 2 it decides."""
    fault: Annotated[Structs, FaultParameters, FAULTS]
    """By kind."""
    risk: Real
    """Probability with which the error exceeds the protection level."""


PARAMETERS = doubles(Parameters)
