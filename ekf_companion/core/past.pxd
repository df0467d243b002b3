# Made from past.py by setup.py
from ekf_companion.core.memory cimport Vector
from ekf_companion.core.scratch cimport Then
from ekf_companion.core.state cimport State
cdef void forget(State *x) noexcept nogil
cdef void keep_velocity(State *x) noexcept nogil
cdef void look_back(State *x, double late, Then *then) noexcept nogil
cdef void gained_until(State *x, double t, Vector gained) noexcept nogil
cdef void unevenness(State *x, Vector var) noexcept nogil
cdef double acceleration_noise(State *x) noexcept nogil
