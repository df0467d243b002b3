from ekf_companion.core.state cimport State
cdef void restart(State *x) noexcept nogil
cdef void begin_stretch(State *x) noexcept nogil
cdef void begin_heading_stretch(State *x) noexcept nogil
cdef void add_gyro_walk(State *x, Py_ssize_t axis, double variance) noexcept nogil
cdef void note_fading(State *x, double faded, double level) noexcept nogil
cdef void learn_walk(State *x, double dt) noexcept nogil
cdef void learn_drift(State *x) noexcept nogil
cdef void learn_heading_share(State *x) noexcept nogil
