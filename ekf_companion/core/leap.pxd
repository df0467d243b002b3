# Made from leap.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.state cimport State
cdef void forget(State *x) noexcept nogil
cdef void keep(State *x, double z) noexcept nogil
cdef void note_disturbed(State *x) noexcept nogil
cdef void look(State *x, Parameters *k, double z) noexcept nogil
