# Made from align.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Fix, Motion, Pair, Scratch
from ekf_companion.core.state cimport State
cdef void set_attitude(State *x, Scratch *w, Pair *p) noexcept nogil
cdef bint has_reference(State *x) noexcept nogil
cdef double learnt_variance(State *x, Py_ssize_t first, Py_ssize_t count, double std) noexcept nogil
cdef void start_filter(State *x, Parameters *k, Scratch *w, double tilt, double gyro_bias) noexcept nogil
cdef double force_variance(State *x) noexcept nogil
cdef void level_by_window(State *x, Scratch *w) noexcept nogil
cdef void level_at_rest(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void level_roughly(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void begin_motion(State *x, Fix *fix) noexcept nogil
cdef void integrate(State *x, Motion *m, double dt) noexcept nogil
cdef double turn_to_field(State *x, Scratch *w, Pair *p) noexcept nogil
cdef double find_down(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef bint level_in_motion(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef bint level_again(State *x, Parameters *k, Scratch *w) noexcept nogil
