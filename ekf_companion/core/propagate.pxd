# Made from propagate.py by setup.py
from ekf_companion.core.enums cimport N
from ekf_companion.core.memory cimport Square
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Motion
from ekf_companion.core.state cimport State
cdef void set_origin(State *x, double lat, double lon, double alt) noexcept nogil
cdef void integrate_strapdown(State *x, Parameters *k, Motion *m, double dt) noexcept nogil
cdef void add_to_pending(State *x, Motion *m, double dt) noexcept nogil
cdef void integrate_increments(State *x, Motion *m, double dt) noexcept nogil
cdef void earth_motion(State *x, Parameters *k, Motion *m) noexcept nogil
cdef void propagate_covariance(State *x, Parameters *k, Motion *m) noexcept nogil
cdef void forget_pending(State *x) noexcept nogil
cdef void write_transition_blocks(State *x, Motion *m) noexcept nogil
cdef void multiply_rows(State *x, Motion *m, double dt) noexcept nogil
cdef void multiply_columns(State *x, Motion *m, double dt) noexcept nogil
cdef void add_noise(State *x, Parameters *k, Motion *m, double dt) noexcept nogil
cdef void fade_slow_errors(State *x, Parameters *k, Motion *m, double dt) noexcept nogil
cdef double heading_level(State *x, Parameters *k) noexcept nogil
cdef void decay(State *x, Py_ssize_t e, double g, double level) noexcept nogil
cdef void write_transition(Parameters *k, Motion *m, double dt, double Phi[N][N]) noexcept nogil
