# Made from reboot.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.state cimport State
cdef void carry_over(State *x, State *y, Parameters *k) noexcept nogil
cdef double within(double value, double sigma) noexcept nogil
