# Made from lever.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Observation
from ekf_companion.core.state cimport State
cdef void restart(State *x) noexcept nogil
cdef void add_noise(State *x, Parameters *k, Observation *o) noexcept nogil
cdef double true_share(State *x) noexcept nogil
cdef void learn(State *x, Parameters *k, Observation *o, Py_ssize_t axis, double true) noexcept nogil
