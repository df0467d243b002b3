"""Capacity of a serial line, and whether the configured streams fit it."""

from __future__ import annotations

from ekf_companion.config.config import Config
from ekf_companion.engine.options import session_options
from ekf_companion.errors import LinkError
from ekf_companion.link.address import Address, Kind, parse_url
from ekf_companion.mavlink.decode import aids
from ekf_companion.mavlink.frame import HEADER_SIZE, SIGNATURE_SIZE
from ekf_companion.mavlink.messages import by_name

_FEWEST = 10.0
"""Lowest rate of ODOMETRY that must fit, Hz: PX4 does not fuse a slower one. Above that as many are
sent as the line carries (:mod:`~ekf_companion.mavlink.pacing`)."""
SHARE = 0.6
"""Share of the line for the streams: parameters, commands, texts and bursts need the rest."""
BITS = 10
"""Bits on the wire for each byte: 8N1."""
_KEYS = {
    "HIGHRES_IMU": "link.imu_rate",
    "SCALED_IMU2": "link.spare_imu_rate",
    "GPS_RAW_INT": "link.gnss_rate",
    "ATTITUDE": "link.heading_rate",
    "SCALED_PRESSURE": "link.baro_rate",
    "ODOMETRY": "output.odometry.rate",
    "GLOBAL_POSITION_SENSOR": "output.global_position.rate",
}
"""The key that sets the rate of each stream."""
_OURS = {"ESTIMATOR_STATUS": 1.0, "GPS_GLOBAL_ORIGIN": 1.0, "HEARTBEAT": 1.0, "TIMESYNC": 1.0}
"""Rates of our other messages, Hz."""
_THEIRS = {"HEARTBEAT": 1.0, "TIMESYNC": 1.0}


def overloads(config: Config) -> list[str]:
    """Return a warning for each direction in which a serial link is too slow, with what to lower.

    Other links give none; messages that the autopilot sends unasked are not counted.
    """
    try:
        address = parse_url(config.link.url)
    except LinkError:
        return []
    if address.kind is not Kind.SERIAL:
        return []
    ours = dict(_OURS)
    if config.output.odometry.mode != "never":
        ours["ODOMETRY"] = min(config.output.odometry.rate, _FEWEST)
    if config.output.global_position.rate > 0.0:
        ours["GLOBAL_POSITION_SENSOR"] = config.output.global_position.rate
    asked = session_options(config, is_recording=False).rates
    # What few vehicles have is not held against the line
    theirs = _THEIRS | {name: rate for name, rate in asked.items() if name not in aids.RATES}
    is_signed = bool(config.signing.key_file)
    words = []
    for direction, rates in (("from the autopilot", theirs), ("to the autopilot", ours)):
        needs = {name: rate * size(name, is_signed=is_signed) for name, rate in rates.items()}
        total, limit = sum(needs.values()), SHARE * address.baud / BITS
        if total > limit:
            largest = sorted((name for name in needs if name in _KEYS), key=lambda n: -needs[n])
            keys = [_KEYS[name] for name in largest if needs[name] > 0.1 * total]
            words.append(
                f"{address}: the streams {direction} need {total:.0f} bytes/s, and of this line "
                f"they should take no more than {limit:.0f} ({SHARE:.0%}); lower "
                f"{' or '.join(keys)}, or raise the baud rate at both ends"
            )
    return words


def capacity(address: Address) -> float | None:
    """Return the bytes/s that a link carries each way; None: not known in advance.

    The rate of a USB port means nothing.
    """
    if address.kind is not Kind.SERIAL or "ttyACM" in address.device:
        return None
    return address.baud / BITS


def size(name: str, *, is_signed: bool) -> int:
    """Return the largest size of a message on the wire, bytes."""
    return HEADER_SIZE + by_name(name).size + (SIGNATURE_SIZE if is_signed else 0)
