# Made from noise.py by setup.py
from ekf_companion.core.scratch cimport ImuRow
from ekf_companion.core.state cimport State
cdef void learn_noise(State *x, ImuRow *imu, double span) noexcept nogil
