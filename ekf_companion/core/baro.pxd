# Made from baro.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Scratch
from ekf_companion.core.state cimport State
cdef void fuse_baro(State *x, Parameters *k, Scratch *w, double alt) noexcept nogil
