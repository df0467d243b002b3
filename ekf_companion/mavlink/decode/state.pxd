from ekf_companion.mavlink.decode.preference cimport Pace, Preference
from ekf_companion.mavlink.dejitter cimport Dejitter
from ekf_companion.mavlink.timebase cimport TimeBase
from ekf_companion.nav.repetition cimport Repetition
cdef class Ranked:
    cdef public Preference sources
cdef class InertialState(Ranked):
    cdef public Preference instances
    cdef public Repetition repetition
    cdef public Dejitter dejitter
    cdef public long long last_us
cdef class FieldState(Ranked):
    cdef public tuple last
    cdef public long long strange
cdef class PressureState(Ranked):
    cdef public double last
cdef class HeadingState(Ranked):
    cdef public Pace pace
cdef class ContextState:
    cdef public TimeBase clock
    cdef public bint is_submarine, is_ours, is_yaw_ours
cdef class TrimState:
    cdef public object first_ns, rows
cdef class DecoderState:
    cdef public list held
