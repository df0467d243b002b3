# Made from walk.py by setup.py
from ekf_companion.core.state cimport State
cdef void restart(State *x) noexcept nogil
cdef void begin_stretch(State *x) noexcept nogil
cdef void begin_slow_stretch(State *x) noexcept nogil
cdef void add_gyro_walk(State *x, Py_ssize_t axis, double variance) noexcept nogil
cdef void add_baro_walk(State *x, double variance, double by_speed, double speed2) noexcept nogil
cdef void note_fading(State *x, double faded, double level) noexcept nogil
cdef void learn_walk(State *x, double dt) noexcept nogil
cdef void learn_drift(State *x) noexcept nogil
cdef void learn_heading_share(State *x) noexcept nogil
cdef void learn_speed_share(State *x) noexcept nogil
cdef double learnt_share(double share, double least, double square, double gain, double weight) noexcept nogil
