# Made from slide.py by setup.py
from ekf_companion.core.scratch cimport Fix
from ekf_companion.core.state cimport State
cdef void compare_fixes(State *x, Fix *fix) noexcept nogil
cdef void refuse(State *x) noexcept nogil
cdef void follow(State *x, Fix *fix, bint is_reset) noexcept nogil
cdef bint has_slid(State *x, Fix *fix, double limit) noexcept nogil
cdef double beside(State *x, Py_ssize_t axis) noexcept nogil
cdef bint is_led(State *x, Py_ssize_t axis) noexcept nogil
cdef double led_var(Fix *fix, double span) noexcept nogil
cdef bint contradicts_itself(State *x, Fix *fix) noexcept nogil
