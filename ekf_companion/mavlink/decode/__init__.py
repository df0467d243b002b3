"""Wire units to measurements, corrected for the habits of the two autopilots.

Everything that a measurement needs is known from the messages alone, in their order: no time of
arrival is used. What is refused is counted under a reason and has no other effect.

decoder   one autopilot's frames, each to the reader of its message
context   what the readers share: family, clock, refusals, notes
inertial  HIGHRES_IMU, RAW_IMU, SCALED_IMU
aids      the aids that declare themselves: all that one needs of the wire
air       magnetometer and barometer, whichever message carries them
fix       GPS_RAW_INT, GPS2_RAW (compiled)
position  GLOBAL_POSITION_INT: the autopilot's own
heading   the autopilot's own heading
vehicle   armed, landed, and SYSTEM_TIME
state     what the decoders share with the compiled reader (compiled)
preference  the choice among several sources of one thing (compiled)
repetition  whether a sensor is stuck, or at the end of its range (compiled)
"""

from ekf_companion.mavlink.decode.context import DecoderOptions, Family
from ekf_companion.mavlink.decode.decoder import Decoder
from ekf_companion.mavlink.decode.preference import Pace, Preference

__all__ = ["Decoder", "DecoderOptions", "Family", "Pace", "Preference"]
