"""Wire units to measurements, with the habits of the two autopilots taken off at the door.

Everything that a measurement needs is known from the messages alone, in their order: no time of
arrival enters. What is refused is counted under a reason and leaves nothing else behind.

Rooms
    decoder     one autopilot's frames, each to the reader of its message
    door        what the readers share: the family, the clock, what was refused, what is to be told
    choice      of several sources the best that speaks; a stream thinned to a rate
    inertial    HIGHRES_IMU, RAW_IMU, SCALED_IMU
    repetition  inertial samples of a sensor that hangs or is at the end of its range
    air         magnetometer and barometer, whichever message brings them
    position    GPS_RAW_INT, GLOBAL_POSITION_INT
    heading     the autopilot's own heading
    vehicle     armed, landed, and SYSTEM_TIME
"""

from ekf_companion.mavlink.decode.context import DecoderOptions, Family, Pace, Preference
from ekf_companion.mavlink.decode.decoder import Decoder

__all__ = ["Decoder", "DecoderOptions", "Family", "Pace", "Preference"]
