# Made from doubt.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Fix, ImuRow, Motion, Observation
from ekf_companion.core.state cimport State
cdef void restart(State *x) noexcept nogil
cdef double chance(State *x) noexcept nogil
cdef double quiet_share(State *x) noexcept nogil
cdef double walk_share(State *x) noexcept nogil
cdef double gyro_walk_share(State *x, double share) noexcept nogil
cdef void write_noise(State *x, Parameters *k, Motion *m, double dt) noexcept nogil
cdef double scale_var(State *x, Py_ssize_t sensor, double square, double usual, double dt) noexcept nogil
cdef void find_clipping(State *x, ImuRow *imu) noexcept nogil
cdef bint is_clipping(State *x) noexcept nogil
cdef double is_at_end(State *x, Py_ssize_t axis, double size, double change) noexcept nogil
cdef void learn_doubt(State *x, Parameters *k, Fix *fix, Observation *o, double nis, bint is_denied) noexcept nogil
cdef bint is_next(State *x) noexcept nogil
cdef void remember_doubt(State *x) noexcept nogil
cdef void bound_doubt(State *x) noexcept nogil
cdef double new_bias_share(State *x) noexcept nogil
cdef double receiver_share(State *x) noexcept nogil
cdef void doubt_refusal(State *x, Parameters *k, Fix *fix, Observation *o) noexcept nogil
cdef bint is_receivers_own(State *x, Fix *fix) noexcept nogil
