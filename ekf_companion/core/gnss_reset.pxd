# Made from gnss_reset.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Scratch
from ekf_companion.core.state cimport State
cdef void start_navigation(State *x, Parameters *k, Scratch *w, bint has_vel) noexcept nogil
cdef void move_to_offset(State *x, Py_ssize_t axis, double offset) noexcept nogil
cdef void start_from_yaw_bank(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void resume_after_gap(State *x, Parameters *k, Scratch *w, bint has_vel) noexcept nogil
cdef void reset_to_fix(State *x, Parameters *k, Scratch *w, bint has_vel) noexcept nogil
cdef void reset_position(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void reset_height(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void forget_vel_offset(State *x) noexcept nogil
cdef void reset_velocity(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void reset_unknown_velocity(State *x, Py_ssize_t first, Py_ssize_t count) noexcept nogil
