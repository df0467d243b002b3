# Made from gnss.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Fix, GnssRow, Observation, Scratch
from ekf_companion.core.state cimport State
cdef bint fuse_fix(State *x, Parameters *k, Scratch *w, GnssRow *values) noexcept nogil
cdef bint correct_by_fix(State *x, Parameters *k, Scratch *w, bint has_vel) noexcept nogil
cdef bint is_used(State *x, Parameters *k, Py_ssize_t flags) noexcept nogil
cdef bint is_frozen(State *x, GnssRow *values) noexcept nogil
cdef void learn_field(State *x, GnssRow *values) noexcept nogil
cdef void read_fix(State *x, Parameters *k, Fix *fix, GnssRow *values) noexcept nogil
cdef double white_share(State *x, Parameters *k, Py_ssize_t aid) noexcept nogil
cdef void bound_offset(State *x, Observation *o, Py_ssize_t axis, double level) noexcept nogil
cdef bint fuse(State *x, Parameters *k, Scratch *w, Py_ssize_t aid) noexcept nogil
cdef void learn_white_share(State *x, Observation *o, Py_ssize_t aid, double stated_var) noexcept nogil
cdef bint is_dragged(State *x, Observation *o, Fix *fix, Py_ssize_t aid) noexcept nogil
cdef bint fuse_velocity(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef bint is_denied_by_position(State *x, Fix *fix, Observation *o) noexcept nogil
cdef void fuse_position(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef bint is_settling(State *x, Py_ssize_t aid) noexcept nogil
cdef double position_patience(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void fuse_height(State *x, Parameters *k, Scratch *w) noexcept nogil
