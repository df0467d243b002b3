# Made from delay.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Fix, Observation, Scratch
from ekf_companion.core.state cimport State
cdef void keep_fix(State *x, Parameters *k, Fix *fix, Observation *o) noexcept nogil
cdef void learn_delay(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void compare_gains(State *x, Parameters *k, Observation *o) noexcept nogil
cdef double true_share(State *x) noexcept nogil
cdef void learn_noise(State *x, Observation *o, double nis, double uneven) noexcept nogil
cdef void weigh_anew(State *x, Parameters *k) noexcept nogil
cdef double first_variance(State *x, Parameters *k) noexcept nogil
cdef void take_told(State *x, Parameters *k, double told) noexcept nogil
cdef void forget_gain(State *x) noexcept nogil
