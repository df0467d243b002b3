# Made from observe.py by setup.py
from ekf_companion.core.memory cimport Vector
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Fix, Observation
from ekf_companion.core.state cimport Reference, State
cdef void clear(Observation *o, Py_ssize_t rows, double variance) noexcept nogil
cdef void add_timing_noise(Observation *o, Parameters *k, Vector rate) noexcept nogil
cdef void lever_arm(State *x, Parameters *k, Observation *o) noexcept nogil
cdef double way(State *x, Observation *o, Py_ssize_t axis) noexcept nogil
cdef void position(State *x, Parameters *k, Fix *fix, Observation *o) noexcept nogil
cdef void height(State *x, Parameters *k, Fix *fix, Observation *o) noexcept nogil
cdef void velocity(State *x, Parameters *k, Fix *fix, Observation *o) noexcept nogil
cdef void zero_velocity(State *x, Observation *o, double std) noexcept nogil
cdef void zero_rate(State *x, Observation *o, Vector rate, double level, double vertical) noexcept nogil
cdef bint azimuth(State *x, Observation *o, Reference *r) noexcept nogil
cdef void pressure_altitude(State *x, Observation *o, double alt, double std) noexcept nogil
