# Made from yaw_filter.py by setup.py
from ekf_companion.core.scratch cimport YawUpdate
from ekf_companion.core.state cimport YawBank, YawFilter
cdef void start(YawFilter *f, double vn, double ve, double variance, double bias_std, double delay_std) noexcept nogil
cdef void set_state(YawFilter *f, Py_ssize_t i, double value, double variance) noexcept nogil
cdef void predict(YawFilter *f, YawBank *b, double gyro_bias_walk, YawUpdate *u) noexcept nogil
cdef void propagate_covariance(YawFilter *f, YawUpdate *u, double dt, double gyro_bias_walk, double gained) noexcept nogil
cdef void project(YawFilter *f, YawBank *b, YawUpdate *u) noexcept nogil
cdef double innovate(YawFilter *f, YawBank *b, YawUpdate *u, Py_ssize_t n, double variance) noexcept nogil
cdef void apply_update(YawFilter *f, YawBank *b, YawUpdate *u, Py_ssize_t n) noexcept nogil
