# Made from heading.py by setup.py
from ekf_companion.core.memory cimport Vector
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport HeadingRow, Observation
from ekf_companion.core.state cimport Reference, State
cdef bint is_heading_used(State *x, Parameters *k, Py_ssize_t source) noexcept nogil
cdef bint is_field_used(State *x, Parameters *k) noexcept nogil
cdef bint is_natural(State *x, Parameters *k, Observation *o, Vector mag_b) noexcept nogil
cdef bint is_steady(State *x, double size) noexcept nogil
cdef void fuse_heading(State *x, Parameters *k, Observation *o, Reference *r, HeadingRow *values) noexcept nogil
cdef void fuse_field(State *x, Parameters *k, Observation *o, Reference *r, Vector mag_b) noexcept nogil
cdef void fuse_azimuth(State *x, Parameters *k, Observation *o, Reference *r, double slow, double source) noexcept nogil
cdef void use_compass(State *x, Parameters *k, double compass) noexcept nogil
cdef double innovate_field(State *x, Observation *o) noexcept nogil
cdef void begin_field_block(State *x) noexcept nogil
cdef void forget_field_noise(State *x) noexcept nogil
cdef void keep_reference(State *x, Reference *r) noexcept nogil
cdef void yield_to_azimuth(State *x, Observation *o, double slow) noexcept nogil
cdef void reset_yaw(State *x, Observation *o) noexcept nogil
