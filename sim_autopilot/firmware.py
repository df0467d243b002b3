"""The autopilots that can be imitated: each a :class:`Personality`, and how one is chosen."""

from __future__ import annotations

import dataclasses

from ekf_companion.errors import ConfigError
from sim_autopilot import spec
from sim_autopilot.personality import DENIED, FAILED, Kind, Pacing, Personality

_INFINITE = 1000.0
"""Hz: every new sample."""
_PARAMETER_LENGTH = 16
_DELAY = {"EKF2_GPS_DELAY": 110.0}
"""PX4's, which hardly anybody sets: not what the receiver has."""

IDEAL = {
    Kind.PX4: Personality(
        name="px4",
        summary="PX4 without its habits",
        kind=Kind.PX4,
        custom_mode=4 << 16 | 3 << 24,
        version=0x011000FF,
        no_such_stream=FAILED,
        parameters={"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7, **_DELAY},
        outage_drift=0.175,  # measured: dead reckoning, 79 m off after 30 s
    ),
    Kind.ARDUPILOT: Personality(
        name="ardupilot",
        summary="ArduPilot without its habits",
        kind=Kind.ARDUPILOT,
        custom_mode=4,
        version=0x040600FF,
        no_such_stream=DENIED,
        parameters={
            "VISO_TYPE": 0,
            "EK3_SRC1_POSXY": 3,
            "EK3_SRC1_VELXY": 3,
            "EK3_SRC1_POSZ": 1,
            "EK3_SRC1_VELZ": 3,
            "EK3_SRC1_YAW": 1,
            "GPS1_DELAY_MS": 0,  # left to the receiver's driver
        },
        timesync_rate=0.1,
        # Measured: constant position mode after 10 s, 9 m off after 29 s
        outage_drift=0.1,
        holds_position_after=10.0,
    ),
}
"""The choices of ``--autopilot``: no habits."""

_PX4 = dataclasses.replace(
    IDEAL[Kind.PX4],
    summary="PX4 1.16 on an onboard link of 921600 baud",
    parameters={"EKF2_EV_CTRL": 0, "EKF2_GPS_CTRL": 7, "MAV_1_RATE": 0, **_DELAY},
    streams={
        "HIGHRES_IMU": 50.0,
        "GPS_RAW_INT": _INFINITE,
        "ATTITUDE": 100.0,
        "GLOBAL_POSITION_INT": 50.0,
        "LOCAL_POSITION_NED": 30.0,
        "ODOMETRY": 30.0,
        "SCALED_PRESSURE": 1.0,
        "SYSTEM_TIME": 1.0,
        "EXTENDED_SYS_STATE": 5.0,
        "GPS_GLOBAL_ORIGIN": 1.0,
        "HEARTBEAT": 1.0,
    },
    pacing=Pacing.DIVISION,
    link_rate=46080.0,
    is_timesync_targeted=False,
    has_random_targets=True,
    rules="px4",
    vehicle_imu_rate=250.0,
    bias_step=1.0,
    missing=0.015,
    pressure_scale=100.0,
    gnss_rate=8.0,
    utc_after=5.0,
    no_gps_after=1.0,
)
_ARDUPILOT = dataclasses.replace(
    IDEAL[Kind.ARDUPILOT],
    summary="ArduPilot Copter 4.6: silent until asked, HIGHRES_IMU with a wrong magnetometer",
    # Silent until asked
    streams={
        "HIGHRES_IMU": 0.0,
        "RAW_IMU": 0.0,
        "SCALED_IMU2": 0.0,
        "SCALED_PRESSURE": 0.0,
        "GPS_RAW_INT": 0.0,
        "ATTITUDE": 0.0,
        "GLOBAL_POSITION_INT": 0.0,
        "LOCAL_POSITION_NED": 0.0,
        "SIM_STATE": 0.0,
        "SYSTEM_TIME": 0.0,
        "EXTENDED_SYS_STATE": 0.0,
        "GPS_GLOBAL_ORIGIN": 0.0,
        "HEARTBEAT": 1.0,
    },
    pacing=Pacing.MILLISECONDS,
    is_timesync_targeted=False,
    rules="ardupilot",
    imu_rate=400.0,
    lowpass=20.0,
    loop_rate=400.0,
    loop_jitter=0.2e-3,
    mag_scale=1e6,
    has_ground_pressure=True,
    is_always_updated=True,
    gnss_delay=0.085,
    compass_rate=10.0,
    compass_delay=0.05,
    no_gps_after=4.0,
    is_fix_repeated=True,
    stray=140e3,
    origin_after=8.0,
)

PERSONALITIES = {
    personality.name: personality
    for personality in (
        _PX4,
        dataclasses.replace(
            _PX4,
            name="px4-old",
            summary="PX4 1.14: fuses external vision by default, TIMESYNC to everybody",
            version=0x010E03FF,
            parameters={"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 7, "MAV_1_RATE": 0, **_DELAY},
            has_random_targets=False,
        ),
        dataclasses.replace(
            _PX4,
            name="px4-1.13",
            summary="PX4 1.13: EKF2_AID_MASK decides what is fused",
            version=0x010D03FF,
            parameters={"EKF2_AID_MASK": 1, "MAV_1_RATE": 0, **_DELAY},
            has_random_targets=False,
            rules="px4-old",
        ),
        dataclasses.replace(
            _PX4,
            name="px4-1.8",
            summary="PX4 1.8: reads VISION_POSITION_ESTIMATE, and no ODOMETRY",
            version=0x010802FF,
            parameters={"EKF2_AID_MASK": 1, "MAV_1_RATE": 0, **_DELAY},
            has_random_targets=False,
            knows_odometry=False,
            rules="px4-old",
        ),
        _ARDUPILOT,
        dataclasses.replace(
            _ARDUPILOT,
            name="ardupilot-old",
            summary="ArduPilot 4.3 to 4.5: RAW_IMU and SCALED_IMU2 only",
            version=0x040507FF,
            streams={k: v for k, v in (_ARDUPILOT.streams or {}).items() if k != "HIGHRES_IMU"},
            requestable=frozenset({"AUTOPILOT_VERSION", "HEARTBEAT"}),
        ),
        dataclasses.replace(
            _ARDUPILOT,
            name="ardupilot-4.0",
            summary="ArduPilot 4.0: EK2_GPS_TYPE 3 reads VISION_POSITION_ESTIMATE, no ODOMETRY",
            version=0x040007FF,
            streams={k: v for k, v in (_ARDUPILOT.streams or {}).items() if k != "HIGHRES_IMU"},
            requestable=frozenset({"AUTOPILOT_VERSION", "HEARTBEAT"}),
            parameters={"VISO_TYPE": 0, "EK2_GPS_TYPE": 0},
            knows_odometry=False,
        ),
    )
}
"""The choices of ``--personality``, by name."""


def parse(text: str) -> Personality:
    """Read ``NAME[:key=value,...]``.

    A key in capitals is a parameter of the autopilot, any other a number of the personality:
    ``ardupilot-old:loop_rate=50,gcs_rate=4``, ``px4-1.13:EKF2_AID_MASK=9``.

    Raises:
        ConfigError: There is no such personality or habit, or the value is no number.
    """
    name, values = spec.split(text)
    found = PERSONALITIES[spec.choose(text, "personality", name, PERSONALITIES)]
    numbers = [one.name for one in dataclasses.fields(found) if one.type == "float"]
    changes: dict[str, float] = {}
    parameters = dict(found.parameters)
    for key, value in values.items():
        if key.isupper():
            if len(key) > _PARAMETER_LENGTH:
                raise ConfigError(f"{text}: {key}: a parameter's name has 16 letters at most")
            parameters[key] = spec.number(text, key, value, -1e9, 1e9)
        else:
            habit = spec.choose(text, "habit", key, numbers)
            changes[habit] = spec.number(text, key, value, 0.0, 1e7)
    return dataclasses.replace(found, parameters=parameters, **changes)  # type: ignore[arg-type]
