# Made from odometry.py by setup.py
from ekf_companion.core.memory cimport Vector
from ekf_companion.core.scratch cimport Estimate, OdometryNumbers, Pose, Scratch
from ekf_companion.core.state cimport State
cdef void write_odometry(State *x, Estimate *out, Scratch *w, OdometryNumbers *n) noexcept nogil
cdef bint read_covariance(State *x, Pose *p, Py_ssize_t first, Py_ssize_t second) noexcept nogil
cdef void add_offset(State *x, Pose *p) noexcept nogil
cdef void write_euler_jacobian(Estimate *out, Pose *p) noexcept nogil
cdef void turn_errors(Pose *p, Py_ssize_t first) noexcept nogil
cdef void write_triangle(Pose *p, Vector triangle, Py_ssize_t known) noexcept nogil
