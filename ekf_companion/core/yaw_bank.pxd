# Made from yaw_bank.py by setup.py
from ekf_companion.core.parameters cimport Parameters
from ekf_companion.core.scratch cimport YawUpdate
from ekf_companion.core.state cimport State, YawBank
cdef void restart(YawBank *b, Parameters *k) noexcept nogil
cdef void take_bias(State *x, double std) noexcept nogil
cdef void fuse_velocity(State *x, Parameters *k, YawUpdate *u, double std) noexcept nogil
cdef void start_filters(YawBank *b, Parameters *k, YawUpdate *u, double variance) noexcept nogil
cdef void spread_filters(YawBank *b, double yaw) noexcept nogil
cdef bint update_filters(State *x, Parameters *k, YawUpdate *u, double stated) noexcept nogil
cdef void learn_variance(YawBank *b, YawUpdate *u, Py_ssize_t n, double variance) noexcept nogil
cdef double remove_mean(YawBank *b, Py_ssize_t i) noexcept nogil
cdef double variance_about(YawBank *b, Py_ssize_t i, double mean) noexcept nogil
cdef void merge_filters(YawBank *b) noexcept nogil
cdef void check_yaw(YawBank *b, YawUpdate *u, double dt) noexcept nogil
