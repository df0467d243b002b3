# Made from gate.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Observation
from ekf_companion.core.state cimport State
cdef void count_verdict(State *x, Py_ssize_t aid, Py_ssize_t verdict) noexcept nogil
cdef void count_heading(State *x, Py_ssize_t verdict, double azimuth) noexcept nogil
cdef void count_judged(State *x, Py_ssize_t aid, Py_ssize_t verdict) noexcept nogil
cdef bint is_timed_out(State *x, Py_ssize_t aid, double limit) noexcept nogil
cdef bint is_refused_for(State *x, Py_ssize_t aid, double limit) noexcept nogil
cdef bint has_run_for(State *x, Py_ssize_t aid, double limit) noexcept nogil
cdef bint is_running(State *x, Py_ssize_t aid) noexcept nogil
cdef bint fuse(State *x, Parameters *k, Observation *o, Py_ssize_t aid) noexcept nogil
cdef bint fuse_judged(State *x, Parameters *k, Observation *o, Py_ssize_t aid, double nis, bint is_denied) noexcept nogil
cdef void note_used(State *x, Py_ssize_t aid) noexcept nogil
cdef double follow_share(double share, double seen, double noise, double own, double memory) noexcept nogil
cdef void score(State *x, Observation *o, double nis, double gate) noexcept nogil
cdef void begin_reset(State *x, double reason) noexcept nogil
cdef void add_to_run(State *x, Observation *o, Py_ssize_t aid) noexcept nogil
cdef void clear_run(State *x, Py_ssize_t aid) noexcept nogil
cdef bint is_proven(State *x, Py_ssize_t aid, Py_ssize_t rows, double stated, double drift, double shortest) noexcept nogil
