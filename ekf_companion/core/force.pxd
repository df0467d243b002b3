from ekf_companion.core.scratch cimport Fix
from ekf_companion.core.state cimport State
cdef void compare(State *x, Fix *fix, double dt) noexcept nogil
cdef bint is_contradicted(State *x, Fix *fix) noexcept nogil
cdef bint is_denied(State *x, Fix *fix, double way) noexcept nogil
cdef bint is_odd(State *x, double claimed, double felt) noexcept nogil
cdef double limit(State *x, Fix *fix) noexcept nogil
