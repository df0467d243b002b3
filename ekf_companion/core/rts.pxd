from ekf_companion.core.memory.enums cimport N
from ekf_companion.core.memory.parameters cimport Parameters
from ekf_companion.core.memory.scratch cimport Hindsight, Observation, Scratch, TapeRecord
from ekf_companion.core.memory.state cimport State
cdef class Smoother:
    cdef double[::1] numbers
    cdef double[:, ::1] blocks
    cdef double[:, ::1] tape
    cdef Parameters *k
    cdef State *x
    cdef State *y
    cdef State *z
    cdef Scratch w
    cdef Hindsight h
    cdef void forward(self, double[:, ::1] table)
    cdef void back(self, double[:, ::1] table)
cdef void keep_accounts(State *x, State *y, Observation *o, Hindsight *h) noexcept nogil
cdef void copy_covariance(double source[N][N], double to[N][N]) noexcept nogil
cdef void undo(
    TapeRecord *before, TapeRecord *after, State *y, Observation *o, Hindsight *h
) noexcept nogil
cdef void multiply_transition(State *x, TapeRecord *after, Hindsight *h) noexcept nogil
cdef void multiply_redrawn(State *x, State *after, Hindsight *h) noexcept nogil
cdef void factor(double a[N][N]) noexcept nogil
cdef void solve(double root[N][N], double g[N][N]) noexcept nogil
cdef void apply_gain(State *x, State *y, Observation *o, Hindsight *h) noexcept nogil
