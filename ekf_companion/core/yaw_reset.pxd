# Made from yaw_reset.py by setup.py
from ekf_companion.core.state cimport State
cdef bint is_ready(State *x) noexcept nogil
cdef double yaw_error(State *x) noexcept nogil
cdef bint agrees(State *x) noexcept nogil
cdef bint is_needed(State *x, double nis, double dt, double std) noexcept nogil
cdef void take_attitude(State *x) noexcept nogil
cdef void note_repair(State *x) noexcept nogil
cdef double slow_error(State *x, double stated) noexcept nogil
