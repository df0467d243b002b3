# Made from tape.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Scratch
from ekf_companion.core.state cimport State
cdef Py_ssize_t append(State *x, Scratch *w, Py_ssize_t link) noexcept nogil
cdef void record_motion(State *x, Parameters *k, Scratch *w, double dt) noexcept nogil
cdef void record_gap(State *x, Scratch *w) noexcept nogil
cdef void record_event(State *x, Scratch *w) noexcept nogil
cdef void record_sample(State *x, Scratch *w) noexcept nogil
cdef void record_state(State *x, Scratch *w, double is_sample) noexcept nogil
