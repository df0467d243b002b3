# Made from voices.py by setup.py
from ekf_companion.core.scratch cimport Fix
from ekf_companion.core.state cimport State
cdef void add_baro(State *x, double alt) noexcept nogil
cdef void compare_climbs(State *x, Fix *fix) noexcept nogil
cdef void take_height(State *x) noexcept nogil
cdef bint hears_baro(State *x) noexcept nogil
cdef void find_rush(State *x, Fix *fix, double dt, double difference) noexcept nogil
cdef bint is_fall_unconfirmed(State *x) noexcept nogil
cdef void find_loser(State *x, Fix *fix) noexcept nogil
cdef Py_ssize_t find_third(State *x, double a, double b, double c) noexcept nogil
cdef bint agrees(double pair, double other, double third) noexcept nogil
cdef void doubt_height(State *x) noexcept nogil
cdef double compare(State *x, Py_ssize_t pair, double variance) noexcept nogil
cdef void bound(State *x, Py_ssize_t pair, double share) noexcept nogil
