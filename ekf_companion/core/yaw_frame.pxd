# Made from yaw_frame.py by setup.py
from ekf_companion.core.memory cimport Vector
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport Motion, YawUpdate
from ekf_companion.core.state cimport State, YawBank
cdef void restart(YawBank *b) noexcept nogil
cdef void restart_sums(YawBank *b) noexcept nogil
cdef void integrate(YawBank *b, Motion *m, double dt) noexcept nogil
cdef void halve_sums(YawBank *b) noexcept nogil
cdef void rotate_frame(Vector q, double px, double py, double pz) noexcept nogil
cdef void level(YawBank *b) noexcept nogil
cdef void lever_arm_velocity(State *x, Parameters *k, YawUpdate *u) noexcept nogil
