# Made from rest.py by setup.py
from ekf_companion.core.memory cimport Vector
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Fix, Observation, Scratch
from ekf_companion.core.state cimport State
cdef void begin_window(State *x, double t) noexcept nogil
cdef void add_to_window(State *x) noexcept nogil
cdef void add_field(State *x, Vector mag_b) noexcept nogil
cdef void forget_field(State *x) noexcept nogil
cdef void add_velocity(State *x, Fix *fix) noexcept nogil
cdef bint is_receiver_moving(State *x) noexcept nogil
cdef bint is_changing(State *x) noexcept nogil
cdef double largest_at_rest(double learnt, double largest) noexcept nogil
cdef bint was_at_rest(State *x, Parameters *k) noexcept nogil
cdef void check_rest(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef void use_rest_window(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef bint is_levelling_by_fixes(State *x) noexcept nogil
cdef bint is_moving(State *x) noexcept nogil
cdef void fuse_zero_velocity(State *x, Parameters *k, Scratch *w) noexcept nogil
cdef bint is_reported_still(State *x) noexcept nogil
cdef void admit_new_bias(State *x, Parameters *k, Observation *o) noexcept nogil
cdef double gyro_bias_std(State *x) noexcept nogil
cdef void observe_rate(State *x, Parameters *k, Scratch *w, double hidden_turn) noexcept nogil
cdef double compare_with_field(State *x, Parameters *k, Scratch *w, double hidden_turn) noexcept nogil
cdef void fuse_no_travel(State *x, Scratch *w) noexcept nogil
