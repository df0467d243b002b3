# Made from drag.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Scratch
from ekf_companion.core.state cimport State
cdef void restart(State *x) noexcept nogil
cdef void add_force(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef bint is_flying(State *x) noexcept nogil
cdef void let_wind_walk(State *x) noexcept nogil
cdef void learn(State *x, Scratch *w) noexcept nogil
cdef void use(State *x, Parameters *k, Scratch *w) noexcept nogil
