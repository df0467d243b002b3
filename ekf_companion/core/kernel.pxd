# Made from kernel.py by setup.py
from ekf_companion.core.memory cimport Structs
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Event, ImuRow, Motion, Scratch
from ekf_companion.core.state cimport State
cdef void step(State *x, Parameters *k, Scratch *w, Structs rows, Py_ssize_t first, Py_ssize_t last) noexcept nogil
cdef void carry_on(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void advance(State *x, Parameters *k, Scratch *w, double t, double begin, double span) noexcept nogil
cdef void find_interval_motion(State *x, Parameters *k, Motion *m, ImuRow *imu, double span) noexcept nogil
cdef void find_lost_motion(State *x, Parameters *k, Motion *m, ImuRow *imu, double share) noexcept nogil
cdef void keep_sample(State *x, ImuRow *imu) noexcept nogil
cdef void forget_sensors(State *x) noexcept nogil
cdef void start(State *x, double t) noexcept nogil
cdef bint is_sound(State *x) noexcept nogil
cdef void recover(State *x, Parameters *k, State *good, double t) noexcept nogil
cdef void start_over(State *x, double t, double reason) noexcept nogil
cdef double shown_rate(State *x, ImuRow *imu) noexcept nogil
cdef void inflate_after_gap(State *x, Parameters *k, double span, double rate, bint is_gap) noexcept nogil
cdef void apply_event(State *x, Parameters *k, Scratch *w, Event *event) noexcept nogil
