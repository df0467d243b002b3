# Made from force.py by setup.py
from ekf_companion.core.scratch cimport Fix
from ekf_companion.core.state cimport State
cdef void compare(State *x, Fix *fix) noexcept nogil
cdef double claimed(State *x, Fix *fix, double dt, double faded, Py_ssize_t axis) noexcept nogil
cdef void judge(State *x, Fix *fix, double dt, double faded) noexcept nogil
cdef double is_denied(double way, double felt, double usual, double most) noexcept nogil
cdef double limit(State *x, Fix *fix) noexcept nogil
