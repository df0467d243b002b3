# Made from receiver.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport GnssRow, Scratch
from ekf_companion.core.state cimport State
cdef bint is_used(State *x, Parameters *k, Scratch *w, GnssRow *values) noexcept nogil
cdef bint is_better(State *x, Parameters *k, Scratch *w, GnssRow *values) noexcept nogil
cdef void forget_receiver(State *x) noexcept nogil
cdef bint replace_derived(State *x, Parameters *k, Scratch *w, bint has_vel) noexcept nogil
