# Made from correct.py by setup.py
from ekf_companion.core.memory cimport Vector
from ekf_companion.core.scratch cimport Observation
from ekf_companion.core.state cimport State
cdef double innovate(State *x, Observation *o) noexcept nogil
cdef void inflate_noise(Observation *o, double factor) noexcept nogil
cdef void apply_update(State *x, Observation *o) noexcept nogil
cdef void apply_yaw_update(State *x, Observation *o) noexcept nogil
cdef void apply_delay_update(State *x, Observation *o) noexcept nogil
cdef void inject(State *x, Observation *o) noexcept nogil
cdef void difference(State *x, State *y, Observation *o) noexcept nogil
cdef void rebase(State *y, Observation *o) noexcept nogil
cdef void rotate_back(Vector v, Observation *o) noexcept nogil
cdef void reset_variance(State *x, Py_ssize_t first, Py_ssize_t count, double variance) noexcept nogil
cdef void copy_nominal(State *x, State *source) noexcept nogil
