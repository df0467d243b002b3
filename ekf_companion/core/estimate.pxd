# Made from estimate.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Estimate, Motion, Scratch
from ekf_companion.core.state cimport State
cdef Py_ssize_t find_status(State *x, Py_ssize_t reasons) noexcept nogil
cdef Py_ssize_t find_reasons(State *x, Parameters *k) noexcept nogil
cdef double late_fix(State *x) noexcept nogil
cdef bint is_refused(State *x, Py_ssize_t aid) noexcept nogil
cdef Py_ssize_t write_estimate(State *x, Parameters *k, State *y, Scratch *w, Estimate *out) noexcept nogil
cdef void clear(Estimate *out) noexcept nogil
cdef void write_axis(State *x, State *y, Estimate *out, Py_ssize_t axis) noexcept nogil
cdef void write_attitude(State *x, State *y, Motion *m, Estimate *out) noexcept nogil
